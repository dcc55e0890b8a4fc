"""The files of footage: a video, or images in the order in which they were taken."""

import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from hfb.errors import InputError
from hfb.io.media.footage_names import is_plate, others_in, pictures_in
from hfb.io.media.images.image_access import PIXEL_LIMIT, no_picture
from hfb.io.media.images.image_decoding import decode_picture, doubt_depths, picture_size
from hfb.photometry import Transfer

_NUMBERED = re.compile(r"(.*?)(\d{1,18})")
_MOST = 0.6


def footage_files(source: Path | Sequence[Path]) -> tuple[Path, ...]:
    """Return the video alone, the images of a folder in their natural order, or the given images.

    Args:
        source: a video, a folder, or images.

    Raises:
        InputError: nothing there.
    """
    if not isinstance(source, Path):
        if not source:
            raise InputError("the list of pictures is empty; give at least one.")
        return tuple(source)
    if source.is_dir():
        found = tuple(path for path in pictures_in(source) if not is_plate(path))
        if not found:
            for other in others_in(source):  # a folder of camera raw or HEIC files has its own sentence
                raise no_picture(other)
            raise InputError(f"{source}: holds no picture; give a folder of PNG, JPEG, TIFF, WebP or BMP frames.")
        return found
    if not source.exists():
        raise InputError(f"{source}: no such file; check the path.")
    return (source,)


def one_size(files: Sequence[Path]) -> tuple[int, int, int]:
    """Return height, width and bits; only the files' heads are read.

    Args:
        files: images of a clip, in order.

    Raises:
        InputError: one is no image, of another size, or too large.
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


def name_remarks(files: Sequence[Path]) -> tuple[str, ...]:
    """Return remarks on the names of a clip's images: one of another kind, or a gap in their numbers.

    Args:
        files: images of a clip, in order.

    Raises:
        InputError: two files have one name and other suffixes.
    """
    for before, path in pairwise(sorted(files)):
        if before.with_suffix("") == path.with_suffix(""):
            raise InputError(f"{before} and {path.name} are one frame twice; move one kind of files away.")
    matches = {path: match for path in files if (match := _NUMBERED.fullmatch(path.stem))}
    prefix, count = Counter(match[1] for match in matches.values()).most_common(1)[0] if matches else ("", 0)
    row = [(path, int(match[2])) for path, match in matches.items() if match[1] == prefix]
    if count <= _MOST * len(files):
        return ()
    odd = sorted(set(files) - {path for path, _ in row})
    told = [f"{odd[0].name} is named unlike the other frames: move it away if it is none of them"] if odd else []
    steps = [second[1] - first[1] for first, second in pairwise(row)]
    step, count = Counter(steps).most_common(1)[0] if steps else (0, 0)
    gap = next((at for at, one in enumerate(steps) if one >= 2 * step), None)
    if gap is not None and count > _MOST * len(steps):
        told.append(
            f"no frame lies between {row[gap][0].name} and {row[gap + 1][0].name}: times are counted as if none were "
            "missing, so put the missing ones in, or end the clip there (stop in clip.toml)"
        )
    return tuple(told)


def sample_remarks(files: Sequence[Path], transfer: Transfer) -> tuple[str, ...]:
    """Return remarks on the images of a clip, from the first, the middle and the last of them.

    Args:
        files: images of a clip, in order.
        transfer: the light that the user states.

    Raises:
        InputError: one is no image, or all seem to be of fewer bits than their files are.
    """
    chosen = sorted({0, len(files) // 2, len(files) - 1})
    seen = [decode_picture(files[number], transfer) for number in chosen]
    doubts = doubt_depths([(files[number], one.seems_bits) for number, one in zip(chosen, seen, strict=True)], transfer)
    return (*seen[0].remarks, *doubts)
