"""Writing of video: H.264 for browsers and players, renamed into place when complete."""

from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np

from hfb.io.atomic import temporary_beside
from hfb.typing import Array, Float, Shaped

_QUALITY = {"crf": "12"}  # constant rate factor: visually the same, some 1 bit per pixel
_TO_LOOK_AT = {"crf": "17", "preset": "veryfast"}
_SMALL = {"crf": "25", "preset": "veryfast"}
_BT709, _SRGB, _LIMITED = 1, 13, 1  # ITU-T H.273: matrix and primaries, transfer characteristics, range
_TICK = Fraction(1, 1_000_000)


class VideoWriter:
    """Writes sRGB images of one size; the file appears when the `with` block ends without an error.

    The file states its colours (players guess differently otherwise), and its index comes first, so that a browser
    shows it while it loads. An image is encoded while the next one is drawn.
    """

    def __init__(
        self, path: Path, fps: float | None, comment: str = "", to_look_at: bool = False, small: bool = False
    ) -> None:
        """Prepare the file; it is created with the first image.

        Args:
            path: the file.
            fps: images per second; None where every image says when it is to be shown.
            comment: kept in the file.
            to_look_at: encode with a third of the work, for films that are not measured.
            small: the same with a third of the bytes.
        """
        self._path = path
        self._fps = None if fps is None else Fraction(fps).limit_denominator(60_000)
        self._comment = comment
        self._options = _SMALL if small else _TO_LOOK_AT if to_look_at else _QUALITY
        self._temporary = temporary_beside(path.with_suffix(""), path.suffix)
        self._container: av.container.OutputContainer | None = None
        self._stream: av.VideoStream | None = None
        self._encoder = ThreadPoolExecutor(1, "hfb-video")
        self._encoded: Future[None] | None = None

    def __enter__(self) -> "VideoWriter":
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._container = av.open(str(self._temporary), "w", options={"movflags": "+faststart"})
        if self._comment:
            self._container.metadata["comment"] = self._comment
        return self

    def write(self, picture_srgb: Float[Array, "H W 3"], time_s: float | None = None) -> None:
        """Append one image.

        Args:
            picture_srgb: in [0, 1]; height and width must be even, as H.264 needs them.
            time_s: time at which it is shown, to a microsecond, later than the one before; where the video has no rate.
        """
        assert (time_s is None) == (self._fps is not None), "a picture has a time where the video has no rate"
        levels = cv2.convertScaleAbs(np.clip(picture_srgb, 0, 1), alpha=255)  # rounded, in one pass
        self._wait()
        self._encoded = self._encoder.submit(self._encode, levels, time_s)

    def _wait(self) -> None:
        if self._encoded is not None:
            self._encoded.result()

    def _encode(self, levels: Shaped[Array, "H W 3"], time_s: float | None) -> None:
        assert self._container is not None
        stream = self._stream = self._stream or self._begin(*levels.shape[:2])
        rgb = av.VideoFrame.from_ndarray(np.ascontiguousarray(levels), format="rgb24")
        frame = rgb.reformat(format="yuv420p", dst_colorspace="ITU709", src_color_range="JPEG", dst_color_range="MPEG")
        if time_s is not None:
            frame.pts, frame.time_base = round(time_s / _TICK), _TICK
        self._container.mux(stream.encode(frame))

    def _begin(self, height: int, width: int) -> av.VideoStream:
        assert self._container is not None
        # The same images give the same bytes: one thread, and no macroblock tree, whose AVX-512 code reads memory
        # uninitialised where a width is no whole number of vectors.
        options = {**self._options, "x264-params": "mbtree=0"}
        stream = self._container.add_stream("libx264", rate=self._fps or 1000, options=options)
        stream.height, stream.width = height, width
        stream.pix_fmt, stream.thread_count = "yuv420p", 1
        codec = stream.codec_context
        codec.colorspace, codec.color_primaries, codec.color_trc, codec.color_range = _BT709, _BT709, _SRGB, _LIMITED
        if self._fps is None:
            codec.time_base = stream.time_base = _TICK
            codec.max_b_frames = 0  # images in the order of their times, the first at its own
        return stream

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._container is not None
        self._encoder.shutdown(wait=True)
        try:
            with self._container as container:
                if kind is None:
                    self._wait()
                    if self._stream is not None:
                        container.mux(self._stream.encode())
            if kind is None:
                self._temporary.replace(self._path)
        finally:
            self._temporary.unlink(missing_ok=True)
