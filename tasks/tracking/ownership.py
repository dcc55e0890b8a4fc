"""Ownership of runs: a killed process leaves its run RUNNING, which the next start detects.

A run is marked with its owner: host, process number and start of that process, since numbers are reused.
"""

from __future__ import annotations

import functools
import os
import platform
import subprocess
from pathlib import Path

_BOOT = Path("/proc/sys/kernel/random/boot_id")
_STARTED_FIELD = 19  # of what follows the name in /proc/PID/stat: the start, in ticks since the machine came up
_STATE_FIELD = 0


@functools.cache
def _owner_of(process: int) -> str:
    return f"{platform.node()}/{process}/{_beginning(process) or '-'}"


def owner() -> str:
    """Return a mark that identifies this process among all that ever ran on this machine."""
    return _owner_of(os.getpid())


def is_abandoned(mark: str) -> bool:
    """Return whether the process of a run's mark is certainly gone; processes of other machines are not known here.

    Args:
        mark: as `owner` returned it.
    """
    host, _, rest = mark.rpartition("/")[0].rpartition("/")
    began = mark.rpartition("/")[2]
    if host != platform.node() or not rest.isdigit() or began == "-":
        return False
    return _beginning(int(rest)) != began


def _beginning(process: int) -> str | None:
    """Return when a process began, in the system's own format; None where there is no such process."""
    if _BOOT.exists():
        try:
            fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return None
        if fields[_STATE_FIELD] in "ZX":  # ended, its parent has not looked yet
            return None
        return f"{_BOOT.read_text().strip()[:8]}.{fields[_STARTED_FIELD]}"
    told = subprocess.run(["ps", "-o", "lstart=", "-p", str(process)], capture_output=True, text=True, check=False)
    return "-".join(told.stdout.split()) or None
