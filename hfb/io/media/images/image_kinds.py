"""Recognition of image files that hfb does not read, by content: camera raw, HEIC and others."""

from collections.abc import Iterator
from io import BufferedIOBase
from typing import IO, cast

from PIL import TiffImagePlugin

_TIFF_HEADS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_RAW_HEADS = (b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FUJIFILMCCD-RAW", b"FOVb", b"\0MRM", b"ARRI")
_RAW_BRANDS = (b"crx ",)
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"heif")
_AVIF_BRANDS = (b"avif", b"avis")
_OTHERS = {
    b"8BPS": "a Photoshop document",
    b"\xff\x0a": "a JPEG XL picture",
    b"\0\0\0\x0cJXL ": "a JPEG XL picture",
    b"\0\0\0\x0cjP  ": "a JPEG 2000 picture",
    b"\xff\x4f\xff\x51": "a JPEG 2000 picture",
    b"\x76\x2f\x31\x01": "an OpenEXR picture",
    b"#?RADIANCE": "a Radiance HDR picture",
    b"%PDF": "a PDF document",
    b"SIMPLE  =": "a FITS picture",
    b"P5": "a PGM picture",
    b"P6": "a PPM picture",
    b"SDPX": "a DPX picture",
    b"XPDS": "a DPX picture",
}

_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _SUBFILE, _SUB_DIRECTORIES = 256, 257, 258, 259, 262, 254, 330
_DNG_VERSION, _SAMPLE_FORMAT = 50706, 339
_RAW_PHOTOMETRIC = (32803, 34892)  # colour filter array, and its demosaiced kind of DNG
_RAW_COMPRESSION = (32767, 32769, 32770, 34713, 65000, 65535)  # Sony, Nikon, Samsung, Nikon, Kodak, Pentax
_MOST_DIRECTORIES = 16

RAW = (
    "is a camera raw file, not a finished picture; develop it (e.g. with darktable or RawTherapee) to a 16-bit TIFF or "
    "PNG, all of a clip with the same settings"
)

Directory = TiffImagePlugin.ImageFileDirectory_v2


def foreign_kind(file: BufferedIOBase) -> str | None:
    """Return the rest of a sentence about a file that hfb does not read; None for an image, or something unknown.

    Args:
        file: opened for reading.
    """
    file.seek(0)
    head = file.read(32)
    if head.startswith(_RAW_HEADS) or head[6:14] == b"HEAPCCDR" or (head[8:10] == b"CR" and is_tiff(head)):
        return RAW
    if is_tiff(head):
        return _foreign_tiff(file)
    if head[4:8] == b"ftyp":
        brand = head[8:12]
        if brand in _RAW_BRANDS:
            return RAW
        for brands, name in ((_HEIF_BRANDS, "a HEIC"), (_AVIF_BRANDS, "an AVIF")):
            if brand in brands:
                return (
                    f"is {name} picture, which is not read; convert it to PNG (macOS: `sips -s format png`, elsewhere "
                    "`magick NAME out.png`)"
                )
    for start, name in _OTHERS.items():
        if head.startswith(start):
            return f"is {name}, which is not read; convert it to PNG or TIFF"
    return None


def is_tiff(head: bytes) -> bool:
    """Return whether a file is a TIFF.

    Args:
        head: the file's first bytes.
    """
    return head.startswith(_TIFF_HEADS)


def directories(file: BufferedIOBase) -> Iterator[Directory]:
    """Yield the directories of a TIFF, also nested ones; ends early where the file is damaged.

    Args:
        file: opened for reading.
    """
    file.seek(0)
    head = file.read(16)
    head = head if b"+" in head[2:4] else head[:8]  # BigTIFF's is the longer one
    try:
        first = Directory(head)
    except Exception:  # no TIFF after all
        return
    waiting, seen = [first.next], set[int]()
    while waiting and len(seen) < _MOST_DIRECTORIES:
        at = waiting.pop(0)
        if not isinstance(at, int) or at <= 0 or at in seen:
            continue
        seen.add(at)
        directory = Directory(head)
        try:
            file.seek(at)
            directory.load(cast(IO[bytes], file))
            below = directory.get(_SUB_DIRECTORIES, ())
        except Exception:  # Pillow raises nearly anything on a damaged directory
            return
        yield directory
        waiting += [directory.next, *(below if isinstance(below, tuple) else (below,))]


def number(directory: Directory, tag: int, usual: int) -> int:
    """Return a tag's largest whole number.

    Args:
        directory: directory of a TIFF.
        tag: its number.
        usual: value where the tag is missing or damaged.
    """
    try:
        value = directory.get(tag, usual)
        return max(int(one) for one in (value if isinstance(value, tuple) else (value,)))
    except (TypeError, ValueError, KeyError):
        return usual


def first_directory(file: BufferedIOBase) -> Directory | None:
    """Return the first directory of a TIFF.

    Args:
        file: opened for reading.
    """
    return next(directories(file), None)


def _foreign_tiff(file: BufferedIOBase) -> str | None:
    found = list(directories(file))
    if not found:
        return None
    for one in found:
        if (
            number(one, _PHOTOMETRIC, 0) in _RAW_PHOTOMETRIC
            or number(one, _COMPRESSION, 1) in _RAW_COMPRESSION
            or _DNG_VERSION in one
        ):
            return RAW
    first, *others = found
    if number(first, _SUBFILE, 0) & 1 and any(_area(one) > _area(first) for one in others):
        size = f"{number(first, _WIDTH, 0)} x {number(first, _HEIGHT, 0)}"
        return f"{RAW} (its first picture, {size}, is only a thumbnail)"
    if number(first, _SAMPLE_FORMAT, 1) == 3 or number(first, _BITS, 8) > 16:
        return "has pixels of 32-bit or floating-point numbers, not a photograph's; save it with 8 or 16 bits"
    return None


def _area(directory: Directory) -> int:
    return number(directory, _WIDTH, 0) * number(directory, _HEIGHT, 0)
