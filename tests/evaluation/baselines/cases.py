"""A case folder around nothing: for methods that use only its number, or the files that a test puts there."""

from pathlib import Path

from hfb.datasets.case import Case


def bare_case(folder: Path, frames: int = 1, number: int = 1, **facts: object) -> Case:
    """No file is written."""
    return Case(folder, number, frames, 0.5, {"number": number, "frames": frames, "blur_rate": 0.5, **facts})
