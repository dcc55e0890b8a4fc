"""Facts about a video without decoding: time stamps, rate, and missing packets."""

import re
from dataclasses import dataclass

import av
import numpy as np

from hfb.io.media.video.video_file import FRAME_LIMIT
from hfb.typing import Array, Float

ASSUMED_FPS = 30.0
"""Frame rate of footage that has no clock and states no rate."""

_ROUNDING_FRAMES = 2
"""A container's duration may be longer than its images by so many frames: sound, or rounding."""


_SOUND_ROUNDING_S = 0.25


@dataclass(frozen=True)
class Packets:
    """The compressed frames of a video.

    Attributes:
        stamps: presentation stamps of all whole packets that are shown, in the file's order; None where one has none.
        keys: those of key packets, which decode without others.
        hidden: number of packets that are not shown: a video that was trimmed without re-encoding keeps the packets
            that its first frames refer to.
        broken: whether the file breaks off.
        as_decoded: whether the stamps, for all that is known, follow the order of decoding, not that of showing. AVI
            stores none, and those that FFmpeg makes up for it do, where frames refer to later ones.
        sound_s: end of the file's sound, on the clock of its time stamps; 0 without.
    """

    stamps: list[int | None]
    keys: list[int]
    hidden: int = 0
    broken: bool = False
    as_decoded: bool = False
    sound_s: float = 0.0


def read_packets(container: av.container.InputContainer, stream: av.VideoStream) -> Packets:
    """Read all packets once; at most a little over `FRAME_LIMIT`.

    Args:
        container: opened.
        stream: stream of the video.
    """
    stamps: list[int | None] = []
    keys: list[int] = []
    hidden, broken, sound_s = 0, False, 0.0
    try:
        for packet in container.demux(stream, *container.streams.audio):
            if packet.stream_index != stream.index:
                if packet.pts is not None and packet.time_base:
                    sound_s = max(sound_s, float((packet.pts + (packet.duration or 0)) * packet.time_base))
                continue
            if not packet.size or packet.is_discard:
                hidden += packet.size > 0
                continue
            if packet.is_corrupt:
                broken = True
                break
            stamps.append(packet.pts if packet.pts is not None else packet.dts)
            if len(stamps) > FRAME_LIMIT:
                break
            if packet.is_keyframe and packet.pts is not None:
                keys.append(int(packet.pts))
    except av.FFmpegError:
        broken = True
    reordered = container.format.name == "avi" and bool(stream.codec_context.has_b_frames)
    in_order = stamps == sorted(stamp for stamp in stamps if stamp is not None)
    return Packets(stamps, keys, hidden, broken, reordered and in_order, sound_s)


def rate_of(stream: av.VideoStream, times_s: Float[Array, "t"]) -> tuple[float, str]:
    """Return (frames per second, their source) for frames whose time stamps cannot be used.

    Args:
        stream: stream of the video.
        times_s: existing time stamps, ascending.
    """
    # A bare stream has no stamps and no header: its "average" is FFmpeg's own assumption, the codec may know better.
    stated = stream.average_rate if len(times_s) else stream.codec_context.framerate
    if stated:
        return float(stated), "as the file states"
    if len(times_s) and times_s[-1] > times_s[0]:
        return (len(times_s) - 1) / float(times_s[-1] - times_s[0]), "their average"
    return ASSUMED_FPS, "which is assumed"


def loss_of(
    container: av.container.InputContainer, stream: av.VideoStream, packets: Packets, times_s: Float[Array, "t"]
) -> str | None:
    """Return what is missing at the end by the file's own statement, as the rest of a sentence; None if nothing is.

    Args:
        container: opened.
        stream: stream of the video.
        packets: by `read_packets`.
        times_s: the packets' time stamps, ascending [s].
    """
    stated_s = _stated_s(container, stream)
    usual_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else stated_s
    missing = round((stated_s - float(times_s[-1])) / usual_s) - 1 if len(times_s) and usual_s > 0 else 0
    if stream.frames:
        # The count is exact, but of all that is stored: what an edit list cuts off at the end is not even hidden.
        missing = min(missing, stream.frames - packets.hidden - len(packets.stamps))
    elif missing <= _ROUNDING_FRAMES or packets.sound_s >= stated_s - _SOUND_ROUNDING_S:
        missing = 0  # ASF states one duration for the whole file: it is the sound's where that is the longer
    if missing > 0:
        return f"about {missing} frames at its end cannot be read and are left out"
    return "its end cannot be read and is left out" if packets.broken else None


def _stated_s(container: av.container.InputContainer, stream: av.VideoStream) -> float:
    """Return how long the images last [s], by the stream or by the container, whose sound may last longer."""
    if stream.duration and stream.time_base:
        return float(stream.duration * stream.time_base)
    told = re.fullmatch(r"(\d{1,4}):(\d\d):(\d\d(?:\.\d{1,9})?)", stream.metadata.get("DURATION", ""))  # Matroska's tag
    if told:
        return 3600 * float(told[1]) + 60 * float(told[2]) + float(told[3])
    return (container.duration or 0) / av.time_base
