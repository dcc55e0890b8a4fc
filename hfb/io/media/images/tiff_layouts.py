"""TIFF layouts of machine vision that Pillow and OpenCV read wrongly: 9 to 15 bits packed, 16 bits plane by plane.

A plane is copied into a plain gray TIFF of 8 or 16 bits, which libtiff decompresses whatever its compression; packed
samples are then unpacked.
"""

import io
import struct
from pathlib import Path

import numpy as np
from PIL import Image

from hfb.errors import InputError
from hfb.io.media.images.image_kinds import Directory, number
from hfb.typing import Array, Shaped

_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 256, 257, 258, 259, 262
_SAMPLES, _PLANAR, _PREDICTOR = 277, 284, 317
_STRIP_OFFSETS, _ROWS_PER_STRIP, _STRIP_COUNTS = 273, 278, 279
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_COUNTS = 322, 323, 324, 325
_SAMPLE_FORMAT, _FILL_ORDER, _ORIENTATION, _MOST_ENTRIES = 339, 266, 274, 1000
_WHITE_IS_ZERO, _GRAY_OR_RGB = 0, (0, 1, 2)
_PLANE_BY_PLANE, _SHORT, _LONG = 2, 3, 4
_BAND = 64


def is_unusual(directory: Directory) -> bool:
    """Return whether a TIFF's first image has one of these layouts.

    Args:
        directory: first one of the TIFF.
    """
    bits, planar = number(directory, _BITS, 8), number(directory, _PLANAR, 1)
    return 8 < bits < 16 or (bits == 16 and planar == _PLANE_BY_PLANE and number(directory, _SAMPLES, 1) > 1)


