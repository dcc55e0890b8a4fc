"""What computes, besides our own code: the machine and the versions that decide a result's last bits."""

from __future__ import annotations

import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hfb import __version__

_CPUINFO = Path("/proc/cpuinfo")
_LIBRARIES = (
    "torch", "numpy", "numba", "scipy", "opencv-python-headless", "av", "ai-edge-litert", "prefect", "mlflow",
)  # fmt: skip


def environment() -> dict[str, str]:
    """Versions, the system and the kind of processor, as tags of a run. The host's name is nobody's business."""
    versions = {f"version.{name}": _version(name) for name in _LIBRARIES}
    return {
        "version.hfb": __version__, **versions, "version.python": platform.python_version(),
        "platform": platform.platform(), "processor": _processor(), "device": "cpu",
    }  # fmt: skip


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # one that not every machine has wheels of
        return "none"


def _processor() -> str:
    """The model of the processor: compiled kernels and sums follow its instructions."""
    told: dict[str, str] = {}
    with suppress(OSError):  # not Linux
        for line in _CPUINFO.read_text(encoding="utf-8", errors="replace").partition("\n\n")[0].splitlines():
            name, _, value = line.partition(":")
            told[name.strip()] = value.strip()
    words = [told[name] for name in ("model name", "cpu family", "model", "stepping") if told.get(name)]
    return " ".join(words) or platform.processor() or platform.machine()
