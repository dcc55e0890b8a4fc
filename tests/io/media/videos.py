"""Small videos for tests: numbered pictures that survive any codec, in the given container and codec."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

SIZE = (48, 64)


def picture(number: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A gradient with a bright block whose place and whose gray level tell the number; uint8 RGB."""
    height, width = size
    frame = np.zeros((height, width, 3), np.uint8)
    frame[..., 0] = np.linspace(20, 90, width, dtype=np.uint8)
    frame[..., 1] = 30 + 5 * (number % 20)
    left = 8 * (number % (width // 8))
    frame[8:24, left : left + 8] = 220
    return frame


@contextmanager
def _as_urgent_as_before() -> Iterator[None]:
    """Restore the process's priority: SVT-AV1 gives root's process a real-time one.

    A later busy wait in it, such as MKL's when threads end, would starve the thread that it waits for, and the machine.
    """
    if sys.platform != "linux":
        yield
        return
    policy, urgency = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, urgency)


def write_video(
    path: Path,
    frames: list[np.ndarray],
    codec: str = "libx264",
    pixels: str = "yuv420p",
    options: dict[str, str] | None = None,
    stamps: list[int] | None = None,
    container_options: dict[str, str] | None = None,
    rate: int = 25,
    aspect: Fraction | None = None,
) -> Path:
    """Frames at a rate per second, or at the given stamps in milliseconds; skips the test where the encoder is missing.

    `aspect`: width / height of a pixel.
    """
    try:
        with _as_urgent_as_before(), av.open(str(path), "w", options=container_options or {}) as container:
            stream = container.add_stream(codec, rate=rate, options=options or {})
            stream.height, stream.width = frames[0].shape[:2]
            stream.pix_fmt = pixels
            if aspect is not None:
                stream.codec_context.sample_aspect_ratio = aspect
            if stamps is not None:
                stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
            for number, content in enumerate(frames):
                frame = av.VideoFrame.from_ndarray(content, format="rgb24")
                if stamps is not None:
                    frame.pts, frame.time_base = stamps[number], Fraction(1, 1000)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    except (av.FFmpegError, ValueError) as error:
        pytest.skip(f"this build of PyAV cannot write {codec}: {error}")
    return path


def numbers_in(frames: np.ndarray, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Where the block is in each frame, in blocks from the left: the number of a `picture` modulo width / 8."""
    blocks = size[1] // 8
    columns = frames[:, 8:24].min(-1).mean(1).reshape(len(frames), blocks, -1).mean(-1)
    return columns.argmax(1)
