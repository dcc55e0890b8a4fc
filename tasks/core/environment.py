"""Everything besides options and inputs that decides a result's last bits: code, libraries and machine."""

from __future__ import annotations

import functools
import hashlib
import platform
import re
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import hfb

_CPUINFO = Path("/proc/cpuinfo")
_LIBRARIES = ("torch", "numpy", "numba", "scipy", "opencv-python-headless", "av", "ai-edge-litert", "prefect", "mlflow")
_COMMIT = re.compile(r"[0-9a-f]{40,64}")
_COMPUTING = ("numpy", "numba", "torch")


@functools.cache
def code_version() -> str:
    """Return the version, a hash of every source and data file of the method and the tasks, and the key libraries."""
    content = hashlib.sha256()
    root = Path(hfb.__file__).parent
    for folder in sorted({*root.iterdir()} - {root / "flows"}):
        base = folder.resolve()  # tasks is a link where hfb is installed from a checkout
        for path in sorted(base.rglob("*")) if base.is_dir() else [base]:
            if path.is_file() and "__pycache__" not in path.parts:
                content.update(f"{folder.name}/{path.relative_to(base)}".encode() + b"\0")
                content.update(hashlib.sha256(path.read_bytes()).digest())
    libraries = ",".join(f"{name}={version(name)}" for name in _COMPUTING)
    return f"{hfb.__version__}+{content.hexdigest()[:16]};{libraries}"


@functools.cache
def source_commit() -> str | None:
    """Return the commit of the checkout that hfb runs from; None of a wheel. Git's files are read, nothing is run."""
    place = Path(hfb.__file__).parents[1] / ".git"
    with suppress(OSError):
        if place.is_file():  # of a worktree
            place = place.parent / place.read_text().removeprefix("gitdir:").strip()
        common = place / "commondir"
        shared = place / common.read_text().strip() if common.is_file() else place
        head = (place / "HEAD").read_text().strip()
        name = head.removeprefix("ref:").strip()
        packed = shared / "packed-refs"
        lines = packed.read_text().splitlines() if packed.is_file() else []
        known = {ref: commit for commit, _, ref in (line.partition(" ") for line in lines)}
        loose = shared / name
        found = head if name == head else loose.read_text().strip() if loose.is_file() else known.get(name, "")
        return found if _COMMIT.fullmatch(found) else None
    return None


def environment() -> dict[str, str]:
    """Return versions, the system and the kind of processor, as tags of a run; the host's name is left out."""
    versions = {f"version.{name}": _version(name) for name in _LIBRARIES}
    return {
        "version.hfb": hfb.__version__,
        **versions,
        "version.python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _processor(),
        "device": "cpu",
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # one that not every machine has wheels of
        return "none"


def _processor() -> str:
    """Return the processor's model: compiled kernels and sums follow its instructions."""
    told: dict[str, str] = {}
    with suppress(OSError):  # not Linux
        for line in _CPUINFO.read_text(encoding="utf-8", errors="replace").partition("\n\n")[0].splitlines():
            name, _, value = line.partition(":")
            told[name.strip()] = value.strip()
    words = [told[name] for name in ("model name", "cpu family", "model", "stepping") if told.get(name)]
    return " ".join(words) or platform.processor() or platform.machine()
