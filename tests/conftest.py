"""Shapes in the types are enforced under test: every hfb module but the compiled kernels is checked at run time.

And what tests of tasks, flows and commands share: a store of their own on the session's one server, and a tiny problem.
`tests/README.md` tells where what is.
"""

import gc
import importlib.util
import os
import pkgutil
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import platformdirs
import pytest
from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir
from jaxtyping import install_import_hook

import hfb
import tests.typechecking  # noqa: F401  (the hook finds the checker as an attribute of `tests`)
from tests import kinds
from tests.orchestration import RUN_FOLDER, Problem, orchestrated, tiny_problem
from tests.shared import SHARED_DATA

# Hundreds of processes start below: each would compile all of the sources, and, in a home of its own, all kernels.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.setdefault("NUMBA_CACHE_DIR", str(platformdirs.user_cache_path("hfb") / "kernels"))

_COMPILED = "# mypy: ignore-errors"  # stands at the head of every module whose functions are compiled
_LEAVES = [
    module.name
    for room in pkgutil.iter_modules(hfb.__path__, "hfb.")
    if room.name not in ("hfb.flows", "hfb.tasks")
    for module in [room, *pkgutil.walk_packages([str(Path(hfb.__file__).parent / room.name[4:])], f"{room.name}.")]
    if not module.ispkg
    and (spec := importlib.util.find_spec(module.name)) is not None
    and _COMPILED not in Path(str(spec.origin)).read_text()
]
if not os.environ.get("HFB_BENCH"):  # what is timed is what users run, without the checks
    install_import_hook(_LEAVES, "tests.typechecking.checked")

set_hypothesis_home_dir(platformdirs.user_cache_path("hfb") / "hypothesis")  # and nothing into the checkout
# A first call compiles kernels or waits for a busy machine: how long a case takes is no matter of right or wrong.
settings.register_profile("hfb", deadline=None, derandomize=True, database=None)
settings.load_profile("hfb")


def pytest_configure(config: pytest.Config) -> None:
    if RUN_FOLDER not in os.environ:  # this is the first process of the run, whose workers inherit it
        os.environ[RUN_FOLDER] = tempfile.mkdtemp(prefix="hfb-test-run-")
        config.add_cleanup(lambda: shutil.rmtree(os.environ.pop(RUN_FOLDER), ignore_errors=True))
    for kind, needs in kinds.KINDS.items():
        config.addinivalue_line("markers", f"{kind}: {needs}")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    gc.disable()  # imports make a million objects and no garbage
    try:
        return (yield)
    finally:
        gc.freeze()  # they stay: no later search for garbage looks at them
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before -m looks at the markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    kinds.mark(items, Path(__file__).parent)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    yield from kinds.alone(item)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    return kinds.scheduling(config, log)


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A server to run flows on, and an MLflow database of the test's own."""
    with orchestrated(tmp_path, monkeypatch) as database:
        yield database


@pytest.fixture(scope="session")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    """The embedded example, small."""
    return tiny_problem(tmp_path_factory.mktemp("problem"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real pictures beside the project; tests that need them are skipped elsewhere."""
    folder = SHARED_DATA
    if not folder.is_dir():
        pytest.skip(f"no shared data in {folder} (set HFB_SHARED_DATA)")
    return folder
