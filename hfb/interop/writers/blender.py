"""Blender as a program: the one that ``HFB_BLENDER`` names, that on the path, or its module for Python (`bpy`)."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from hfb.errors import InputError

VARIABLE = "HFB_BLENDER"
_PATIENCE_S = 600
_SAID = 300  # characters of its last words


def find_blender() -> Path | None:
    """Return Blender's program, or a Python that has its module; None where there is neither.

    Raises:
        InputError: the variable names no program.
    """
    named = os.environ.get(VARIABLE)
    program = shutil.which(named or "blender")
    if named and program is None:
        raise InputError(f"{VARIABLE} names no program: {named}; give the path of blender, or of a Python that has bpy")
    if program is None and find_spec("bpy") is not None:
        program = sys.executable
    return Path(program) if program else None


def run_blender(script: Path, words: Sequence[str]) -> str:
    """Run a script in Blender without a window and without the user's settings; return what it printed.

    Args:
        script: of Python; its arguments are those behind ``--``.
        words: the arguments.

    Raises:
        InputError: there is no Blender, or the script failed in it.
    """
    program = find_blender()
    if program is None:
        raise InputError(
            f"there is no Blender: install it, or name it in {VARIABLE} (blender itself, or a Python that has bpy)"
        )
    flags = ["--background", "--factory-startup", "--python-exit-code", "1", "--python"]
    before = [] if program.name.startswith("python") else flags
    done = subprocess.run(
        [program, *before, script, "--", *words],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=_PATIENCE_S,
        check=False,
    )
    if done.returncode:
        raise InputError(f"{program} could not do it: {(done.stderr or done.stdout).strip()[-_SAID:]}")
    return done.stdout
