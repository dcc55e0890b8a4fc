"""A decoded frame as an image: RGB, turned, mirrored and stretched to square pixels as by players."""

import struct
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.video.reformatter import Interpolation

from hfb.errors import InputError
from hfb.io.media.video.clean_aperture import WHOLE, Crop
from hfb.io.media.video.video_colours import NOT_STATED, Stated, is_yuv, source_colours
from hfb.io.media.video.video_file import check_size
from hfb.typing import Array, Float, Shaped

_MOST_STRETCH = 4.0
_AS_GOOD_AS_SQUARE = 0.01
# swscale darkens 4:2:0 by 1 to 3 levels and repeats every colour over two pixels unless both flags are set. Bicubic
# chroma is nearest to photographs, and bilinear breaks in 16 bits with these flags (FFmpeg 8).
_CONVERSION = Interpolation.BICUBIC | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
_LEVELS = np.arange(256, dtype=np.float32) / np.float32(255)


def upright(
    frame: av.VideoFrame, path: Path, aspect: float, stated: Stated = NOT_STATED, crop: Crop = WHOLE
) -> Shaped[Array, "H W 3"]:
    """Return RGB levels, uint8, or uint16 for more than 8 bits, cropped, turned and stretched as players show them.

    Args:
        frame: decoded.
        path: the video's, for the message.
        aspect: see `pixel_aspect`.
        stated: the colours that the container states; see `hfb.io.media.video.video_colours.stated_colours`.
        crop: see `hfb.io.media.video.clean_aperture.clean_aperture`.

    Raises:
        InputError: the frame is damaged, or too large once it is stretched.
    """
    try:
        pixels = _rgb(frame, stated)
    except (av.FFmpegError, ValueError, MemoryError):
        raise InputError(f"{path}: a frame is damaged; cut the video before it, or convert it to H.264.") from None
    pixels = pixels[crop[0] : frame.height - crop[1], crop[2] : frame.width - crop[3]]
    if aspect != 1:
        height, width = square_size(pixels.shape[0], pixels.shape[1], aspect)
        check_size(path, width, height)
        pixels = stretched(pixels, height, width)
    return np.ascontiguousarray(_as_shown(pixels, frame))


def _rgb(frame: av.VideoFrame, stated: Stated) -> Shaped[Array, "h w 3"]:
    """Return the stored image as RGB levels, within half a level of 8 bits of the standard's formula."""
    matrix, color_range = source_colours(frame, stated)
    form = "rgb48le" if is_deep(frame) else "rgb24"
    rgb = frame.reformat(format=form, interpolation=_CONVERSION, src_colorspace=matrix, src_color_range=color_range)
    pixels = rgb.to_ndarray()
    bits = frame.format.components[0].bits
    if frame.format.name.startswith("gray") and bits <= 16:
        return _gray_levels(pixels, bits, 1 in (int(frame.color_range), color_range))
    if pixels.dtype == np.uint16 and is_yuv(frame):  # swscale's white is 255 * 256 there
        pixels = np.minimum((pixels.astype(np.uint32) * 257 + 128) >> 8, 65535).astype(np.uint16)
    return pixels


def _gray_levels(pixels: Shaped[Array, "h w 3"], bits: int, limited: bool) -> Shaped[Array, "h w 3"]:
    """Scale gray levels by their range: swscale takes all as of full range, and fills deep ones up with zeros."""
    most = np.iinfo(pixels.dtype).max
    low, high = (16 / 256 * 2**bits, 235 / 256 * 2**bits) if limited else (0, 2**bits - 1)
    table = (np.arange(2**bits) - low) * (most / (high - low))
    return table.round().clip(0, most).astype(pixels.dtype)[pixels >> (8 * pixels.itemsize - bits)]


def _as_shown(pixels: Shaped[Array, "h w 3"], frame: av.VideoFrame) -> Shaped[Array, "H W 3"]:
    """Turn and mirror by the display matrix, which players apply and the decoder does not.

    The matrix maps (x, y), y down, to (a x + c y, b x + d y), in fixed point; the nearest of the eight rotations and
    reflections by right angles is applied.
    """
    told: Any = frame.side_data.get("DISPLAYMATRIX")
    if told is None:
        return pixels
    a, b, _, c, d, *_ = struct.unpack("=9i", bytes(told)[:36])
    if a * d == b * c:
        return pixels
    if a * a + d * d < b * b + c * c:  # columns become rows
        pixels, a, d = pixels.swapaxes(0, 1), c, b
    return pixels[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]


def zero_to_one(levels: Shaped[Array, "H W 3"]) -> Float[Array, "H W 3"]:
    """Convert levels of 8 or 16 bits to numbers in [0, 1].

    Args:
        levels: uint8 or uint16.
    """
    return _LEVELS[levels] if levels.dtype == np.uint8 else levels.astype(np.float32) / np.float32(65535)


def is_deep(frame: av.VideoFrame) -> bool:
    """Return whether 8 bits are too few for a frame.

    Args:
        frame: decoded.
    """
    return any(component.bits > 8 for component in frame.format.components)


def pixel_aspect(stream: av.VideoStream, crop: Crop = WHOLE) -> float:
    """Return width / height of a stored pixel before rotation by the container; HDV and anamorphic ones are not 1.

    It is 1 where the file states none, states an implausible one, or one within a hundredth of 1, since encoders round.
    Without a statement FFmpeg compares the track's size, which may be that of the clean aperture, with the stored one.

    Args:
        stream: stream of the video.
        crop: see `hfb.io.media.video.clean_aperture.clean_aperture`.
    """
    aspect, (height, width) = float(stream.sample_aspect_ratio or 1), (stream.height, stream.width)
    if not height * width:  # nothing could be decoded, which is said where frames are read
        return 1.0
    shown = (width - crop[2] - crop[3]) / width / ((height - crop[0] - crop[1]) / height)
    if abs(aspect / shown - 1) < _AS_GOOD_AS_SQUARE:
        return 1.0
    believed = 1 / _MOST_STRETCH <= aspect <= _MOST_STRETCH and abs(aspect - 1) > _AS_GOOD_AS_SQUARE
    return aspect if believed else 1.0


def square_size(height: int, width: int, aspect: float) -> tuple[int, int]:
    """Return (height, width) [px] in square pixels: a pixel's longer side is stretched, so that none is lost.

    Args:
        height: as stored [px].
        width: as stored [px].
        aspect: width / height of a stored pixel.
    """
    return (height, round(width * aspect)) if aspect >= 1 else (round(height / aspect), width)


def stretched(picture: Shaped[Array, "h w 3"], height: int, width: int) -> Shaped[Array, "H W 3"]:
    """Resize an image of uint8, uint16 or float32, sharply.

    Lanczos keeps positions to 0.015 px; OpenCV's cubic kernel (a = -0.75) is up to 0.05 px off.

    Args:
        picture: image to resize.
        height: [px].
        width: [px].
    """
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_LANCZOS4)
