"""The wheel holds one top-level package, its marker for type checkers, and every file that the code reads."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names of the files in a wheel, built from a copy of this checkout: setuptools leaves folders beside it."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False).stdout
    if not listed:
        pytest.skip("this checkout is no git repository")
    for name in listed.decode().split("\0"):
        if name.startswith(("hfb", "flows", "tasks", "pyproject", "README", "LICENSE", "NOTICE")):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            if (ROOT / name).is_symlink():
                (source / name).symlink_to((ROOT / name).readlink())
            elif (ROOT / name).exists():
                (source / name).write_bytes((ROOT / name).read_bytes())
    ready = source / "hfb/kernels/ready_made/hfb-0000000000000000"
    ready.mkdir(parents=True)
    (ready / "kernel.nbi").touch()
    words = ["pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(source)]
    done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (path,) = folder.glob("hfb-*.whl")
    with zipfile.ZipFile(path) as archive:
        return set(archive.namelist())


def test_the_only_package_is_hfb(wheel: set[str]) -> None:
    tops = {name.partition("/")[0] for name in wheel}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"hfb"}


def test_every_module_and_data_file_is_in_it(wheel: set[str]) -> None:
    files = {path for room in ("hfb", "flows", "tasks") for path in (ROOT / room).rglob("*") if path.is_file()}
    ours = {"__pycache__", "ready_made"}  # of this machine
    kept = {path for path in files if not ours & set(path.parts) and not path.name.startswith(".")}
    names = {path.relative_to(ROOT).as_posix() for path in kept}
    wanted = {name if name.startswith("hfb/") else f"hfb/{name}" for name in names}
    assert len(wanted) > 500
    assert not wanted - wheel


def test_ready_made_kernels_are_in_it(wheel: set[str]) -> None:
    assert "hfb/kernels/ready_made/hfb-0000000000000000/kernel.nbi" in wheel


def test_type_checkers_read_its_types(wheel: set[str]) -> None:
    assert "hfb/py.typed" in wheel
