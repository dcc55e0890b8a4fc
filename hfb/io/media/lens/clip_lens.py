"""The lens that clip.toml names: from Pose2Sim's Calib.toml, cameras.json, or OpenCV's, ROS' or Kalibr's file.

The camera's pose is read by `hfb.io.media.lens.camera_pose`, and not needed here.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.io.clip import ClipCamera
from hfb.io.media.lens.camera_files import number_of_camera
from hfb.io.media.lens.lens import Lens
from hfb.io.media.lens.lens_documents import read_document
from hfb.io.media.lens.lens_models import checked_coefficients, is_fisheye, named_coefficients, plain
from hfb.typing import Array, Float

_MATRIX = ("cameramatrix", "matrix", "k", "mtx", "intrinsicmatrix", "intrinsics", "intrinsic", "cameraintrinsics")
_DISTORTION = (
    "distortioncoefficients",
    "distortioncoeffs",
    "distcoeffs",
    "distcoefs",
    "distortions",
    "distortion",
    "dist",
    "distk1k2p1p2",
    "distortionparameters",
    "distcoef",
    "d",
)
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_SIZE = ("size", "resolution", "imagesize", "imgsize")
_MOST_SECTIONS = 200
_HARMLESS_SKEW_PX = 0.05
_WIDEST_DEG = 150.0  # of a pinhole's image
_OFF_CENTRE, _SAME_POINT = 0.25, 0.05


def clip_lens(camera: ClipCamera, video: str, height: int, width: int) -> Lens | None:
    """Return the calibrated lens of a clip; None where clip.toml names no calibration file.

    Args:
        camera: entries of clip.toml.
        video: the footage's file name: a calibration of several cameras is searched by it where no name is given.
        height: height of the footage's frames [px].
        width: width of the footage's frames [px].

    Raises:
        InputError: missing, damaged, no such camera in it, of a distortion model that is not read, or of images of
            another size.
    """
    path = camera.calibration
    if path is None:
        return None
    where, entries = choose_camera(path, camera.name, video)
    size = _size(entries)
    if size is not None and size != (height, width):
        raise InputError(
            f"{path}: is a calibration of {size[1]} x {size[0]} pixels and the footage has {width} x {height}; "
            "give the calibration of this camera at this size."
        )
    return _lens(where, entries)


def check_pinhole(K: tuple[tuple[float, float, float], ...], height: int, width: int) -> tuple[str, ...]:
    """Check that K belongs to images of a size; return what is doubtful, for the user.

    Args:
        K: calibration [px].
        height: height of the images [px].
        width: width of the images [px].

    Raises:
        InputError: no lens has such a focal length.
    """
    (fx, _, cx), (_, fy, cy), _ = K
    seen_deg = 2 * math.degrees(max(math.atan(width / (2 * fx)), math.atan(height / (2 * fy))))
    if seen_deg > _WIDEST_DEG:
        raise InputError(
            f"a focal length of {min(fx, fy):g} px shows {seen_deg:.0f} degrees in {width} x {height} pixels: give "
            "pixels (a lens' millimetres times the pixels and divided by the millimetres of the sensor's width)"
        )
    x, y = 2 * cx / width, 2 * cy / height
    if x <= 0 or abs(x - y) > _SAME_POINT * x or abs(x - 1) < _OFF_CENTRE:  # parts of a picture have it anywhere
        return ()
    middle = f"its principal point is the middle of {2 * cx:.0f} x {2 * cy:.0f} pixels"
    return (f"K seems to be of another size: {middle}, the pictures have {width} x {height}; scale K with them",)


def choose_camera(path: Path, name: str | None, video: str) -> tuple[str, dict[str, Any]]:
    """Return (beginning of an error, entries of the camera that took the video).

    Args:
        path: the calibration file.
        name: the camera's name, where the user states it.
        video: the footage's file name.

    Raises:
        InputError: missing, damaged, or no such camera in it.
    """
    document = read_document(path)
    if find_entry(document, _MATRIX) is not None:
        return str(path), document
    sections = _sections(document)
    if not sections:
        raise InputError(f"{path}: has no camera_matrix of 3 x 3 numbers; give a calibration as OpenCV writes it.")
    titles = [str(part.get("name", key)) for key, part in sections]
    number: int | None = 0
    if name is not None:
        number = next((at for at, (key, _) in enumerate(sections) if name in (titles[at], key)), None)
    elif len(sections) > 1:
        videos = [found if isinstance(found := part.get("video"), str) else None for _, part in sections]
        number = number_of_camera(list(zip(titles, videos, strict=True)), video)
    if number is None:
        listed = ", ".join(titles[:12])
        asked = f"has no camera {name}." if name is not None else f"which of its cameras took {video or 'this'}?"
        raise InputError(f"{path}: {asked} Set camera.name to one of {listed}.")
    key, part = sections[number]
    # A table called `fisheye` says what its numbers are.
    return f"{path}: camera {titles[number]}", {"fisheye": True, **part} if "fisheye" in plain(key) else part


def _sections(document: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return cameras by their names: tables that have a matrix, at the top, or within one table as in cameras.json."""
    tables = [(str(key), part) for key, part in list(document.items())[:_MOST_SECTIONS] if isinstance(part, dict)]
    inner = [(str(key), part) for _, table in tables for key, part in list(table.items())[:_MOST_SECTIONS]]
    for level in (tables, inner):
        found = [(key, part) for key, part in level if isinstance(part, dict) and find_entry(part, _MATRIX) is not None]
        if found:
            return found[:_MOST_SECTIONS]
    return []


