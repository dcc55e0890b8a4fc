"""Kernels are compiled once per machine: a second process takes them from the cache, and computes the same bits."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

import pytest

from hfb.kernels.compile import READY, sources_folder
from tests.orchestration import TINY_OPTIONS

pytestmark = pytest.mark.integration

SCRIPT = """
import hashlib
import sys
from pathlib import Path
from hfb.kernels import compile
compile.READY = Path("nowhere")
from dataclasses import replace
import numpy as np
import torch
from numba.core.dispatcher import Dispatcher
from hfb.body.assets import load_default_body
from hfb.config import Stage, preset
from hfb.fitting.fit import fit
from hfb.matting.network import NetworkMatting
from hfb.priors.anatomy import AnatomicalPrior
from tests.bench.jobs import with_pose_blend_shapes
from tests.matting.test_moving_layer import Case
from tests.scenes import moving_scene

body = load_default_body()
scene = moving_scene(body, size_px=48)
seen = scene.observation
matte = NetworkMatting()(seen.frames_linear[0].numpy(), seen.plate_linear.numpy())
changes = {"stages": (Stage(size_px=48, iterations=2),), "subframes": 2, "texture_px": 16}
matted = replace(seen, mattes=torch.from_numpy(np.stack([matte] * len(seen.mattes))))
config = preset("best").fit.model_copy(update=changes)
# The embedded body's vertices do not depend on its pose; a SMPL file's do, and other kernels pose them.
bodies = body, with_pose_blend_shapes(body)
fits = [fit(matted, scene.middle, each, config, 0, AnatomicalPrior()) for each in bodies]
kernels = [
    value
    for name, module in sorted(sys.modules.items()) if name.startswith("hfb.kernels.")
    for value in vars(module).values() if isinstance(value, Dispatcher)
]
stats = [kernel.stats for kernel in kernels]
print(sum(sum(one.cache_hits.values()) for one in stats), sum(sum(one.cache_misses.values()) for one in stats))
_, layer = Case.drawn(1, 64, 48).descended(np.array([0.15, 0.02, 0.3], np.float32), 20)
made = *layer, matte, *(values for found in fits for values in (found.motion.joints, found.texture.numpy()))
print(hashlib.sha256(b"".join(np.ascontiguousarray(values).tobytes() for values in made)).hexdigest())
"""


KERNEL = """
from hfb.kernels.compile import entry

@entry
def twice(number):
    return 2 * number
