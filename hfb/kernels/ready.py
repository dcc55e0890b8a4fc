"""Ready-made kernels: compiled by an installation into the package, for its machine, on several cores.

    python -m hfb.kernels.ready     # `make setup` does it

`signatures.txt` has the kernels and types that commands use: the one that takes longest, then the others in the order
of their first use.
"""

import importlib
import os
import shutil
import sys
from multiprocessing import Process
from pathlib import Path

from numba.core.sigutils import normalize_signature

from hfb.kernels.compile import READY, compile_unless_taken, keep_in, sources_folder

_PROCESSES = 3  # each takes half a gigabyte


def _compile_listed() -> None:
    """Compile what neither is there nor is being compiled by another process."""
    for line in (Path(__file__).parent / "signatures.txt").read_text().splitlines():
        name, bracket, types = line.partition("(")
        module, _, function = name.rpartition(".")
        kernel = getattr(importlib.import_module(f"hfb.kernels.{module}"), function)
        compile_unless_taken(kernel, normalize_signature(bracket + types)[0])


def main() -> None:
    """Compile all kernels into the package, each by one of several processes."""
    folder = READY / sources_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        sys.exit(f"{READY} cannot be written ({error.strerror}): each user's first command compiles the kernels")
    for old in set(READY.glob("hfb-*")) - {folder}:
        shutil.rmtree(old)
    keep_in(READY)
    processes = [Process(target=_compile_listed) for _ in range(min(os.cpu_count() or 1, _PROCESSES))]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    for lock in folder.glob("*.lock"):
        lock.unlink()
    sys.exit(any(process.exitcode for process in processes))


if __name__ == "__main__":
    main()
