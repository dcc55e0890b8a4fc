"""Chains of tasks, and the `hfb` command line.

Prefect and MLflow read their settings when they are imported. This project's settings are therefore set here, before
any module of this package can import them; the user's own settings take precedence.
"""

import os

from hfb.flows.runtime.prefect_home import use_own_home

_SETTINGS = {
    # nothing is reported to anybody
    "DO_NOT_TRACK": "true",
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    # the temporary server may take long to start the first time, on a slow or busy machine
    "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "180",
    "PREFECT_SERVER_LOGGING_LEVEL": "ERROR",
    # a lost server would cost a page per unsent event on the terminal, and minutes of waiting: Prefect tries five times
    "PREFECT_LOGGING_INTERNAL_LEVEL": "CRITICAL",
    "PREFECT_CLIENT_MAX_RETRIES": "3",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    # torch alone on a core: faster beside other work, and sums come out the same on every machine
    "OMP_NUM_THREADS": "1",
    "GIT_PYTHON_REFRESH": "quiet",
}
for _name, _value in _SETTINGS.items():
    os.environ.setdefault(_name, _value)
use_own_home()