"""
CALL = """
import sys
sys.path.insert(0, sys.argv[1])
from kernels_small import twice
print(twice(2.5), sum(twice.stats.cache_hits.values()), sum(twice.stats.cache_misses.values()))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder with a kernel, in which nothing can be written."""
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "kernels_small.py").write_text(KERNEL)
    folder.chmod(0o555)
    return folder


def called(package: Path, before: str = "", **settings: str) -> tuple[str, str]:
    """(what was printed, what was said) by a process that may write only where its user may, as root may not."""
    root = Path(__file__).parents[1]
    (package.parent / "file").touch()
    environment = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(root),
        "HOME": str(package.parent / "file" / "home"),
        "TMPDIR": str(package.parent),
        **settings,
    }
    as_user = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search"] if os.getuid() == 0 else []
    done = subprocess.run(
        [*as_user, sys.executable, "-c", before + CALL, str(package)],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        cwd=root,
    )
    return done.stdout.strip(), done.stderr


@pytest.mark.skipif(os.getuid() == 0 and shutil.which("setpriv") is None, reason="root may write everywhere")
def test_where_no_folder_can_be_written_kernels_are_temporary(package: Path) -> None:
    printed, told = called(package)
    assert printed == "5.0 0 1"
    assert told.count("set NUMBA_CACHE_DIR to one") == 1
    (kept,) = package.parent.glob("hfb-kernels-*")
    assert kept.stat().st_mode & 0o777 == 0o700
    assert called(package)[0] == "5.0 1 0", "the next command has them"
    kept.chmod(0o777)  # anybody could have put code there
    printed, told = called(package)
    assert printed == "5.0 0 1"
    assert f"{kept} only" not in told
    own = package.parent / "own"
    printed, told = called(package, NUMBA_CACHE_DIR=str(own))
    assert (printed, told) == ("5.0 0 1", "")
    assert called(package, NUMBA_CACHE_DIR=str(own))[0] == "5.0 1 0"


def test_kernels_are_kept_by_what_they_are_and_not_by_where(package: Path) -> None:
    own = {"NUMBA_CACHE_DIR": str(package.parent / "own")}
    assert called(package, **own)[0] == "5.0 0 1"
    elsewhere = package.parent / "elsewhere"
    shutil.copytree(package, elsewhere)
    elsewhere.chmod(0o755)
    source = elsewhere / "kernels_small.py"
    os.utime(source, (1, 1))
    assert called(elsewhere, **own)[0] == "5.0 1 0", "another copy of the same sources"
    source.write_text(KERNEL.replace("2 * number", "number + number + 1"))
    assert called(elsewhere, **own)[0] == "6.0 0 1", "other sources of the same names"
    assert called(elsewhere, **own)[0] == "6.0 1 0"


def test_one_of_two_processes_compiles(package: Path) -> None:
    """The others wait for it and load what it has made."""
    own = {"NUMBA_CACHE_DIR": str(package.parent / "own")}
    slow = "import time\nfrom numba.core import compiler\nreal = compiler.compile_extra\n"
    slow += "compiler.compile_extra = lambda *given, **named: (time.sleep(2), real(*given, **named))[1]\n"
    with ThreadPoolExecutor() as pool:
        printed = sorted(one[0] for one in pool.map(lambda _: called(package, slow, **own), range(2)))
    assert printed == ["5.0 0 1", "5.0 1 0"]


def test_a_forked_process_compiles(package: Path) -> None:
    """As workers do, which are forks of a process that has imported the kernels."""
    forked = "import os, sys\nsys.path.insert(0, sys.argv[1])\nimport kernels_small\n"
    forked += "if pid := os.fork(): sys.exit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))\n"
    own = str(package.parent / "own")
    assert called(package, forked, NUMBA_CACHE_DIR=own)[0] == "5.0 0 1"
    assert called(package, forked, NUMBA_CACHE_DIR=own)[0] == "5.0 1 0"


def test_a_damaged_cache_is_made_again(package: Path) -> None:
    own = package.parent / "own"
    called(package, NUMBA_CACHE_DIR=str(own))
    for ending in ("nbi", "nbc"):
        for content in (b"", b"garbage", None):
            (path,) = own.rglob(f"*.{ending}")
            path.write_bytes(path.read_bytes()[:-20] if content is None else content)
            assert called(package, NUMBA_CACHE_DIR=str(own))[0] == "5.0 0 1"
            assert called(package, NUMBA_CACHE_DIR=str(own))[0] == "5.0 1 0"


def test_a_full_disk_under_the_cache_costs_a_remark(package: Path) -> None:
    full = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))\n"
    printed, told = called(package, full, NUMBA_CACHE_DIR=str(package.parent / "own"))
    assert printed == "5.0 0 1"
    assert told.count("cannot be kept") == 1


def test_ready_made_kernels_are_found_and_never_written(package: Path) -> None:
    ready, own = package.parent / "ready", package.parent / "own"
    there = f"from pathlib import Path\nfrom hfb.kernels import compile\ncompile.READY = Path({str(ready)!r})\n"
    assert called(package, NUMBA_CACHE_DIR=str(ready))[0] == "5.0 0 1"
    made = {path: path.read_bytes() for path in ready.rglob("*.nb?")}

    def found(**settings: str) -> str:
        shutil.rmtree(own, ignore_errors=True)
        printed, told = called(package, there, NUMBA_CACHE_DIR=str(own), **settings)
        assert told == ""
        assert {path: path.read_bytes() for path in ready.rglob("*.nb?")} == now
        assert any(own.rglob("*.nbi")) == (printed == "5.0 0 1")
        return printed

    now = made
    assert found() == "5.0 1 0"
    assert found(NUMBA_CPU_NAME="generic") == "5.0 0 1", "of another processor"
    for path, content in made.items():
        for damaged in (b"", b"garbage", content[:-20]):
            path.write_bytes(damaged)
            now = made | {path: damaged}
            assert found() == "5.0 0 1"
        path.write_bytes(content)
    now = made
    assert found() == "5.0 1 0"


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the package alone, without ready-made kernels."""
    folder = tmp_path_factory.mktemp("copied")
    ignored = shutil.ignore_patterns("__pycache__", READY.name)
    shutil.copytree(Path(__file__).parents[1] / "hfb", folder / "hfb", ignore=ignored)
    return folder


