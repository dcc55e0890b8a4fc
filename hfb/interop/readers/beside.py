"""Companion files of a result. Light to import."""

from pathlib import Path

_TRAM_CAMERA = "camera.npy"
"""TRAM writes hps/hps_track_0.npy and, one folder up, the camera that it is about."""


def companions(path: Path) -> tuple[Path, ...]:
    """Return the files that must be read together with a result file.

    Args:
        path: the result file.
    """
    if path.suffix != ".npy" or not path.name.startswith("hps_track"):
        return ()
    places = (path.parent / _TRAM_CAMERA, path.parent.parent / _TRAM_CAMERA)
    return next(((place,) for place in places if place.is_file()), ())
