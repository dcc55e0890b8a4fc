"""Shapes in the types are enforced under test: every hfb module but the compiled kernels is checked at run time.

And what tests of tasks, flows and commands share: a store of their own on the session's one server, and a tiny problem.
"""

import importlib.util
import os
import pkgutil
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

import hfb
import tests.typechecking  # noqa: F401  (the hook finds the checker as an attribute of `tests`)
from tests.orchestration import Problem, orchestrated, tiny_problem

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

# A first call compiles kernels or waits for a busy machine: how long a case takes is no matter of right or wrong.
settings.register_profile("hfb", deadline=None, derandomize=True)
settings.load_profile("hfb")


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A server to run flows on, and an MLflow database of the test's own."""
    with orchestrated(tmp_path, monkeypatch) as database:
        yield database


@pytest.fixture(scope="session")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    """The embedded example, small."""
    return tiny_problem(tmp_path_factory.mktemp("problem"))
