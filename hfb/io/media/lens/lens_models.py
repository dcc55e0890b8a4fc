"""Distortion models of calibrations: OpenCV's standard one, OpenCV's fisheye, or an unsupported one.

Both have lists of four numbers (k1 k2 p1 p2 against k1 k2 k3 k4), so that only the file's own words distinguish them.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.typing import Array, Float

_STANDARD = frozenset(
    (
        "none",
        "nodistortion",
        "perspective",
        "pinhole",
        "simplepinhole",
        "plumbbob",
        "radtan",
        "radtan5",
        "radtan8",
        "radialtangential",
        "brown",
        "brownconrady",
        "distortionbrownconrady",
        "opencv",
        "fullopencv",
        "opencv5",
        "opencv8",
        "rational",
        "rationalpolynomial",
        "thinprism",
        "tilted",
        "standard",
        "polynomial",
        "frame",
    )
)
_FISHEYE = frozenset(
    (
        "equidistant",
        "equi",
        "equidistant4",
        "equidist",
        "fisheye",
        "fisheyeopencv",
        "opencvfisheye",
        "fisheyepolynomial",
        "kannalabrandt",
        "kannalabrandt4",
        "kannalabrandt8",
        "distortionkannalabrandt4",
        "kb",
        "kb4",
        "kb8",
        "equidistantfisheye",
        "fisheyeequidistant",
    )
)
_OTHER = frozenset(
    (
        "fov",
        "atan",
        "ftheta",
        "distortionftheta",
        "omni",
        "omnidirectional",
        "mei",
        "catadioptric",
        "ds",
        "doublesphere",
        "ucm",
        "eucm",
        "unified",
        "extendedunified",
        "fullunifiedmodel",
        "division",
        "divisionmodel",
        "scaramuzza",
        "ocam",
        "ocamcalib",
        "equisolid",
        "equisolidfisheye",
        "stereographic",
        "orthographic",
        "orthogonal",
        "dual",
        "spherical",
        "cylindrical",
        "panoramic",
        "inversebrownconrady",
        "distortioninversebrownconrady",
        "modifiedbrownconrady",
        "distortionmodifiedbrownconrady",
        "fisheye62",
        "fisheye624",
        "thinprismfisheye",
        "radtanthinprismfisheye",
        "simpleradial",
        "radial",
        "simpleradialfisheye",
        "radialfisheye",
    )
)
_PINHOLE_AT_ZERO = frozenset(
    (
        "division",
        "divisionmodel",
        "inversebrownconrady",
        "distortioninversebrownconrady",
        "modifiedbrownconrady",
        "distortionmodifiedbrownconrady",
        "simpleradial",
        "radial",
    )
)
"""Other models that are a pinhole where all of their coefficients are zero."""

_MODEL_KEYS = ("distortionmodel", "distortiontype", "modeltype", "projectionmodel", "projectiontype", "projection")
"""Keys whose value is a model, known or not."""
_LOOSE_KEYS = ("cameramodel", "lensmodel", "model", "type", "lenstype", "cameratype", "lens", "intrinsictype")
"""Keys whose value may be a product's name, too."""
_LENGTHS = (4, 5, 8, 12, 14)
_BY_NAME = {False: ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), True: ("k1", "k2", "k3", "k4")}


def plain(word: str) -> str:
    """Return a word without case, spaces and signs: ``Plumb_Bob`` is ``plumbbob``.

    Args:
        word: a word of a file.
    """
    return re.sub(r"[^a-z0-9]", "", word.lower())


def is_fisheye(entries: Mapping[str, Any], coefficients: Float[Array, "n"], where: str) -> bool:
    """Return whether coefficients are those of OpenCV's fisheye model; else they are of its standard model.

    Args:
        entries: entries of one camera in its file.
        coefficients: coefficients of distortion.
        where: begins an error.

    Raises:
        InputError: they are of a model that is neither; the text names it.
    """
    fisheye = False
    for key, value in entries.items():
        name, model = plain(str(key)), plain(value) if isinstance(value, str) else ""
        if name == "xi":
            raise _unread(where, "omnidirectional (it has an xi)")
        if "fisheye" in name and not isinstance(value, dict | list):
            fisheye = fisheye or (model not in ("false", "0", "no", "none") if model else bool(value))
        elif name in (*_MODEL_KEYS, *_LOOSE_KEYS) and not (model in _PINHOLE_AT_ZERO and not coefficients.any()):
            if model in _OTHER or (name in _MODEL_KEYS and model and model not in _STANDARD | _FISHEYE):
                raise _unread(where, str(value)[:40])
            fisheye = fisheye or model in _FISHEYE
    return fisheye


def _unread(where: str, model: str) -> InputError:
    return InputError(
        f"{where}: its distortion model is {model}, which is not read; undistort the video first, or calibrate with "
        "OpenCV's standard or fisheye model."
    )


def checked_coefficients(values: Float[Array, "n"], fisheye: bool, where: str) -> Float[Array, "m"]:
    """Check coefficients and return them as OpenCV expects them.

    Args:
        values: values of a file.
        fisheye: whether the model is OpenCV's fisheye.
        where: begins an error.

    Raises:
        InputError: not as many as the model has, or not finite.
    """
    if not np.isfinite(values).all():
        raise InputError(f"{where}: its distortion is not finite; calibrate again.")
    if fisheye:
        if len(values) < 4 or values[4:].any():  # some drivers fill up to five with zeros
            raise InputError(f"{where}: a fisheye lens has 4 distortion coefficients, it has {len(values)}.")
        return values[:4]
    if not len(values):
        return np.zeros(4)
    if len(values) not in _LENGTHS:
        raise InputError(f"{where}: distortion must be 4, 5, 8, 12 or 14 numbers, as OpenCV has them.")
    return values


def named_coefficients(part: Mapping[str, Any], fisheye: bool, where: str) -> list[Any]:
    """Return coefficients that are stored by their names, in OpenCV's order.

    Args:
        part: coefficients by name.
        fisheye: whether the model is OpenCV's fisheye.
        where: begins an error.

    Raises:
        InputError: it has one that the model does not have.
    """
    order = _BY_NAME[fisheye]
    given = {plain(str(key)): value for key, value in part.items()}
    unknown = [key for key, value in given.items() if key not in order and value]
    if unknown:
        raise InputError(f"{where}: its distortion has {unknown[0][:20]}, which is none of {', '.join(order)}.")
    values = [given.get(name, 0.0) for name in order]
    return values if fisheye or any(values[5:]) else values[:5]
