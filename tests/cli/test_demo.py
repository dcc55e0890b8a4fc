"""`hfb demo` as a newcomer meets it: nothing set up, nothing reachable beyond this machine."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.orchestration import TINY_OPTIONS, mlflow_rows

KEYS = [
    "initial_mpjpe_mm",
    "mpjpe_mm",
    "pa_mpjpe_mm",
    "initial_iou",
    "iou",
    "psnr_db",
    "fit_seconds",
    "total_seconds",
    "out",
    "strip",
    "report",
    "mlflow_run_id",
    "directions",
    "unknown",
    "warnings",
]

# Python runs this at the start of every process of the command, the temporary server's included.
GUARD = """
import os, socket
def local(host):
    return host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "", None, b"127.0.0.1", b"localhost")
def note(what, address):
    with open(os.environ["OUTSIDE_LOG"], "a") as file:
        file.write(f"{what} {address}\\n")
    raise OSError(f"the test allows no connection to {address}")
def guarded(name, address_at):
    real = getattr(socket.socket, name)
    def call(self, *args):
        address = args[address_at]
        if self.family in (socket.AF_INET, socket.AF_INET6) and not local(address[0]):
            note(name, address)
        return real(self, *args)
    setattr(socket.socket, name, call)
for name, address_at in (("connect", 0), ("connect_ex", 0), ("sendto", -1)):
    guarded(name, address_at)
lookup = socket.getaddrinfo
def getaddrinfo(host, *args, **kwargs):
    if not local(host):
        note("getaddrinfo", host)
    return lookup(host, *args, **kwargs)
socket.getaddrinfo = getaddrinfo
"""


def test_demo_from_nothing(tmp_path: Path) -> None:
    home, outside = tmp_path / "home", tmp_path / "outside.log"
    (tmp_path / "guard").mkdir()
    (tmp_path / "guard" / "sitecustomize.py").write_text(GUARD)
    home.mkdir()
    settings = ("PREFECT_", "MLFLOW_", "XDG_", "HFB_")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(settings)} | {
        "HOME": str(home),
        "PYTHONPATH": os.pathsep.join([str(tmp_path / "guard"), str(Path.cwd())]),
        "OUTSIDE_LOG": str(outside),
    }
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "hfb.flows.cli.cli",
            "demo",
            "--out",
            str(tmp_path / "out"),
            "--json",
            *TINY_OPTIONS,
            "--export.report",
            "true",
        ],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout.splitlines()[-1])
    assert list(answer) == KEYS
    assert all(value is not None for value in answer.values())
    assert Path(answer["strip"]).is_file()
    assert Path(answer["report"]).is_file()
    store = home / ".local" / "share" / "hfb" / "mlflow.db"
    assert mlflow_rows(store, "select run_uuid, status from runs") == [(answer["mlflow_run_id"], "FINISHED")]
    assert not outside.exists(), outside.read_text()
