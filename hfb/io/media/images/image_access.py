"""Access to an image file: its bytes within limits, and errors for other files."""

from pathlib import Path

from hfb.errors import InputError
from hfb.io.media.images.image_kinds import foreign_kind

PIXEL_LIMIT = 40_000_000
"""Largest number of pixels of an image, or a frame of a video (8K has 33 million): as float32 RGB 0.5 GB, with a
decoder's copies of 16 bits 1.5 GB."""

FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP")
KINDS = "a PNG, JPEG, TIFF, WebP or BMP picture"

_BYTE_LIMIT = 512 << 20


def read_bytes(path: Path) -> bytes:
    """Read an image file's content.

    Args:
        path: the image file.

    Raises:
        InputError: it cannot be read, is empty or absurdly large.
    """
    try:
        size = path.stat().st_size
        if size > _BYTE_LIMIT:
            raise InputError(f"{path}: {size >> 20} MiB is too large for a picture; give {KINDS}.")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path.") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the picture's file.") from None
    except PermissionError:
        raise InputError(f"{path}: may not be read; check its permissions.") from None
    if not data:
        raise InputError(f"{path}: the file is empty; export or copy the picture again.")
    return data


def no_picture(path: Path) -> InputError:
    """Build the error for a file that no decoder reads: it names the file's kind, where that is known.

    Args:
        path: the image file.
    """
    try:
        with path.open("rb") as file:
            kind = foreign_kind(file)
    except OSError:
        kind = None
    return InputError(f"{path}: {kind}." if kind else f"{path}: is not a picture; give {KINDS}.")


def damaged(path: Path, error: Exception) -> InputError:
    """Build the error for an image that a decoder could not finish.

    Args:
        path: the image file.
        error: error of the decoder.
    """
    reason = " ".join(str(error).split())[:120] or type(error).__name__
    return InputError(f"{path}: the picture is truncated or damaged ({reason}); export or copy it again.")


def too_large(path: Path, what: str) -> InputError:
    """Build the error for more pixels than `PIXEL_LIMIT`.

    Args:
        path: the image file.
        what: number of pixels or sides, as text.
    """
    return InputError(f"{path}: {what} is over the limit of {PIXEL_LIMIT // 1_000_000} megapixels; make it smaller.")