def _lens(where: str, entries: dict[str, Any]) -> Lens:
    K = _matrix(where, find_entry(entries, _MATRIX))
    given = find_entry(entries, _DISTORTION)
    if isinstance(given, dict) and "data" in given:
        given = given["data"]
    if isinstance(given, dict):  # by their names, maybe with the model's between them
        words = {key: value for key, value in given.items() if isinstance(value, str)}
        named = {key: value for key, value in given.items() if key not in words}
        fisheye = is_fisheye({**entries, **words}, flat_numbers(list(named.values()), where), where)
        given = named_coefficients(named, fisheye, where)
    else:
        given = [] if given is None else given
        fisheye = is_fisheye(entries, flat_numbers(given, where), where)
    values = checked_coefficients(flat_numbers(given, where), fisheye, where)
    fx, fy, cx, cy = (float(one) for one in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    return Lens((fx, fy, cx, cy), tuple(float(one) for one in values), fisheye)


def _matrix(where: str, value: Any) -> Float[Array, "3 3"]:
    """Read K from nine numbers, or from Kalibr's fx fy cx cy."""
    flat = flat_numbers(value.get("data") if isinstance(value, dict) else value, where)
    if flat.size == 4:
        K = np.array([[flat[0], 0, flat[2]], [0, flat[1], flat[3]], [0, 0, 1]])
    elif flat.size == 9:
        K = flat.reshape(3, 3)
    else:
        raise InputError(f"{where}: has no camera_matrix of 3 x 3 numbers; give a calibration as OpenCV writes it.")
    if not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise InputError(f"{where}: its camera matrix or distortion is impossible; calibrate again.")
    if abs(K[0, 1]) > _HARMLESS_SKEW_PX or K[1, 0] != 0 or K[2].tolist() != [0, 0, 1]:
        raise InputError(f"{where}: its camera matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], without a skew.")
    return K


def find_entry(entries: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    """Return the entry of the first of some names, in any spelling; None where there is none.

    Args:
        entries: of one camera.
        names: without case, spaces and signs.
    """
    known = {plain(str(key)): value for key, value in entries.items() if value is not None}
    return next((known[name] for name in names if name in known), None)


def flat_numbers(value: Any, where: str) -> Float[Array, "n"]:
    """Return the numbers of an entry in a row.

    Args:
        value: of the file.
        where: begins an error.

    Raises:
        InputError: they are no numbers.
    """
    try:
        return np.array(value, np.float64).ravel()
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{where}: its camera matrix, distortion or pose are not numbers; export it again.") from None


def _size(entries: dict[str, Any]) -> tuple[int, int] | None:
    """Return (height, width) [px] where the file states it."""
    pair = find_entry(entries, _SIZE)
    apart = [find_entry(entries, _HEIGHT), find_entry(entries, _WIDTH)]
    sides = [*reversed(pair)] if isinstance(pair, list) and len(pair) == 2 else apart
    known = all(isinstance(side, int | float) and 0 < side < 1 << 16 for side in sides)
    return (int(sides[0]), int(sides[1])) if known else None
