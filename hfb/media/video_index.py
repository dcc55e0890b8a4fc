"""Where every frame of a video lies: exact time stamps, and reading from the middle as if from the start."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np

from hfb.errors import InputError
from hfb.media.video_file import FRAME_LIMIT, check_size, open_video
from hfb.shapes import Array, Float, Int, Shaped

_HDR = {16: "PQ", 18: "HLG"}  # ITU-T H.273, transfer characteristics
_EXPOSURE_KEYS = ("exposuretime", "exposure_time", "com.android.exposure_time", "shutter_speed")
_PROGRESS_EVERY = 32
_ROUNDING_FRAMES = 2
"""A container's duration may be longer than its pictures by so many frames: sound, or rounding."""


@dataclass(frozen=True, eq=False)
class VideoIndex:
    """A video's frames in the order in which they are shown; numbers only.

    Attributes:
        stamps: their time stamps, in units of the stream's time base. keys: those of frames that decode by themselves.
        times_s: the same in seconds.
        height, width: as shown: the container's rotation is applied.
        loss: what is known to be missing from the file, one sentence.
    """

    path: Path
    stamps: Int[Array, "T"]
    keys: Int[Array, "k"]
    times_s: Float[Array, "T"]
    height: int
    width: int
    bits: int
    recorded_exposure: tuple[float, str] | None = None
    loss: str | None = None

    def frames(self, start: int, stop: int) -> Iterator[Float[Array, "H W 3"]]:
        """Frames `start` to `stop` as stored in [0, 1], upright; ends early where the file does."""
        levels = np.arange(256, dtype=np.float32) / np.float32(255)
        for frame in self._decoded(start, stop):
            pixels = upright(frame, self.path)
            yield levels[pixels] if pixels.dtype == np.uint8 else pixels.astype(np.float32) / np.float32(65535)

    def chosen(self, numbers: Sequence[int]) -> Iterator[Float[Array, "H W 3"]]:
        """Some frames, given in ascending order, as `frames` has them: what lies between is decoded or jumped over."""
        levels = np.arange(256, dtype=np.float32) / np.float32(255)
        worth_a_jump = 3 * len(self.stamps) / max(len(self.keys), 1)
        breaks = np.flatnonzero(np.diff(numbers) > worth_a_jump) + 1
        for group in np.split(np.asarray(numbers), breaks):
            wanted = set(group.tolist())
            for number, frame in enumerate(self._decoded(int(group[0]), int(group[-1]) + 1), int(group[0])):
                if number in wanted:
                    pixels = upright(frame, self.path)
                    yield levels[pixels] if pixels.dtype == np.uint8 else pixels.astype(np.float32) / np.float32(65535)

    def look_through(self, start: int, stop: int, on_progress: Callable[[int, int], None] | None = None) -> int:
        """Decode a range without keeping anything; the number of the first frame that does not come."""
        reached = start
        for frame in self._decoded(start, stop):
            if frame.is_corrupt:
                break
            reached += 1
            if on_progress and (reached % _PROGRESS_EVERY == 0 or reached == stop):
                on_progress(reached - start, stop - start)
        return reached

    def _decoded(self, start: int, stop: int) -> Iterator[av.VideoFrame]:
        """Decoded frames by their time stamps: the same ones, whether decoding begins at the start or not."""
        wanted = self.stamps[start:stop]
        keys = self.keys[self.keys <= wanted[0]]
        # One key frame earlier than needed: what refers across a key frame (open groups) is complete then.
        origin = int(keys[-2]) if len(keys) > 1 else None
        given = 0
        for stamp, frame in self._from(origin):
            if stamp < wanted[given]:
                continue
            if stamp != wanted[given]:
                if given or origin is None:
                    return
                yield from self._without_seeking(start, stop)
                return
            yield frame
            given += 1
            if given == len(wanted):
                return
        if not given and origin is not None:
            yield from self._without_seeking(start, stop)

    def _without_seeking(self, start: int, stop: int) -> Iterator[av.VideoFrame]:
        wanted, given = self.stamps[start:stop], 0
        for stamp, frame in self._from(None):
            if given < len(wanted) and stamp == wanted[given]:
                given += 1
                yield frame
            if given == len(wanted):
                return

    def _from(self, stamp: int | None) -> Iterator[tuple[int, av.VideoFrame]]:
        """(time stamp, frame) in the order shown, from a key frame or from the start; ends at the first damage."""
        try:
            with open_video(self.path) as container:
                stream = container.streams.video[0]
                stream.thread_type = "AUTO"
                if stamp is not None:
                    container.seek(stamp, stream=stream, backward=True, any_frame=False)
                for number, frame in enumerate(container.decode(stream)):
                    # Files without stamps are counted; they are never read from the middle.
                    yield (number if frame.pts is None else int(frame.pts)), frame
        except av.FFmpegError:
            return


