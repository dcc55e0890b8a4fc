"""Names of exported files, and the libraries that they need. Light to import."""

from collections.abc import Sequence
from importlib.util import find_spec

from hfb.config import Film, MotionFormat
from hfb.errors import InputError

FILE_NAMES: dict[MotionFormat, str] = {
    "amass": "amass.npz",
    "glb": "motion.glb",
    "bvh": "motion.bvh",
    "csv": "joints.csv",
    "trc": "joints.trc",
    "c3d": "joints.c3d",
    "usd": "motion.usdz",
}
"""Name of each format's file in a run's folder."""

FILM_NAMES: dict[Film, str] = {"slowmotion": "slowmotion.mp4", "exact": "exact_time.mp4", "overlay": "overlay.mp4"}
"""Name of each film's file there."""

_LIBRARIES: dict[MotionFormat, tuple[str, str]] = {"c3d": ("c3d", "c3d"), "usd": ("pxr", "usd-core")}
"""Module and library that a format needs; the extra is called by the format."""

PLATE = "motion_plate.png"
"""The background behind the person, beside files with a camera."""

EXPORTED_NAMES: tuple[str, ...] = (*FILE_NAMES.values(), PLATE, *FILM_NAMES.values())

RESULT = "result.json"
"""The facts of a finished result; it is there last."""

RECORD = "record.json"
"""The part of a result for MLflow, where it could not be reached: `hfb record` reads it."""

REPORT, CURVES, PAGE_FILM = "report.html", "curves.json", "page_film.mp4"
"""The page about a result, what its curves show, and its film among the intermediate files."""

NEEDS_BODY: tuple[MotionFormat, ...] = ("glb", "usd")
"""Formats with a surface and a camera; the others need nothing but the motion."""


def check_formats(formats: Sequence[MotionFormat]) -> None:
    """Check that libraries for the formats are installed.

    Args:
        formats: formats that will be written.

    Raises:
        InputError: one is missing.
    """
    for form, (module, library) in _LIBRARIES.items():
        if form in formats and find_spec(module) is None:
            fix = f"pip install 'hfb[{form}]', or leave {form} out of the formats"
            raise InputError(f"{FILE_NAMES[form]} needs the {library} library: {fix}")
