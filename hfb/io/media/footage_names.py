"""Names of frames and of background plates in a folder. Light to import."""

import re
from collections.abc import Iterable
from pathlib import Path

PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
_FOREIGN_SUFFIXES = frozenset(
    {
        *(".nef", ".nrw", ".cr2", ".cr3", ".crw", ".arw", ".sr2", ".srf", ".dng", ".raf", ".orf", ".rw2", ".pef"),
        *(".srw", ".3fr", ".fff", ".iiq", ".x3f", ".mrw", ".kdc", ".dcr", ".erf", ".gpr"),
        *(".heic", ".heif", ".hif", ".avif", ".jxl", ".jp2", ".exr", ".hdr", ".psd", ".dpx", ".ppm", ".pgm"),
    }
)
_PLATE_NAME = re.compile(r"(.*_)?(plate|background)", re.IGNORECASE)


def natural_order(paths: Iterable[Path]) -> list[Path]:
    """Sort by name, numbers in it as numbers: ``f2.png`` before ``f10.png``.

    Args:
        paths: paths to sort.
    """

    def key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
        parts = re.split(r"(\d+)", path.name)
        return [
            (0, int(part[:18]), "") if part.isdigit() else (1, 0, part.lower()) for part in parts if part
        ], path.name

    return sorted(paths, key=key)


def pictures_in(folder: Path) -> list[Path]:
    """Return the images of a folder in their natural order; none where it cannot be read.

    Args:
        folder: folder to list.
    """
    return natural_order(
        path for path in folder.glob("*") if path.suffix.lower() in PICTURE_SUFFIXES and not is_hidden(path)
    )


def others_in(folder: Path) -> list[Path]:
    """Return image files of a folder whose kind hfb does not read.

    Args:
        folder: folder to list.
    """
    return natural_order(
        path for path in folder.glob("*") if path.suffix.lower() in _FOREIGN_SUFFIXES and not is_hidden(path)
    )


def is_plate(path: Path) -> bool:
    """Return whether `path` is named like a background plate, which is no frame.

    Args:
        path: a file.
    """
    return _PLATE_NAME.fullmatch(path.stem) is not None


def is_hidden(path: Path) -> bool:
    """Return whether a file is hidden, such as the ._NAME that macOS puts beside NAME on foreign disks.

    Args:
        path: a file.
    """
    return path.name.startswith(".")