def index_video(path: Path) -> VideoIndex:
    """Read the numbers of all packets; nothing is decoded but one frame.

    Raises:
        InputError: no video, no frame, high dynamic range, or an absurd size.
    """
    try:
        with open_video(path) as container:
            stream = container.streams.video[0]
            base = float(stream.time_base or 0)
            stated_count, rate = stream.frames, float(stream.average_rate or stream.base_rate or 0)
            stated_s = (container.duration or 0) / av.time_base
            exposure = _recorded_exposure({**container.metadata, **stream.metadata})
            stamps, keys, damaged = _stamps(container, stream)
    except av.FFmpegError as error:
        raise InputError(f"{path}: can't be read as a video ({error.strerror}); convert it to H.264.") from None
    if len(stamps) > FRAME_LIMIT:
        raise InputError(f"{path}: has over {FRAME_LIMIT} frames; cut it into shorter videos.")
    if not stamps:
        raise InputError(f"{path}: was opened but gave no frame; convert it to H.264 in an .mp4 file.")
    first = _first_frame(path)
    shape = upright(first, path).shape
    if len(set(stamps)) < len(stamps) or base <= 0:
        stamps, keys, base = list(range(len(stamps))), [], 1 / (rate or 30.0)
    ordered = np.array(sorted(stamps), np.int64)
    usual_s = float(np.median(np.diff(ordered))) * base if len(ordered) > 1 else stated_s
    at_end = (stated_s - float(ordered[-1]) * base) / usual_s if usual_s > 0 else 1.0
    missing = max(stated_count - len(ordered), round(at_end) - 1)
    loss = None
    if damaged or stated_count > len(ordered) or missing > _ROUNDING_FRAMES:
        lost = f"about {missing} frames at its end" if missing > 0 else "its end"
        loss = f"{path.name} is damaged or cut off: {lost} cannot be read and {'are' if missing > 0 else 'is'} left out"
    return VideoIndex(
        path, ordered, np.array(sorted(keys), np.int64), ordered * base, shape[0], shape[1],
        16 if _deep(first) else 8, exposure, loss,
    )  # fmt: skip


def upright(frame: av.VideoFrame, path: Path) -> Shaped[Array, "H W 3"]:
    """RGB levels, uint8, or uint16 where the video has more than 8 bits, turned as players show them.

    Raises:
        InputError: the frame is damaged; `path` is the video's, for the message.
    """
    try:
        pixels = frame.to_ndarray(format="rgb48le" if _deep(frame) else "rgb24")
    except (av.FFmpegError, ValueError, MemoryError):
        raise InputError(f"{path}: a frame is damaged; cut the video before it, or convert it to H.264.") from None
    # The container's display matrix turns counterclockwise; players apply it, the decoder does not.
    return np.ascontiguousarray(np.rot90(pixels, round(frame.rotation / 90) % 4))


def _deep(frame: av.VideoFrame) -> bool:
    return any(component.bits > 8 for component in frame.format.components)


def _stamps(container: av.container.InputContainer, stream: av.VideoStream) -> tuple[list[int], list[int], bool]:
    """(presentation stamps of all whole packets, those of key frames, whether the file breaks off)."""
    stamps: list[int] = []
    keys: list[int] = []
    try:
        for packet in container.demux(stream):
            if not packet.size or packet.is_discard:
                continue
            if packet.is_corrupt:
                return stamps, keys, True
            stamp = packet.pts if packet.pts is not None else packet.dts
            stamps.append(len(stamps) if stamp is None else int(stamp))
            if len(stamps) > FRAME_LIMIT:
                break
            if packet.is_keyframe and packet.pts is not None:
                keys.append(int(packet.pts))
    except av.FFmpegError:
        return stamps, keys, True
    return stamps, keys, False


def _first_frame(path: Path) -> av.VideoFrame:
    try:
        with open_video(path) as container:
            for frame in container.decode(container.streams.video[0]):
                check_size(path, frame.width, frame.height)
                if int(frame.color_trc) in _HDR:
                    kind = _HDR[int(frame.color_trc)]
                    raise InputError(f"{path}: is high dynamic range video ({kind}); convert it to BT.709 first.")
                return frame
    except av.FFmpegError as error:
        raise InputError(f"{path}: can't be read as a video ({error.strerror}); convert it to H.264.") from None
    raise InputError(f"{path}: was opened but gave no frame; convert it to H.264 in an .mp4 file.")


def _recorded_exposure(metadata: dict[str, str]) -> tuple[float, str] | None:
    """(seconds, where it stands) of container metadata that tell it, as some cameras do: a number or a fraction."""
    for name, text in sorted(metadata.items()):
        if name.lower() not in _EXPOSURE_KEYS:
            continue
        parts = text.split("/")
        try:
            seconds = float(parts[0]) / (float(parts[1]) if len(parts) == 2 else 1.0)
        except (ValueError, ZeroDivisionError):
            continue
        if math.isfinite(seconds) and 0 < seconds < 10:
            return seconds, f"the video's own entry {name}"
    return None
