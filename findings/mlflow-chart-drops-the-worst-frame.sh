#!/usr/bin/env bash
# MLflow: the chart of a metric with many steps takes every n-th value, so the one bad frame of 20,000 is in no chart.
#
# Guess (2026-11-28): charts are thinned out so that peaks stay, as oscilloscopes and profilers do.
# Seen with mlflow 3.17.2 on SQLite: of 20,000 values whose 12,345th is 500 times the others, the query behind the charts (320 values a run)
# returns steps 0, 63, 126 ... and a largest value of 1.006. With 2,500 values, the most that may be asked for, it is the same.
# `get_metric_history` has it; the run's own value is the last step's.
# So: log the worst frame's value and number as metrics of their own.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check mlflow-skinny==3.17.2 'sqlalchemy<2.1' alembic==1.20.1 'fastapi<0.151' pandas==3.1.1
cd "$place"
MLFLOW_DISABLE_TELEMETRY=true "$place/venv/bin/python" - <<'PY' 2>/dev/null
import mlflow
from mlflow import MlflowClient
from mlflow.entities import Metric
from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

STEPS, WORST = 20_000, 12_345
client = MlflowClient("sqlite:///runs.db")
run = client.create_run(client.create_experiment("one")).info.run_id
for first in range(0, STEPS, 1000):
    values = [(step, 500.0 if step == WORST else 1 + step % 7 / 1000) for step in range(first, first + 1000)]
    client.log_batch(run, metrics=[Metric("error", value, 1000 + step, step) for step, value in values])
store = SqlAlchemyStore("sqlite:///runs.db", "./artifacts")
charts = {most: store.get_metric_history_bulk_interval([run], "error", most, None, None) for most in (320, 2500)}
largest = {most: (len(chart), max(point.value for point in chart)) for most, chart in charts.items()}
history = max(point.value for point in client.get_metric_history(run, "error"))
print("asked: (values, largest):", largest, "history's largest:", history)
assert all(count == most and value < 1.01 for most, (count, value) in largest.items()), largest
assert history == 500
print(f"mlflow {mlflow.__version__}: as found")
PY
