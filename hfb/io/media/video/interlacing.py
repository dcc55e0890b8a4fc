"""Detection of interlaced video by the frames' flags, by the container, or by the image."""

import shlex
from pathlib import Path

import av
import av.filter

from hfb.errors import InputError

_INTERLACED_ORDERS = (2, 3, 4, 5)  # FFmpeg's AVFieldOrder: top or bottom field first
_FLAGGED_BY_DECODER = frozenset(
    {"h264", "hevc", "mpeg1video", "mpeg2video", "mpeg4", "vc1", "wmv3", "prores", "dvvideo"}
)
_FEWEST_COMBED, _LEAST_SHARE, _ONE_ORDER, _FILM_SHARE = 2, 0.3, 4, 0.2
_MOST_COMPARED = 300
"""Frames; a comparison costs about as much as decoding a frame."""


def stated_interlaced(stream: av.VideoStream) -> bool:
    """Return whether the container says so for a codec without flags in its frames; else the frames' own flags count.

    Args:
        stream: stream before decoding.
    """
    codec = stream.codec_context
    return codec.field_order in _INTERLACED_ORDERS and codec.name not in _FLAGGED_BY_DECODER


class Scan:
    """Checks frames in the order of display for interlacing."""

    def __init__(self, path: Path, stated: bool) -> None:
        """Prepare the checks of a video.

        Args:
            path: the video file, named in errors.
            stated: see `stated_interlaced`.
        """
        self._path, self._stated = path, stated
        self._filter: av.filter.Graph | None = None
        self._compared = 0
        self._looks = {"tff": 0, "bff": 0, "progressive": 0}
        self._repeated = 0

    def see(self, frame: av.VideoFrame) -> None:
        """Check one frame.

        Args:
            frame: the next one in the order of display.

        Raises:
            InputError: the frame, or the container, says that it holds two fields.
        """
        if frame.interlaced_frame or self._stated:
            raise InputError(
                f"{self._path}: is interlaced, each frame shows two instants; make each field a frame with "
                f"`{self._command('bwdif=mode=send_field')}` (telecined film: -vf fieldmatch,decimate), or give "
                'scan = "progressive" in clip.toml if its frames are whole pictures all the same.'
            )
        if self._compared < _MOST_COMPARED:
            self._compare(frame)

    def remark(self) -> str | None:
        """Return a sentence where frames that no flag calls interlaced are combed wherever something moves."""
        combed, other = sorted((self._looks["tff"], self._looks["bff"]), reverse=True)
        seen = combed + other + self._looks["progressive"]
        if combed < max(_FEWEST_COMBED, _LEAST_SHARE * seen) or combed < _ONE_ORDER * other:
            return None
        how = "tff" if self._looks["tff"] >= self._looks["bff"] else "bff"
        film = self._repeated > _FILM_SHARE * seen
        fix = f"setfield={how},fieldmatch,decimate" if film else f"setfield={how},bwdif=mode=send_field"
        return (
            f"{self._path.name} seems to be {'telecined film' if film else 'interlaced'}, although it does not say so: "
            f"what moves is combed in {combed} of {seen} frames; if so, convert it with `{self._command(fix)}`"
        )

    def _command(self, filters: str) -> str:
        return f"ffmpeg -i {shlex.quote(self._path.name)} -vf {filters} -crf 12 OUT.mp4"

    def _compare(self, frame: av.VideoFrame) -> None:
        """Compare each frame's lines with their neighbours' by FFmpeg's own detector."""
        self._compared += 1
        try:
            if self._filter is None:
                self._filter = _detector(frame)
            self._filter.push(frame)
            while True:
                told = self._filter.pull().metadata
                kind = told.get("lavfi.idet.single.current_frame", "")
                if kind in self._looks:
                    self._looks[kind] += 1
                self._repeated += told.get("lavfi.idet.repeated.current_frame") in ("top", "bottom")
        except (BlockingIOError, EOFError):
            return
        except (av.FFmpegError, ValueError):  # a size or kind that changes on the way: reading says so
            self._compared = _MOST_COMPARED


def _detector(frame: av.VideoFrame) -> av.filter.Graph:
    graph = av.filter.Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    detector, sink = graph.add("idet"), graph.add("buffersink")
    source.link_to(detector)
    detector.link_to(sink)
    graph.configure()
    return graph
