#!/usr/bin/env bash
# MLflow: of several values with one step and one time the run shows the largest, not the last one logged; of several steps the highest
# step, not the latest time.
#
# Guess (2026-11-28): a run's value of a metric is the one that was logged last.
# Seen with mlflow 3.17.2 on SQLite: 1.0, 2.0, 0.5 logged in this order with equal time and step read 2.0. A later time at a lower step is
# not shown. Infinity comes back as 1.797e308.
# So: times made from step numbers, which make a repeated log harmless, cannot correct a value downwards.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check mlflow-skinny==3.17.2 'sqlalchemy<2.1' alembic==1.20.1 'fastapi<0.151' pandas==3.1.1
cd "$place"
MLFLOW_DISABLE_TELEMETRY=true "$place/venv/bin/python" - <<'PY' 2>/dev/null
import mlflow
from mlflow import MlflowClient

client = MlflowClient("sqlite:///runs.db")
run = client.create_run(client.create_experiment("one")).info.run_id
for value in (1.0, 2.0, 0.5):
    client.log_metric(run, "equal", value, timestamp=5, step=0)
client.log_metric(run, "steps", 1.0, timestamp=9, step=5)
client.log_metric(run, "steps", 2.0, timestamp=10, step=3)
client.log_metric(run, "infinite", float("inf"))
shown = client.get_run(run).data.metrics
print(shown)
assert shown["equal"] == 2.0 and shown["steps"] == 1.0 and 1.79e308 < shown["infinite"] < float("inf"), shown
print(f"mlflow {mlflow.__version__}: as found")
PY
