"""Opening of a video: a local file, in a supported container, with frames of a bounded size."""

from pathlib import Path

import av
from av.stream import Disposition

from hfb.errors import InputError
from hfb.io.media.capture_rate import is_time_mapped
from hfb.io.media.images.image_access import PIXEL_LIMIT
from hfb.io.media.images.image_kinds import foreign_kind

FRAME_LIMIT = 1_000_000
"""Frames of one video: nine hours at 30 per second."""

# FFmpeg goes by content: a playlist that is called walk.mp4 names other files, or addresses, and it would open them.
_CONTAINERS = "mov,matroska,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,asf,mxf,gif,flv,ogg"
_NO_VIDEO = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image


def open_video(path: Path) -> av.container.InputContainer:
    """Open a container whose frames may be decoded; the caller closes it.

    Args:
        path: the video file.

    Raises:
        InputError: it holds no video stream, or frames of an absurd size.
        av.FFmpegError: no video.
    """
    if path.is_file():
        with path.open("rb") as file:
            if kind := foreign_kind(file):  # FFmpeg takes a camera's CR3 and a HEIC image for videos
                raise InputError(f"{path}: {kind}.")
    # "file:" keeps a name such as "concat:a|b" from being taken for one of FFmpeg's protocols.
    name = f"file:{path.absolute()}"
    options = {"protocol_whitelist": "file", "format_whitelist": _CONTAINERS}
    if is_time_mapped(path):
        options["ignore_editlist"] = "1"
    container = av.open(name, options=options, metadata_errors="replace")
    try:
        if not container.streams.video:
            raise InputError(f"{path}: holds no video stream; give a video file.")
        if not _videos(container):
            raise InputError(f"{path}: holds only a cover or a thumbnail, no video; give a video file.")
        codec = video_stream(container).codec_context
        if codec is None:
            raise InputError(f"{path}: holds video of an unknown kind; convert it to H.264.")
        check_size(path, codec.width, codec.height)
        codec.options = {**codec.options, "max_pixels": str(PIXEL_LIMIT)}
        return container
    except BaseException:
        container.close()
        raise


def video_stream(container: av.container.InputContainer) -> av.VideoStream:
    """Return the stream that players show: no cover or thumbnail, more than one frame, the default, the largest.

    Args:
        container: opened.
    """

    def rank(stream: av.VideoStream) -> tuple[bool, bool, bool, int]:
        codec = stream.codec_context
        area = codec.width * codec.height if codec is not None else 0
        return codec is not None, stream.frames != 1, Disposition.default in stream.disposition, area

    return max(_videos(container), key=rank)  # the first of equals


def _videos(container: av.container.InputContainer) -> list[av.VideoStream]:
    return [stream for stream in container.streams.video if not stream.disposition & _NO_VIDEO]


def check_size(path: Path, width: int, height: int) -> None:
    """Check that a frame is not too large.

    Args:
        path: the video file.
        width: width of the frame [px].
        height: height of the frame [px].

    Raises:
        InputError: it has more pixels than `PIXEL_LIMIT`.
    """
    if width * height > PIXEL_LIMIT:
        raise InputError(f"{path}: {width} x {height} pixels are over the limit; make the video smaller.")
