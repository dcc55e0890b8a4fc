"""Nothing on the way of `hfb fit` needs a POSIX system to be imported, and `hfb.fit` none to run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_PROGRAM = """
import builtins, os, signal, sys
import mlflow, numba, prefect, torch  # libraries may look at the system; ours may not
import concurrent.futures.process, multiprocessing.connection, multiprocessing.context, shutil, tempfile
import av, cv2, filelock, jaxtyping, pandas, platformdirs, rich.progress, safetensors, scipy.optimize, scipy.stats
MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "posix", "syslog", "readline", "crypt"}
NAMES = ("fork forkpty getuid geteuid getgid getegid setsid killpg getpgid sched_getaffinity mkfifo statvfs getloadavg "
         "O_DIRECTORY O_NOFOLLOW O_CLOEXEC O_NONBLOCK pipe2 fchmod fchown chown uname").split()
imports = builtins.__import__

def without_posix(name, globals=None, locals=None, fromlist=(), level=0):
    if name.partition(".")[0] in MODULES and (globals or {}).get("__name__", "").partition(".")[0] == "hfb":
        raise ImportError(f"{globals['__name__']} imports {name}")
    return imports(name, globals, locals, fromlist, level)

filelock.FileLock = filelock.SoftFileLock  # its lock of this system needs what is taken away; another one has its own
builtins.__import__ = without_posix
for name in NAMES:
    delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGALRM", "SIGUSR1", "SIGCHLD", "SIGPIPE", "alarm", "setitimer", "pthread_sigmask"):
    delattr(signal, name)
os.supports_dir_fd = set()
import hfb
from hfb.flows.cli.cli import main
import hfb.flows.fit_image, hfb.flows.video, hfb.flows.export, hfb.flows.report, hfb.flows.view_result
for name in ("fit", "fit_clip", "load_result", "matte", "first_body", "render", "Result"):
    getattr(hfb, name)
"""


def run(*lines: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", "\n".join([_PROGRAM, *lines])]
    named = {**os.environ, "USERNAME": "somebody"}  # as on Windows: torch asks for it
    return subprocess.run(words, capture_output=True, text=True, timeout=300, env=named)


@pytest.mark.integration
def test_the_product_is_imported_without_posix() -> None:
    done = run("print(len([name for name in sys.modules if name.startswith('hfb.')]))")
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) > 150


@pytest.mark.integration
def test_a_fit_in_memory_needs_no_posix(tmp_path: Path) -> None:
    done = run(
        "from hfb.datasets.example import write_example",
        "from pathlib import Path",
        f"out = Path({str(tmp_path)!r})",
        "example = write_example(out / 'input')",
        "few = {'stages': [{'size_px': 32, 'iterations': 2}], 'subframes': 2, 'texture_px': 16, 'settle': 0}",
        "few |= {'directions': {'refits': 1, 'iterations': 1, 'polish': 1}, 'both_fronts': False, 'init': 'matte'}",
        "result = hfb.fit(example.frame, example.background, **few)",
        "print(result.joints.shape, len(result.show().html) > 100_000)",
        "for keep in (result.save, result.report, lambda folder: result.export('glb', folder=folder)):",
        "    try:",
        "        keep(out / 'kept')",
        "    except hfb.InputError as error:",
        "        print(error)",
        "words = ['--background', str(example.background), '--out', str(out / 'kept')]",
        "print(main(['fit', str(example.frame), *words]), main(['demo', '--out', str(out / 'kept')]))",
    )
    assert done.returncode == 0, done.stderr[-2000:]
    shape, *refusals, codes = done.stdout.splitlines()
    assert (shape, codes) == ("(2, 24, 3) True", "2 2")
    assert len(refusals) == 3
    assert all("on Windows run it in WSL (wsl" in one for one in (*refusals, done.stderr.splitlines()[-1]))
    assert [path.name for path in tmp_path.iterdir()] == ["input"]


@pytest.mark.integration
def test_a_system_without_folders_by_descriptor_is_told_in_one_sentence() -> None:
    done = run(
        "from pathlib import Path",
        "from hfb.errors import InputError",
        "from hfb.tasks.results.workspace import workspace",
        "import tempfile",
        "with tempfile.TemporaryDirectory() as place:",
        "    try:",
        "        with workspace(Path(place) / 'out'): pass",
        "    except InputError as error:",
        "        print(error, [*Path(place).iterdir()])",
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "on Windows run it in WSL" in done.stdout
    assert done.stdout.strip().endswith("[]")
