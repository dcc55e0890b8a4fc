"""Decoding of image files: levels of 8 to 16 bits, upright, in sRGB's colours, with remarks for the user."""

import io
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from hfb.errors import InputError
from hfb.io.media.images.image_access import FORMATS, PIXEL_LIMIT, damaged, no_picture, read_bytes, too_large
from hfb.io.media.images.image_colours import (
    Colours,
    UnreadableProfile,
    adobe_rgb,
    converted_by_tables,
    of_png,
    of_profile,
    png_chunks,
)
from hfb.io.media.images.image_kinds import Directory, directories, first_directory, foreign_kind, is_tiff, number
from hfb.io.media.images.tiff_layouts import is_unusual, read_unusual, without_orientation
from hfb.photometry import Transfer
from hfb.typing import Array, Float, Shaped

_ORIENTATION, _BITS, _PROFILE, _LARGEST_VALUE, _WIDTH, _HEIGHT = 274, 258, 34675, 281, 256, 257
_SUBFILE, _NO_PAGE = 254, 5  # a thumbnail, or a mask
_INTEROPERABILITY, _ADOBE_INDEX = 0xA005, "R03"
_CLEAR_SHARE = 1e-3
_DEPTHS, _SURELY_DARK = (10, 12, 14), 12


@dataclass(frozen=True, eq=False)
class Picture:
    """A decoded image.

    Attributes:
        pixels: RGB in [0, 1], encoded as sRGB, or as stored.
        remarks: remarks for the user, one sentence each.
        seems_bits: apparent number of bits, where these are fewer than its 16 and nothing states it.
    """

    pixels: Float[Array, "H W 3"]
    remarks: tuple[str, ...] = ()
    seems_bits: int | None = None


@dataclass(frozen=True, eq=False)
class _Levels:
    """Stored levels up to `full`, with the file's statement of their colours."""

    levels: Shaped[Array, "H W 3"]
    full: int
    profile: bytes = b""
    colours: Colours | None = None
    seems_bits: int | None = None
    remarks: tuple[str, ...] = ()


def decode_picture(path: Path, transfer: Transfer = "srgb", data: bytes | None = None) -> Picture:
    """Read an image of 8 to 16 bits per channel.

    Gray becomes RGB, an alpha channel is dropped, the camera's EXIF rotation is applied.

    Args:
        path: the image file.
        transfer: the light that the user knows it to store. ``srgb``: what the file says of its colours counts, they
            become sRGB's; else the values stay as they are.
        data: its content, if that was read before.

    Raises:
        InputError: missing, empty, truncated, too large, or no image; the text names the fix.
    """
    data = read_bytes(path) if data is None else data
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = _stored(path, data, transfer == "srgb")
            return _finished(path, found, transfer == "srgb")
    except InputError:
        raise
    except Exception as error:  # what metadata and colour tables of a damaged file lead to is not foreseeable
        raise damaged(path, error) from None


def picture_size(path: Path) -> tuple[int, int, int]:
    """Return (height, width, bits to store it with) as `decode_picture` gives them; only the file's head is read.

    Args:
        path: the image file.

    Raises:
        InputError: missing, or no image.
    """
    try:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")
            head = file.read(32)
            if is_tiff(head) and (kind := foreign_kind(file)):
                raise InputError(f"{path}: {kind}.")
            directory = first_directory(file) if is_tiff(head) else None
            if directory is not None:
                width, height = number(directory, _WIDTH, 0), number(directory, _HEIGHT, 0)
                if min(width, height) < 1:
                    raise no_picture(path)
                turned, deep = number(directory, _ORIENTATION, 1) >= 5, number(directory, _BITS, 8) > 8
            else:
                file.seek(0)
                with Image.open(file, formats=FORMATS) as image:
                    turned, deep = image.getexif().get(_ORIENTATION, 1) >= 5, image.format == "PNG" and head[24] > 8
                    width, height = image.size
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path.") from None
    except InputError:
        raise
    except Exception:  # Pillow raises nearly anything on a damaged file
        raise no_picture(path) from None
    return (width, height, 16 if deep else 8) if turned else (height, width, 16 if deep else 8)