def of_copy(copied: Path, home: Path) -> dict[str, str]:
    """An environment in which the copy is the package, for a user who has nothing yet."""
    kept = {name: os.environ[name] for name in ("PATH", "OMP_NUM_THREADS", "LANG") if name in os.environ}
    return kept | {"PYTHONPATH": str(copied), "HOME": str(home)}


def test_with_ready_made_kernels_a_command_compiles_nothing(copied: Path, tmp_path: Path) -> None:
    """They are made by the installation's command; most are what the suite has compiled already."""
    ready = copied / "hfb/kernels" / READY.name / sources_folder()
    for there in (READY / sources_folder(), Path(os.environ["NUMBA_CACHE_DIR"]) / sources_folder()):
        if there.exists():
            shutil.copytree(there, ready, dirs_exist_ok=True)
    for path in ready.glob("image_kernels.levels-*"):
        path.unlink()
    older = ready.with_name("hfb-0000000000000000")
    older.mkdir(parents=True)
    environment = of_copy(copied, tmp_path)
    subprocess.run([sys.executable, "-m", "hfb.kernels.ready"], env=environment, cwd=tmp_path, check=True)
    assert (list(ready.glob("*.lock")), older.exists()) == ([], False)
    made = {path.name: path.stat().st_mtime_ns for path in ready.iterdir()}
    assert any(name.startswith("image_kernels.levels-") for name in made)
    words = ["demo", "--quiet", "--out", str(tmp_path / "out"), *TINY_OPTIONS]
    done = subprocess.run(
        [sys.executable, "-m", "hfb.flows.cli.start", *words],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert [path.name for path in (tmp_path / ".cache/hfb/kernels").rglob("*.nb?")] == []
    assert {path.name: path.stat().st_mtime_ns for path in ready.iterdir()} == made


def computed(cache: Path) -> tuple[int, int, str]:
    """(kernels that were loaded, kernels that were compiled, hash of results) of a process with this cache."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[1],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
    )
    counts, result = done.stdout.splitlines()[-2:]
    loaded, compiled = map(int, counts.split())
    return loaded, compiled, result


def test_a_second_process_compiles_nothing_and_computes_the_same(tmp_path: Path) -> None:
    """What a process has just compiled runs with callees of its own, what it loads with the ones in the cache.

    To compile all kernels takes a minute. So it is done where all tests find them, if nobody has done it yet; and of
    the same kernels on the same machine the comparison is not made twice.
    """
    ours = Path(os.environ["NUMBA_CACHE_DIR"])
    folder = ours / sources_folder()
    compared = folder / f"compared-{sha256(SCRIPT.encode()).hexdigest()[:8]}.txt"
    if compared.exists():
        computed(ours)  # compiles what is not there: kernels may have been compared in another folder
        loaded, compiled, _ = computed(ours)
        assert (compiled, loaded > 10) == (0, True)
        return
    cache = tmp_path if any(folder.glob("*.nbi")) else ours
    loaded, _, first = computed(cache)
    if loaded:  # another process has compiled some meanwhile
        cache = tmp_path
        *_, first = computed(cache)
    loaded, compiled, second = computed(cache)
    assert (compiled, loaded > 10) == (0, True)
    assert second == first
    folder.mkdir(parents=True, exist_ok=True)
    compared.write_text("compiled and loaded kernels gave the same results here\n")