def read_unusual(path: Path, data: bytes, directory: Directory) -> tuple[Shaped[Array, "H W 3"], int]:
    """Return the levels as stored (not turned), and the highest that their bits hold.

    Args:
        path: the file, named in errors.
        data: content of the file.
        directory: first one of the TIFF.

    Raises:
        InputError: another kind of samples, or a mixture of layouts that no camera writes.
    """
    bits, samples = number(directory, _BITS, 8), number(directory, _SAMPLES, 1)
    height, width = number(directory, _HEIGHT, 0), number(directory, _WIDTH, 0)
    apart = number(directory, _PLANAR, 1) == _PLANE_BY_PLANE and samples > 1
    packed = bits < 16
    if (
        number(directory, _PHOTOMETRIC, 1) not in _GRAY_OR_RGB
        or number(directory, _SAMPLE_FORMAT, 1) != 1
        or (packed and (_TILE_WIDTH in directory or number(directory, _PREDICTOR, 1) != 1))
    ):
        raise InputError(f"{path}: this kind of {bits}-bit TIFF can't be read; save it as a 16-bit PNG.")
    planes = samples if apart else 1
    row_samples = width * (1 if apart else samples)
    stored = [
        _plane(data, directory, number_of, planes, -(-row_samples * bits // 8) if packed else row_samples, packed)
        for number_of in range(min(planes, 3))
    ]
    levels = [_unpacked(one, bits, row_samples) for one in stored] if packed else stored
    picture = np.stack(levels, -1) if apart else levels[0].reshape(height, width, samples)
    picture = picture[..., :3] if picture.shape[2] >= 3 else np.repeat(picture[..., :1], 3, -1)
    full = (1 << bits) - 1
    return (full - picture if number(directory, _PHOTOMETRIC, 1) == _WHITE_IS_ZERO else picture), full


def without_orientation(data: bytes) -> bytes:
    """Mark a TIFF's first image as upright: OpenCV turns TIFFs regardless of its flags.

    Args:
        data: content of the file.
    """
    order, big = (">" if data[:2] == b"MM" else "<"), b"+" in data[2:4]
    start = struct.unpack_from(f"{order}Q" if big else f"{order}I", data, 8 if big else 4)[0]
    count = struct.unpack_from(f"{order}Q" if big else f"{order}H", data, start)[0]
    head, size = (8, 20) if big else (2, 12)
    changed = bytearray(data)
    for entry in range(start + head, start + head + size * min(count, _MOST_ENTRIES), size):
        if struct.unpack_from(f"{order}H", data, entry)[0] == _ORIENTATION:
            struct.pack_into(f"{order}H", changed, entry + size - (8 if big else 4), 1)
    return bytes(changed)


def _plane(
    data: bytes, directory: Directory, plane: int, planes: int, width: int, as_bytes: bool
) -> Shaped[Array, "H w"]:
    """Return one plane's rows, as bytes or as samples of 16 bits."""
    mini = _gray_tiff(data, directory, plane, planes, width, 8 if as_bytes else 16)
    with Image.open(io.BytesIO(mini), formats=("TIFF",)) as image:
        pixels = np.asarray(image)
    return pixels.astype(np.uint8 if as_bytes else np.uint16)


def _gray_tiff(data: bytes, directory: Directory, plane: int, planes: int, width: int, bits: int) -> bytes:
    tiled = _TILE_WIDTH in directory
    offsets_tag, counts_tag = (_TILE_OFFSETS, _TILE_COUNTS) if tiled else (_STRIP_OFFSETS, _STRIP_COUNTS)
    parts = list(zip(_numbers(directory, offsets_tag), _numbers(directory, counts_tag), strict=True))
    each = len(parts) // planes
    parts = parts[plane * each : (plane + 1) * each]
    tags: dict[int, tuple[int, ...]] = {
        _WIDTH: (width,),
        _HEIGHT: (number(directory, _HEIGHT, 0),),
        _BITS: (bits,),
        _PHOTOMETRIC: (1,),
        _SAMPLES: (1,),
        _COMPRESSION: (number(directory, _COMPRESSION, 1),),
        counts_tag: tuple(count for _, count in parts),
        _PREDICTOR: (number(directory, _PREDICTOR, 1),),
        _FILL_ORDER: (number(directory, _FILL_ORDER, 1),),
    }
    kept = (_TILE_WIDTH, _TILE_HEIGHT) if tiled else (_ROWS_PER_STRIP,)
    tags |= {tag: (number(directory, tag, number(directory, _HEIGHT, 0)),) for tag in kept}
    order = ">" if data[:2] == b"MM" else "<"
    at = 8 + 2 + 12 * (len(tags) + 1) + 4
    starts = at + 8 * each + np.concatenate([[0], np.cumsum([count for _, count in parts])[:-1]])
    tags[offsets_tag] = tuple(int(start) for start in starts)
    entries, lists = b"", b""
    for tag, values in sorted(tags.items()):
        if len(values) == 1:
            entries += struct.pack(f"{order}HHII", tag, _LONG, 1, values[0])
        else:
            entries += struct.pack(f"{order}HHII", tag, _LONG, len(values), at + len(lists))
            lists += struct.pack(f"{order}{len(values)}I", *values)
    head = data[:2] + struct.pack(f"{order}HIH", 42, 8, len(tags)) + entries + struct.pack(f"{order}I", 0)
    return head + lists.ljust(8 * each, b"\0") + b"".join(data[start : start + count] for start, count in parts)


def _numbers(directory: Directory, tag: int) -> tuple[int, ...]:
    value = directory[tag]
    return tuple(int(one) for one in (value if isinstance(value, tuple) else (value,)))


def _unpacked(rows: Shaped[Array, "H b"], bits: int, samples: int) -> Shaped[Array, "H n"]:
    """Unpack samples of so many bits from rows of bytes, the highest bit first, as in TIFFs of either byte order."""
    weights = (1 << np.arange(bits - 1, -1, -1)).astype(np.uint16)
    levels = np.empty((len(rows), samples), np.uint16)
    for top in range(0, len(rows), _BAND):
        ones = np.unpackbits(rows[top : top + _BAND], axis=1)[:, : samples * bits]
        levels[top : top + _BAND] = ones.reshape(len(ones), samples, bits) @ weights
    return levels