def doubt_depths(seen: Sequence[tuple[Path, int | None]], transfer: Transfer) -> tuple[str, ...]:
    """Return a remark where 16-bit images of one scene seem to hold fewer bits, as dark ones of machine vision do.

    Args:
        seen: files with their `Picture.seems_bits`.
        transfer: the light that the user states.

    Raises:
        InputError: all of them seem so, by 12 bits or fewer, and are not stated to be linear light (as dark, too).
    """
    path, most = max(seen, key=lambda one: one[1] or 16)
    if most is None:
        return ()
    times = 1 << (16 - most)
    told = (
        f"{path.name} seems to hold {most} bits per channel in its 16, so that it is read {times} times too dark: "
        f"multiply its values by {times}, or store how deep they are (sBIT of PNG, MaxSampleValue of TIFF)"
    )
    if most <= _SURELY_DARK and transfer != "linear":
        raise InputError(f"{told}.")
    return (told,)


def _stored(path: Path, data: bytes, with_colours: bool) -> _Levels:
    directory = None
    if is_tiff(data):
        if kind := foreign_kind(io.BytesIO(data)):
            raise InputError(f"{path}: {kind}.")
        directory = first_directory(io.BytesIO(data))
    if directory is not None and is_unusual(directory):
        if number(directory, _WIDTH, 0) * number(directory, _HEIGHT, 0) > PIXEL_LIMIT:
            raise too_large(path, "it")
        levels, full = read_unusual(path, data, directory)
        return _deep(path, _turned(levels, number(directory, _ORIENTATION, 1)), full, data, directory)
    image = _open(path, data)
    image.load()  # all of it for any decoder, since OpenCV fills missing parts with gray
    deep = data[24] > 8 if image.format == "PNG" else directory is not None and number(directory, _BITS, 8) > 8
    if deep:
        told = image.getexif().get(_ORIENTATION, 1) if directory is None else number(directory, _ORIENTATION, 1)
        levels = _decode_deep(path, data if directory is None else without_orientation(data))
        return _deep(path, _turned(levels, int(told)), 65535, data, directory)
    if image.mode in ("I", "F"):
        raise InputError(f"{path}: its pixels are 32-bit numbers, not a photograph; save it with 8 or 16 bits.")
    remarks = tuple(_remarks(path, image, data))
    profile = image.info.get("icc_profile") or b""
    colours = _own_colours(path, data, image)
    upright = ImageOps.exif_transpose(image)
    if with_colours and profile and upright.mode in ("RGB", "RGBA", "CMYK") and not _is_of_curves(profile):
        try:
            upright = converted_by_tables(upright.convert("RGB") if upright.mode == "RGBA" else upright, profile)
            remarks = (*remarks, f"{path.name} has a colour profile: converted to sRGB")
            profile = b""
        except UnreadableProfile:
            pass
    return _Levels(np.asarray(upright.convert("RGB")), 255, profile, colours, None, remarks)


def _deep(path: Path, levels: Shaped[Array, "H W 3"], full: int, data: bytes, directory: Directory | None) -> _Levels:
    """Return the number of significant bits, stated or apparent."""
    largest = int(levels.max(initial=0))
    profile, colours, told = b"", None, 0
    if directory is None:
        chunks = png_chunks(data)
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            profile = image.info.get("icc_profile") or b""
            colours = _own_colours(path, data, image)
        depth = max(chunks.get(b"sBIT", b"\0")[:3])
        # The standard has samples stretched to 16 bits whatever sBIT says; many cameras leave them as they are.
        told = (1 << depth) - 1 if 8 < depth < 16 and not _is_stretched(levels, depth) else 0
    else:
        profile = bytes(directory.get(_PROFILE, b""))
        told = number(directory, _LARGEST_VALUE, 0) if full == 65535 else 0
    if 255 < told < full and largest <= told:
        return _Levels(levels, told, profile, colours)
    seems = next((bits for bits in _DEPTHS if 255 < largest < 1 << bits), None) if full == 65535 and not told else None
    return _Levels(levels, full, profile, colours, seems)


