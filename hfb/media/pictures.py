"""Still pictures in and out: float32 RGB in [0, 1], sRGB as stored, upright."""

import io
import warnings
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageOps, TiffImagePlugin, UnidentifiedImageError

from hfb.errors import InputError
from hfb.media.atomic import write_bytes_atomic
from hfb.shapes import Array, Float, Shaped

PIXEL_LIMIT = 40_000_000
"""Of a picture, or a frame of a video (8K has 33): as float32 RGB 0.5 GB, with a decoder's copies of 16 bits 1.5 GB."""

_BYTE_LIMIT = 512 << 20
_FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP")
_KINDS = "a PNG, JPEG, TIFF, WebP or BMP picture"
_ORIENTATION_TAG, _BITS_TAG = 0x0112, 258
_EXIF_DIRECTORY, _EXPOSURE_TAG = 0x8769, 0x829A


def read_picture_srgb(path: Path) -> Float[Array, "H W 3"]:
    """Read a picture of 8 or 16 bits per channel.

    Gray becomes RGB, an alpha channel is dropped, the camera's EXIF rotation is applied.

    Raises:
        InputError: missing, empty, truncated, too large, or no picture; the text names the fix.
    """
    data = _read_bytes(Path(path))
    try:
        pixels, full = _decoded(path, data)
    except InputError:
        raise
    except Exception as error:  # what metadata and colour tables of a damaged file lead to is not foreseeable
        raise _damaged(path, error) from None
    picture = np.array(pixels, np.float32, order="C")
    picture /= np.float32(full)
    return picture


def _decoded(path: Path, data: bytes) -> tuple[Shaped[Array, "H W 3"], int]:
    """(levels, the highest of them)."""
    image = _open(path, data)
    if _bits_per_channel(image, data) > 8:
        return _decode_deep(path, data, image.getexif().get(_ORIENTATION_TAG, 1)), 65535
    if image.mode in ("I", "F"):
        raise InputError(f"{path}: its pixels are 32-bit numbers, not a photograph; save it with 8 or 16 bits.")
    return np.asarray(ImageOps.exif_transpose(image).convert("RGB")), 255


def stored_png(path: Path) -> bytes:
    """A PNG file as it is, once it has been seen to hold a picture: it is handed on into pages and other files.

    Raises:
        InputError: as `read_picture_srgb`, or it is a picture of another kind.
    """
    read_picture_srgb(path)
    data = _read_bytes(Path(path))
    if not data.startswith(b"\x89PNG"):
        raise InputError(f"{path}: is no PNG picture, whatever it is called; make the result again.")
    return data


def picture_size(path: Path) -> tuple[int, int, int]:
    """(height, width, bits to store it with) as `read_picture_srgb` would give it; only the file's head is read.

    Raises:
        InputError: missing, or no picture.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path, formats=_FORMATS) as image:
                turned = image.getexif().get(_ORIENTATION_TAG, 1) >= 5
                with path.open("rb") as file:
                    deep = _bits_per_channel(image, file.read(32)) > 8
                width, height = image.size
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path.") from None
    except Exception:  # Pillow raises nearly anything on a damaged file
        raise InputError(f"{path}: is not a picture; give {_KINDS}.") from None
    return (width, height, 16 if deep else 8) if turned else (height, width, 16 if deep else 8)


def recorded_exposure(path: Path) -> tuple[float, str] | None:
    """(seconds, where it stands) of a photograph that tells its exposure time (EXIF); None without."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path, formats=_FORMATS) as image:
                seconds = image.getexif().get_ifd(_EXIF_DIRECTORY).get(_EXPOSURE_TAG)
        value = float(seconds) if seconds is not None else 0.0
    except Exception:  # metadata that cannot be read tells nothing
        return None
    return (value, f"the EXIF entry ExposureTime of {path.name}") if 0 < value < 10 else None


def write_png(path: Path, picture_srgb: Float[Array, "H W 3"], bits: int = 8) -> None:
    """Write RGB values in [0, 1] (clipped, rounded to nearest) as an 8 or 16 bit PNG, atomically."""
    _write_levels(Path(path), picture_srgb[..., ::-1], bits)


def write_matte(path: Path, matte: Float[Array, "H W"]) -> None:
    """Write a matte in [0, 1] as a 16-bit gray PNG (steps of 1/65535), atomically."""
    _write_levels(Path(path), matte, 16)


def read_matte(path: Path) -> Float[Array, "H W"]:
    """Read a matte: the mean of the channels of any picture that `read_picture_srgb` takes, its values as they are."""
    return read_picture_srgb(path).mean(-1, dtype=np.float32)


def _write_levels(path: Path, values: Float[Array, "..."], bits: int) -> None:
    if bits not in (8, 16):
        raise ValueError(f"a PNG holds 8 or 16 bits per channel, not {bits}")
    full = (1 << bits) - 1
    levels = np.round(np.clip(values, 0, 1).astype(np.float64) * full)
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(levels, np.uint8 if bits == 8 else np.uint16))
    if not done:
        raise OSError(f"{path}: the picture could not be encoded")
    write_bytes_atomic(path, encoded.tobytes())


def _read_bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > _BYTE_LIMIT:
            raise InputError(f"{path}: {size >> 20} MiB is too large for a picture; give {_KINDS}.")
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


def _open(path: Path, data: bytes) -> Image.Image:
    """Decode with Pillow: unlike OpenCV it refuses a truncated file instead of filling it with gray."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # our own pixel limit below is stricter than Pillow's error
            image = Image.open(io.BytesIO(data), formats=_FORMATS)
            if image.width * image.height > PIXEL_LIMIT:
                raise _too_large(path, f"{image.width} x {image.height} pixels")
            image.load()
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{path}: is not a picture; give {_KINDS}.") from None
    except Image.DecompressionBombError:
        raise _too_large(path, "it") from None
    except Exception as error:  # decoders raise nearly anything
        raise _damaged(path, error) from None
    return image


def _damaged(path: Path, error: Exception) -> InputError:
    reason = " ".join(str(error).split())[:120] or type(error).__name__
    return InputError(f"{path}: the picture is truncated or damaged ({reason}); export or copy it again.")


def _too_large(path: Path, what: str) -> InputError:
    return InputError(f"{path}: {what} is over the limit of {PIXEL_LIMIT // 1_000_000} megapixels; make it smaller.")


def _bits_per_channel(image: Image.Image, data: bytes) -> int:
    """The file's own depth; Pillow's mode hides it for 16-bit RGB."""
    if image.format == "PNG":
        return data[24]  # the IHDR chunk's bit depth
    if isinstance(image, TiffImagePlugin.TiffImageFile):
        bits = image.tag_v2.get(_BITS_TAG, 8)
        bits = max(bits) if isinstance(bits, tuple) else int(bits)
        return 16 if bits == 16 else 8
    return 8


def _decode_deep(path: Path, data: bytes, orientation: int) -> Shaped[Array, "H W 3"]:
    """16-bit pixels through OpenCV (Pillow has no 16-bit RGB), turned upright."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if pixels is None or pixels.dtype != np.uint16:
        raise InputError(f"{path}: this kind of 16-bit picture can't be read; save it as a PNG.")
    pixels = pixels[..., ::-1]
    if orientation in (2, 4, 5, 7):  # mirrored kinds: undo the mirror, then turn like the plain kinds
        pixels = pixels[:, ::-1]
    quarter_turns = {3: 2, 4: 2, 5: 1, 6: 3, 7: 3, 8: 1}.get(orientation, 0)
    return np.rot90(pixels, quarter_turns)
