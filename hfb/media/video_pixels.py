"""A decoded frame as a picture: RGB, turned as players turn it, with square pixels as players show them."""

from pathlib import Path

import av
import cv2
import numpy as np

from hfb.errors import InputError
from hfb.media.video_file import check_size
from hfb.shapes import Array, Float, Shaped

_MOST_STRETCH = 4.0
_AS_GOOD_AS_SQUARE = 0.01
_LEVELS = np.arange(256, dtype=np.float32) / np.float32(255)


def upright(frame: av.VideoFrame, path: Path, aspect: float) -> Shaped[Array, "H W 3"]:
    """RGB levels, uint8, or uint16 where the video has more than 8 bits, turned and stretched as players show them.

    Args:
        path: the video's, for the message. aspect: see `pixel_aspect`.

    Raises:
        InputError: the frame is damaged, or too large once it is stretched.
    """
    try:
        pixels = frame.to_ndarray(format="rgb48le" if is_deep(frame) else "rgb24")
    except (av.FFmpegError, ValueError, MemoryError):
        raise InputError(f"{path}: a frame is damaged; cut the video before it, or convert it to H.264.") from None
    if aspect != 1:
        height, width = square_size(frame.height, frame.width, aspect)
        check_size(path, width, height)
        pixels = stretched(pixels, height, width)
    # The container's display matrix turns counterclockwise; players apply it, the decoder does not.
    return np.ascontiguousarray(np.rot90(pixels, round(frame.rotation / 90) % 4))


def zero_to_one(levels: Shaped[Array, "H W 3"]) -> Float[Array, "H W 3"]:
    """Levels of 8 or 16 bits as numbers in [0, 1]."""
    return _LEVELS[levels] if levels.dtype == np.uint8 else levels.astype(np.float32) / np.float32(65535)


def is_deep(frame: av.VideoFrame) -> bool:
    """Whether 8 bits are too few for it."""
    return any(component.bits > 8 for component in frame.format.components)


def pixel_aspect(stream: av.VideoStream) -> float:
    """Width / height of a stored pixel, before the container's rotation; HDV and anamorphic video have no squares.

    1 where the file does not say, says what no camera does, or is within a hundredth of it: encoders round.
    """
    aspect = float(stream.sample_aspect_ratio or 1)
    believed = 1 / _MOST_STRETCH <= aspect <= _MOST_STRETCH and abs(aspect - 1) > _AS_GOOD_AS_SQUARE
    return aspect if believed else 1.0


def square_size(height: int, width: int, aspect: float) -> tuple[int, int]:
    """(height, width) [px] in square pixels: the longer side of a pixel is drawn out, so that none is lost."""
    return (height, round(width * aspect)) if aspect >= 1 else (round(height / aspect), width)


def stretched(picture: Shaped[Array, "h w 3"], height: int, width: int) -> Shaped[Array, "H W 3"]:
    """A picture of uint8, uint16 or float32 in another size, sharp.

    Lanczos keeps what it shows in place to 0.015 px; OpenCV's cubic kernel (a = -0.75) is up to 0.05 px off.
    """
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_LANCZOS4)
