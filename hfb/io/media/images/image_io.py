"""Reading and writing of still images: float32 RGB in [0, 1], sRGB as stored, upright."""

import warnings
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_access import FORMATS, PIXEL_LIMIT, read_bytes
from hfb.io.media.images.image_decoding import decode_picture, picture_size
from hfb.photometry import Transfer
from hfb.typing import Array, Float

__all__ = [
    "PIXEL_LIMIT",
    "picture_size",
    "read_matte",
    "read_picture_srgb",
    "recorded_exposure",
    "stored_png",
    "write_matte",
    "write_png",
]

_EXIF_DIRECTORY, _EXPOSURE_TAG = 0x8769, 0x829A


def read_picture_srgb(path: Path, transfer: Transfer = "srgb") -> Float[Array, "H W 3"]:
    """Read an image of 8 to 16 bits per channel; see `hfb.io.media.images.image_decoding.decode_picture`.

    Args:
        path: the image file.
        transfer: the light that the user knows it to store; the values stay as they are unless it is ``srgb``.

    Raises:
        InputError: missing, empty, truncated, too large, or no image; the text names the fix.
    """
    return decode_picture(Path(path), transfer).pixels


def stored_png(path: Path) -> bytes:
    """Read a PNG file's bytes after decoding it once as a check; they go into pages and other files.

    Args:
        path: the image file.

    Raises:
        InputError: as `read_picture_srgb`, or it is an image of another kind.
    """
    data = read_bytes(path)
    decode_picture(path, data=data)
    if not data.startswith(b"\x89PNG"):
        raise InputError(f"{path}: is no PNG picture, whatever it is called; make the result again.")
    return data


def recorded_exposure(path: Path) -> tuple[float, str] | None:
    """Return a photograph's exposure time [s] by its EXIF, and where it is stated; None without.

    Args:
        path: the image file.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path, formats=FORMATS) as image:
                seconds = image.getexif().get_ifd(_EXIF_DIRECTORY).get(_EXPOSURE_TAG)
        value = float(seconds) if seconds is not None else 0.0
    except Exception:  # unreadable metadata is ignored
        return None
    return (value, f"the EXIF entry ExposureTime of {path.name}") if 0 < value < 10 else None


def write_png(path: Path, picture_srgb: Float[Array, "H W 3"], bits: int = 8) -> None:
    """Write an 8 or 16 bit PNG, atomically.

    Args:
        path: the image file.
        picture_srgb: in [0, 1]; clipped, rounded to nearest.
        bits: 8 or 16 per channel.
    """
    _write_levels(Path(path), picture_srgb[..., ::-1], bits)


def write_matte(path: Path, matte: Float[Array, "H W"]) -> None:
    """Write a 16-bit gray PNG (steps of 1/65535), atomically.

    Args:
        path: the image file.
        matte: in [0, 1].
    """
    _write_levels(Path(path), matte, 16)


def read_matte(path: Path) -> Float[Array, "H W"]:
    """Read a matte: the mean of the channels of any image that `read_picture_srgb` reads, its values as they are.

    Args:
        path: the image file.
    """
    return read_picture_srgb(path, "linear").mean(-1, dtype=np.float32)


def _write_levels(path: Path, values: Float[Array, "..."], bits: int) -> None:
    if bits not in (8, 16):
        raise ValueError(f"a PNG holds 8 or 16 bits per channel, not {bits}")
    full = (1 << bits) - 1
    levels = np.clip(values, 0, 1, dtype=np.float64)
    levels *= full  # in place: a clip's strip takes 85 MB a copy
    np.round(levels, out=levels)
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(levels, np.uint8 if bits == 8 else np.uint16))
    if not done:
        raise OSError(f"{path}: the picture could not be encoded")
    write_bytes_atomic(path, encoded.tobytes())
