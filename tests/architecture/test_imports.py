"""The method stands alone: every module of hfb imports where Prefect, MLflow and a terminal library do not exist."""

import subprocess
import sys

PROGRAM = """
import importlib, pkgutil, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"prefect", "mlflow", "rich", "tasks", "flows"}:
            raise ModuleNotFoundError(f"{name} is not there")
sys.meta_path.insert(0, Absent())
import hfb
names = [module.name for module in pkgutil.walk_packages(hfb.__path__, "hfb.")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""


def test_the_method_knows_no_orchestration() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 30