def _is_stretched(levels: Shaped[Array, "H W 3"], depth: int) -> bool:
    """Return whether samples of so many bits fill 16: shifted up, and perhaps repeated below."""
    high = levels >> (16 - depth) << (16 - depth)
    low = levels - high
    return not low.any() or bool((low == levels >> depth).all())


def _finished(path: Path, found: _Levels, with_colours: bool) -> Picture:
    colours, remarks = found.colours, found.remarks
    if with_colours and found.profile:
        try:
            colours = of_profile(found.profile)
        except UnreadableProfile:
            remarks = (*remarks, f"{path.name} has a colour profile that cannot be used: its colours are taken as sRGB")
    if with_colours and colours is not None and not colours.is_srgb():
        told = f"{path.name} has the colours of {colours.name}: converted to sRGB"
        return Picture(colours.converted(found.levels, found.full), (*remarks, told), found.seems_bits)
    pixels = np.array(found.levels, np.float32, order="C")
    pixels /= np.float32(found.full)
    return Picture(pixels, remarks, found.seems_bits)


def _is_of_curves(profile: bytes) -> bool:
    try:
        of_profile(profile)
    except UnreadableProfile:
        return False
    return True


def _own_colours(path: Path, data: bytes, image: Image.Image) -> Colours | None:
    """Return the colours that a file without a profile states."""
    if image.format == "PNG":
        found = of_png(png_chunks(data))
        if isinstance(found, str):
            raise InputError(f"{path}: is a high dynamic range picture ({found}); convert it to sRGB first.")
        return found
    if image.format in ("JPEG", "MPO", "TIFF") and not image.info.get("icc_profile"):
        index = image.getexif().get_ifd(_INTEROPERABILITY).get(1)
        return adobe_rgb() if str(index or "").strip("\0 ") == _ADOBE_INDEX else None
    return None


def _remarks(path: Path, image: Image.Image, data: bytes) -> Iterator[str]:
    if is_tiff(data):
        count = sum(not number(one, _SUBFILE, 0) & _NO_PAGE for one in directories(io.BytesIO(data)))
    else:
        count = getattr(image, "n_frames", 1) if image.format in ("PNG", "WEBP") else 1
    if count > 1:
        yield f"{path.name} holds {count} pictures: the first one is taken"
    if image.mode in ("RGBA", "LA", "PA"):
        clear = np.asarray(image.getchannel("A")) < 255
        if clear.mean() > _CLEAR_SHARE:
            yield (
                f"{path.name} is transparent in {100 * clear.mean():.3g} % of its area: the colours below count, "
                "whatever they are; save it without transparency"
            )


def _turned(pixels: Shaped[Array, "h w 3"], orientation: int) -> Shaped[Array, "H W 3"]:
    if orientation in (2, 4, 5, 7):  # mirrored kinds: undo the mirror, then turn like the plain kinds
        pixels = pixels[:, ::-1]
    quarter_turns = {3: 2, 4: 2, 5: 1, 6: 3, 7: 3, 8: 1}.get(orientation, 0)
    return np.rot90(pixels, quarter_turns)


def _decode_deep(path: Path, data: bytes) -> Shaped[Array, "H W 3"]:
    """Decode 16-bit pixels with OpenCV (Pillow has no 16-bit RGB), as stored."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if pixels is None or pixels.dtype != np.uint16:
        raise InputError(f"{path}: this kind of 16-bit picture can't be read; save it as a PNG.")
    return pixels[..., ::-1]


def _open(path: Path, data: bytes) -> Image.Image:
    """Decode with Pillow, which refuses a truncated file where OpenCV fills it with gray."""
    try:
        image = Image.open(io.BytesIO(data), formats=FORMATS)
        if image.width * image.height > PIXEL_LIMIT:  # stricter than Pillow's own limit
            raise too_large(path, f"{image.width} x {image.height} pixels")
    except UnidentifiedImageError:
        raise no_picture(path) from None
    except Image.DecompressionBombError:
        raise too_large(path, "it") from None
    return image
