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
}
"""Name of each format's file in a run's folder."""

FILM_NAMES: dict[Film, str] = {"slowmotion": "slowmotion.mp4", "exact": "exact_time.mp4", "overlay": "overlay.mp4"}
"""Name of each film's file there."""

PLATE = "motion_plate.png"
"""The background behind the person of motion.glb, beside it."""

EXPORTED_NAMES: tuple[str, ...] = (*FILE_NAMES.values(), PLATE, *FILM_NAMES.values())

RESULT = "result.json"
"""The facts of a finished result; it is there last."""

RECORD = "record.json"
"""The part of a result for MLflow, where it could not be reached: `hfb record` reads it."""

REPORT, CURVES, PAGE_FILM = "report.html", "curves.json", "page_film.mp4"
"""The page about a result, what its curves show, and its film among the intermediate files."""

NEEDS_BODY: tuple[MotionFormat, ...] = ("glb",)
"""Formats with a surface; the others need nothing but the motion."""


def check_formats(formats: Sequence[MotionFormat]) -> None:
    """Check that libraries for the formats are installed.

    Args:
        formats: formats that will be written.

    Raises:
        InputError: one is missing.
    """
    if "c3d" in formats and find_spec("c3d") is None:
        raise InputError("joints.c3d needs the c3d library: pip install 'hfb[c3d]', or leave c3d out of the formats")
