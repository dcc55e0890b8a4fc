"""The services of a team, started once per process of the test run, with what infra/deploy.py puts on them."""

import sys
from collections.abc import Iterator

import httpx
import pytest

from tests.infra.team import ROOT, Team, missing, team


@pytest.fixture(scope="session")
def here() -> Iterator[Team]:
    if (reason := missing()) is not None:
        pytest.skip(reason)
    with team() as running:
        yield running


@pytest.fixture(scope="session")
def anybody(here: Team) -> Iterator[httpx.Client]:
    """Somebody who knows the address and nothing else."""
    with httpx.Client(verify=here.tls(), timeout=60) as client:
        yield client


@pytest.fixture(scope="session")
def deployed(here: Team) -> dict[str, str]:
    """What infra/deploy.py puts on the server; the settings of a worker."""
    data = here.folder / "data"
    data.mkdir()
    settings = here.settings("worker.env", "store.env") | {
        "HFB_DATA": str(data),
        "HFB_MLFLOW_PAGES": here.url("mlflow"),
        "MLFLOW_AUTH_ADMIN_PASSWORD_FILE": str(here.folder / "secrets" / "mlflow_admin"),
    }
    process = here.run([sys.executable, str(ROOT / "infra" / "deploy.py")], settings, "setup")
    assert process.wait(240) == 0, here.log("setup")
    return settings
