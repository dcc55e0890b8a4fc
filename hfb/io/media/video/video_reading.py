"""Reading of video: exact frames, averages in linear light (a longer exposure), a clean plate by the median.

Frames stream: nothing here ever holds a whole video. `stop` is exclusive, frames count from 0.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import av
import numpy as np

from hfb.errors import InputError
from hfb.io.media.video.clean_aperture import clean_aperture
from hfb.io.media.video.video_colours import refuse_hdr, stated_colours
from hfb.io.media.video.video_file import open_video, video_stream
from hfb.io.media.video.video_pixels import pixel_aspect, upright, zero_to_one
from hfb.typing import Array, Float, Shaped

PLATE_BYTES = 256 << 20


def read_frames(path: Path, start: int = 0, stop: int | None = None) -> Iterator[Float[Array, "H W 3"]]:
    """Yield frames `start` to `stop` of a video as sRGB in [0, 1], upright, in square pixels.

    Args:
        path: the video file.
        start: first frame.
        stop: frame after the last one; None for all.

    Raises:
        InputError: missing, no video, nothing decodable, or `start` is past the end (before the first frame);
            a video that ends before `stop` just ends.
    """
    for frame in _read_levels(Path(path), start, stop):
        yield zero_to_one(frame)


def median_plate(path: Path, frames: Sequence[int], memory_bytes: int = PLATE_BYTES) -> Float[Array, "H W 3"]:
    """Return the background without the person: each pixel's median over the given frames [sRGB].

    The median of an odd number of frames is the same in sRGB and in linear light. The image is computed in bands of
    rows, one pass through the video each, so that no more than `memory_bytes` are held.

    Args:
        path: the video file.
        frames: their numbers.
        memory_bytes: most memory that frames take at once.

    Raises:
        InputError: no frame is given, or one lies past the video's end.
    """
    wanted = sorted(set(frames))
    if not wanted or wanted[0] < 0:
        raise InputError("a plate needs at least one frame with a number of 0 or more.")
    first = next(_read_levels(Path(path), wanted[0], wanted[0] + 1))
    height, row_bytes = first.shape[0], first[0].nbytes * len(wanted)
    rows = max(1, min(height, memory_bytes // row_bytes))
    bands = [_band_median(path, wanted, top, min(top + rows, height)) for top in range(0, height, rows)]
    full = 255 if first.dtype == np.uint8 else 65535
    return np.concatenate(bands).astype(np.float32) / np.float32(full)


def _band_median(path: Path, wanted: Sequence[int], top: int, bottom: int) -> Float[Array, "h W 3"]:
    chosen = set(wanted)
    band = [
        frame[top:bottom].copy()
        for index, frame in enumerate(_read_levels(Path(path), 0, wanted[-1] + 1))
        if index in chosen
    ]
    if len(band) < len(wanted):
        raise InputError(f"{path}: has no frame {wanted[len(band)]}; choose frames inside the video.")
    return np.median(np.stack(band), axis=0)


def _read_levels(path: Path, start: int, stop: int | None) -> Iterator[Shaped[Array, "H W 3"]]:
    """Yield decoded RGB levels, uint8, or uint16 where the video has more than 8 bits."""
    if start < 0 or (stop is not None and stop <= start):
        raise InputError(f"frames {start} to {stop} are an empty range; give 0 <= start < stop.")
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path.")
    decoded = 0
    try:
        with open_video(path) as container:
            stream = video_stream(container)
            stream.thread_type = "AUTO"
            crop, stated = clean_aperture(path, stream), stated_colours(stream)
            aspect = pixel_aspect(stream, crop)
            for index, frame in enumerate(container.decode(stream)):
                decoded = index + 1
                if index == 0:
                    refuse_hdr(frame, stated, str(path))
                if stop is not None and index >= stop:
                    return
                if index >= start:
                    yield upright(frame, path, aspect, stated, crop)
    except av.FFmpegError as error:
        if decoded <= start:  # a damaged tail is no reason to lose the frames before it
            raise InputError(f"{path}: can't be read as a video ({error.strerror}); convert it to H.264.") from None
    if not decoded:
        raise InputError(f"{path}: was opened but gave no frame; convert it to H.264 in an .mp4 file.")
    if decoded <= start:
        raise InputError(f"{path}: has {decoded} frames, there is no frame {start}; choose frames inside the video.")
