"""Images of a call in Python, as files: paths stay, arrays and PIL images are written without loss of 8-bit values."""

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias, cast

import numpy as np
from PIL import Image as Pillow
from PIL import ImageOps

from hfb.errors import InputError
from hfb.io.media.images.image_io import write_png
from hfb.photometry import linear_to_srgb
from hfb.tasks.core.handles import StaleFile
from hfb.typing import Array, Tensor

Image: TypeAlias = str | os.PathLike[str] | Pillow.Image | Array | Tensor
"""A file, a PIL image, or an array (H, W, 3): uint8 is sRGB, floating point is linear light in [0, 1]."""

_KEPT_MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "I;16")


def image_files(frames: object, folder: Path) -> list[Path]:
    """Return the files of frames.

    Args:
        frames: one image, or several in their order.
        folder: where images without a file are written.

    Raises:
        InputError: an image is of another type, shape or range.
    """
    if not is_one_image(frames) and not isinstance(frames, Iterable):
        what = type(frames).__name__
        raise InputError(f"frames is a {what}: give a path, a PIL image or an array, or several in a list")
    several: list[object] = [frames] if is_one_image(frames) else list(cast(Iterable[object], frames))
    if not several:
        raise InputError("there are no frames: give at least one")
    return [image_file(one, f"frame_{n}", folder) for n, one in enumerate(several)]


def is_one_image(frames: object) -> bool:
    """Return whether something is an image itself and no sequence of images.

    Args:
        frames: as a caller gave them.
    """
    return isinstance(frames, str | os.PathLike | Pillow.Image) or getattr(frames, "ndim", 0) == 3


def path_of(place: str | os.PathLike[str]) -> Path:
    """Return the path of a file or folder; ``~`` is the user's home, as in a shell.

    Args:
        place: as a caller gave it.
    """
    path = Path(place)
    return Path.home().joinpath(*path.parts[1:]) if path.parts[:1] == ("~",) else path


def image_file(image: object, name: str, folder: Path) -> Path:
    """Return the file of an image.

    Args:
        image: as of `Image`.
        name: of the image, for errors.
        folder: where an image without a file is written.

    Raises:
        InputError: it is of another type, shape or range.
    """
    if isinstance(image, str | os.PathLike):
        return path_of(image)
    path = folder / f"{name}.png"
    if isinstance(image, Pillow.Image):
        upright = ImageOps.exif_transpose(image)
        (upright if upright.mode in _KEPT_MODES else upright.convert("RGB")).save(path)
        return path
    array = image.detach().cpu().numpy() if isinstance(image, Tensor) else image
    if not isinstance(array, np.ndarray):
        raise InputError(f"{name} is a {type(image).__name__}: give a path, a PIL image or an array")
    if array.ndim != 3 or array.shape[2] != 3 or not array.size:
        raise InputError(f"{name} has the shape {array.shape}: give an array (height, width, 3) of RGB")
    if array.dtype == np.uint8:
        write_png(path, array.astype(np.float32) / 255)
        return path
    if array.dtype.kind != "f":
        raise InputError(
            f"{name} is of type {array.dtype}: give uint8 (sRGB) or floating point (linear light in [0, 1])"
        )
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds values that are not finite: replace NaN and infinity")
    if array.min() < 0 or array.max() > 1:
        raise InputError(
            f"{name} has values from {array.min():.3g} to {array.max():.3g}: floating point is linear light in [0, 1]; "
            "values of 0 to 255 are given as uint8"
        )
    write_png(path, linear_to_srgb(np.asarray(array, np.float64)), bits=16)
    return path


@contextmanager
def errors_of_calls(folder: Path | None = None) -> Iterator[None]:
    """Word errors for callers in Python: no private folder, keyword arguments in place of flags.

    Args:
        folder: where images without a file were written.

    Raises:
        InputError: as raised inside, in other words; for a loss that is not finite and a changed file, too.
    """
    try:
        yield
    except InputError as error:
        said = str(error) if folder is None else str(error).replace(f"{folder}{os.sep}", "").replace(str(folder), "")
        said = said.replace("--out", "folder")
        raise type(error)(re.sub(r"--([a-z][a-z0-9.-]*)", lambda flag: flag[1].replace("-", "_"), said)) from error
    except StaleFile as error:
        raise InputError(f"{error}: an image was changed or removed meanwhile; fit again") from error
    except FloatingPointError as error:
        raise InputError(f"{error}: check terms and priors of your own, or take smaller learning rates") from error
