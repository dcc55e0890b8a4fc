"""The method stands alone: every module of hfb imports where Prefect, MLflow and a terminal library do not exist."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.integration

PROGRAM = """
import importlib, pkgutil, sys
above = {"hfb.api", "hfb.tasks", "hfb.flows"}
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"prefect", "mlflow", "rich"} or name in above:
            raise ModuleNotFoundError(f"{name} is not there")
sys.meta_path.insert(0, Absent())
import hfb
rooms = [room for room in pkgutil.iter_modules(hfb.__path__, "hfb.") if room.name not in above]
names = [room.name for room in rooms]
for room in rooms:
    if room.ispkg:
        paths = importlib.import_module(room.name).__path__
        names += [module.name for module in pkgutil.walk_packages(paths, f"{room.name}.")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""


def test_the_method_knows_no_orchestration() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 30


def test_folders_of_the_user_are_not_taken_for_ours(tmp_path: Path) -> None:
    for name in ("flows", "tasks"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('somebody else\\'s')")
    for words in (["-m", "hfb.flows.cli.cli", "--version"], ["-c", "import hfb.flows.deployed, hfb.tasks.image.matte"]):
        done = subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=120, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
