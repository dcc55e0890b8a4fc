"""Which files footage is made of: a video, or pictures in the order in which they were taken."""

import re
from collections.abc import Sequence
from pathlib import Path

from hfb.errors import InputError
from hfb.media.pictures import PIXEL_LIMIT, picture_size

PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
_PLATE_NAME = re.compile(r"^(.*_)?(plate|background)$", re.IGNORECASE)
"""A picture of the empty scene that lies among the frames is none of them."""


def natural_order(paths: Sequence[Path]) -> list[Path]:
    """By name, numbers in it as numbers: ``f2.png`` before ``f10.png``."""

    def key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
        parts = re.split(r"(\d+)", path.name)
        return [
            (0, int(part[:18]), "") if part.isdigit() else (1, 0, part.lower()) for part in parts if part
        ], path.name

    return sorted(paths, key=key)


def footage_files(source: Path | Sequence[Path]) -> tuple[Path, ...]:
    """A video by itself, the pictures of a folder in their natural order, or the given pictures.

    Raises:
        InputError: nothing there.
    """
    if not isinstance(source, Path):
        if not source:
            raise InputError("the list of pictures is empty; give at least one.")
        return tuple(source)
    if source.is_dir():
        found = [one for one in source.iterdir() if one.suffix.lower() in PICTURE_SUFFIXES and one.name[0] != "."]
        found = [one for one in found if not _PLATE_NAME.search(one.stem)]
        if not found:
            raise InputError(f"{source}: holds no picture; give a folder of PNG, JPEG, TIFF, WebP or BMP frames.")
        return tuple(natural_order(found))
    if not source.exists():
        raise InputError(f"{source}: no such file; check the path.")
    return (source,)


def one_size(files: Sequence[Path]) -> tuple[int, int, int]:
    """height, width, bits; the files' heads alone are read.

    Raises:
        InputError: one is no picture, of another size, or too large.
    """
    sizes = [picture_size(path) for path in files]
    height, width, _ = sizes[0]
    for path, other in zip(files, sizes, strict=True):
        if other[:2] != (height, width):
            raise InputError(
                f"{path}: has {other[1]} x {other[0]} pixels and {files[0].name} {width} x {height}; "
                "give frames of one size."
            )
    if height * width > PIXEL_LIMIT:
        raise InputError(f"{files[0]}: {width} x {height} pixels are too many; make the frames smaller.")
    return height, width, max(one[2] for one in sizes)
