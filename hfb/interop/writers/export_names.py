"""Names of exported files, and the libraries and programs that they need. Light to import."""

import os
import shutil
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from hfb.config import Film, MotionFormat
from hfb.errors import InputError, install_advice

FILE_NAMES: dict[MotionFormat, str] = {
    "amass": "amass.npz",
    "glb": "motion.glb",
    "bvh": "motion.bvh",
    "csv": "joints.csv",
    "trc": "joints.trc",
    "c3d": "joints.c3d",
    "usd": "motion.usdz",
    "fbx": "motion.fbx",
    "abc": "motion.abc",
}
"""Name of each format's file in a run's folder."""

FILM_NAMES: dict[Film, str] = {"slowmotion": "slowmotion.mp4", "exact": "exact_time.mp4", "overlay": "overlay.mp4"}
"""Name of each film's file there."""

_LIBRARIES = {
    "c3d": (FILE_NAMES["c3d"], "c3d", "c3d", "c3d"),
    "usd": (FILE_NAMES["usd"], "usd", "pxr", "usd-core"),
    "mot": ("motion.mot", "opensim", "opensim", "opensim"),
}
"""File, extra, module and library of formats that need one."""

PLATE = "motion_plate.png"
"""The background behind the person, beside files with a camera."""

EXPORTED_NAMES: tuple[str, ...] = (*FILE_NAMES.values(), PLATE, *FILM_NAMES.values())

RESULT = "result.json"
"""The facts of a finished result; it is there last."""

RECORD = "record.json"
"""The part of a result for MLflow, where it could not be reached: `hfb record` reads it."""

REPORT, CURVES, PAGE_FILM = "report.html", "curves.json", "page_film.mp4"
"""The page about a result, what its curves show, and its film among the intermediate files."""

LINKED_FILES = {
    "motion.glb": "the body with skeleton and texture, for Blender and other viewers of glTF",
    "motion.usdz": "the same for programs that read USD",
    "motion.fbx": "the slow motion as Blender writes FBX",
    "motion.abc": "the slow motion as Blender writes Alembic",
    "motion.bvh": "the skeleton's motion for other rigs",
    "amass.npz": "the motion in AMASS's layout",
    "joints.csv": "positions of the joints as a table",
    "joints.trc": "positions of the joints for OpenSim",
    "joints.c3d": "positions of the joints for biomechanics programs",
    "slowmotion.mp4": "the motion slowed down, beside the blurred picture",
    "exact_time.mp4": "the motion at its true times",
    "overlay.mp4": "the body over the pictures",
    "strip.png": "the strip above at its full size",
    "motion.npz": "poses, shape and joints for programs in Python",
    "alternatives.npz": "other motions that explain the picture",
    RESULT: "all figures, options and warnings",
}
"""Files beside a page that it links to, and what they are."""

BLENDER = "HFB_BLENDER"
"""The variable that names Blender's program."""

NEEDS_BODY: tuple[MotionFormat, ...] = ("glb", "usd", "fbx", "abc")
"""Formats with a surface and a camera; the others need nothing but the motion."""


def find_blender() -> Path | None:
    """Return Blender's program, or a Python that has its module; None where there is neither.

    Raises:
        InputError: the variable names no program.
    """
    named = os.environ.get(BLENDER)
    program = shutil.which(named or "blender")
    if named and program is None:
        raise InputError(f"{BLENDER} names no program: {named}; give the path of blender, or of a Python that has bpy")
    if program is None and find_spec("bpy") is not None:
        program = sys.executable
    return Path(program) if program else None


def check_formats(formats: Sequence[str]) -> None:
    """Check that libraries and programs for the formats are installed.

    Args:
        formats: formats that will be written.

    Raises:
        InputError: one is missing.
    """
    if {"fbx", "abc"} & set(formats) and find_blender() is None:
        raise InputError(
            f"motion.fbx and motion.abc need Blender: install it, or name it in {BLENDER} (blender, or a Python that "
            "has bpy), or leave fbx and abc out of the formats"
        )
    for form, (name, extra, module, library) in _LIBRARIES.items():
        if form in formats and find_spec(module) is None:
            fix = f"{install_advice(extra)}; or leave {form} out of the formats"
            raise InputError(f"{name} needs the {library} library: {fix}")
