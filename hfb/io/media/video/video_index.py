"""An index of a video's frames: exact time stamps, and exact reading from the middle."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np

from hfb.errors import InputError
from hfb.io.media.capture_rate import is_apple_slow_motion, is_time_mapped, stated_capture_rate
from hfb.io.media.video.clean_aperture import WHOLE, Crop, clean_aperture
from hfb.io.media.video.counted_frames import read_on
from hfb.io.media.video.frame_times import even_times
from hfb.io.media.video.interlacing import Scan, stated_interlaced
from hfb.io.media.video.video_colours import NOT_STATED, Stated, colour_remarks, refuse_hdr, stated_colours
from hfb.io.media.video.video_file import FRAME_LIMIT, check_size, open_video, video_stream
from hfb.io.media.video.video_packets import loss_of, rate_of, read_packets
from hfb.io.media.video.video_pixels import is_deep, pixel_aspect, upright, zero_to_one
from hfb.typing import Array, Float, Int

_EXPOSURE_KEYS = ("exposuretime", "exposure_time", "com.android.exposure_time", "shutter_speed")
_SLOW = "{} is a telephone's slow motion: the times at which its frames were captured count, not those of its playing"
_PROGRESS_EVERY = 32
_OTHERS_STAMPS = "{} has time stamps that do not fit its frames"

OnProgress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class VideoIndex:
    """A video's frames in the order in which they are shown; numbers only.

    Attributes:
        stamps: their time stamps, in units of the stream's time base; their numbers where they are `counted`.
        keys: those of key frames, which decode without others.
        times_s: times at which they are shown.
        height: as shown: the container's rotation is applied, and pixels are square.
        width: as shown: the container's rotation is applied, and pixels are square.
        rate: (frames per second, where that is from), should they have to be counted.
        aspect: width / height of a pixel as stored; see `hfb.io.media.video.video_pixels.pixel_aspect`.
        crop: rows and columns that are not shown; see `hfb.io.media.video.clean_aperture.clean_aperture`.
        counted: why frames go by number, one sentence; None where they go by their time stamps.
        loss: known loss in the file, one sentence.
        tick_s: the resolution of `times_s`.
        colours: as the container states them; see `hfb.io.media.video.video_colours.stated_colours`.
        capture: (frames per second, where that stands) where the file says at what rate it was captured.
        interlaced: whether the container alone says so; see `hfb.io.media.video.interlacing.stated_interlaced`.
        remarks: further remarks for the user, one sentence each.
    """

    path: Path
    stamps: Int[Array, "T"]
    keys: Int[Array, "k"]
    times_s: Float[Array, "T"]
    height: int
    width: int
    bits: int
    rate: tuple[float, str]
    aspect: float = 1.0
    crop: Crop = WHOLE
    recorded_exposure: tuple[float, str] | None = None
    counted: str | None = None
    loss: str | None = None
    tick_s: float = 0.0
    colours: Stated = NOT_STATED
    capture: tuple[float, str] | None = None
    interlaced: bool = False
    remarks: tuple[str, ...] = ()

    def by_number(self, why: str) -> "VideoIndex":
        """Return the frames numbered at the stated rate; they are never read from the middle then.

        Args:
            why: problem of the file's time stamps, as the first words of a sentence.
        """
        numbers, (fps, source) = np.arange(len(self.stamps)), self.rate
        counted = (
            f"{why}: frames are counted, {fps:.6g} per second, {source} (fps in clip.toml or --exposure.fps, if that "
            "is not right)"
        )
        return replace(self, stamps=numbers, keys=numbers[:0], times_s=numbers / fps, counted=counted)

    def recounted(self, on_progress: OnProgress | None = None, scan: Scan | None = None) -> "VideoIndex | None":
        """Return an index by number for frames that do not match their time stamps, if every packet decodes.

        Args:
            on_progress: called with (frames done, of how many).
            scan: checks every frame.
        """
        if self.counted:
            return None
        index = self.by_number(_OTHERS_STAMPS.format(self.path.name))
        return index if index.look_through(0, len(self.stamps), on_progress, scan) == len(self.stamps) else None

    def frames(self, start: int, stop: int) -> Iterator[Float[Array, "H W 3"]]:
        """Yield frames `start` to `stop` as stored in [0, 1], as players show them; ends early where the file does.

        Args:
            start: first frame.
            stop: frame after the last one.
        """
        for frame in self._decoded(start, stop):
            yield self._picture(frame)

    def chosen(self, numbers: Sequence[int]) -> Iterator[Float[Array, "H W 3"]]:
        """Yield some frames as `frames` does; those between are decoded or skipped.

        Args:
            numbers: numbers of the frames, ascending.
        """
        worth_a_jump = 3 * len(self.stamps) / max(len(self.keys), 1)
        breaks = np.flatnonzero(np.diff(numbers) > worth_a_jump) + 1
        for group in np.split(np.asarray(numbers), breaks):
            wanted = set(group.tolist())
            for number, frame in enumerate(self._decoded(int(group[0]), int(group[-1]) + 1), int(group[0])):
                if number in wanted:
                    yield self._picture(frame)

    def _picture(self, frame: av.VideoFrame) -> Float[Array, "H W 3"]:
        return zero_to_one(upright(frame, self.path, self.aspect, self.colours, self.crop))

    def look_through(
        self, start: int, stop: int, on_progress: OnProgress | None = None, scan: Scan | None = None
    ) -> int:
        """Decode a range without keeping anything; return the number of the first frame that cannot be decoded.

        Args:
            start: first frame.
            stop: frame after the last one.
            on_progress: called with (frames done, of how many).
            scan: sees every frame.
        """
        reached = start
        for frame in self._decoded(start, stop):
            if frame.is_corrupt:
                break
            if scan:
                scan.see(frame)
            reached += 1
            if on_progress and (reached % _PROGRESS_EVERY == 0 or reached == stop):
                on_progress(reached - start, stop - start)
        return reached

    def _decoded(self, start: int, stop: int) -> Iterator[av.VideoFrame]:
        """Yield decoded frames by their stamps, the same ones wherever decoding begins."""
        if self.counted:
            count = len(self.stamps)
            yield from read_on(self.path, start, min(stop, count), count, lambda: self._from(None))
            return
        wanted = self.stamps[start:stop]
        keys = self.keys[self.keys <= wanted[0]]
        # One key frame earlier than needed, since frames of open groups refer across a key frame.
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
        """Yield (stamp, frame) in the order shown, from a key frame or from the start; ends at the first damage."""
        try:
            with open_video(self.path) as container:
                stream = video_stream(container)
                stream.thread_type = "AUTO"
                if stamp is not None:
                    container.seek(stamp, stream=stream, backward=True, any_frame=False)
                last = None
                for number, frame in enumerate(container.decode(stream)):
                    here = number if self.counted else frame.pts
                    if here is None or (last is not None and here <= last):
                        return  # a stamp that does not ascend is not the frame's own
                    yield int(here), frame
                    last = here
        except av.FFmpegError:
            return


def index_video(path: Path) -> VideoIndex:
    """Read the numbers of all packets; only one frame is decoded.

    Args:
        path: the video file.

    Raises:
        InputError: no video, no frame, high dynamic range, or an absurd size.
    """
    try:
        with open_video(path) as container:
            stream = video_stream(container)
            base, crop = float(stream.time_base or 0), clean_aperture(path, stream)
            aspect = pixel_aspect(stream, crop)
            metadata = {**container.metadata, **stream.metadata}
            exposure, capture = _recorded_exposure(metadata), stated_capture_rate(path, metadata)
            slow = is_time_mapped(path) or is_apple_slow_motion(metadata)
            interlaced, packets = stated_interlaced(stream), read_packets(container, stream)
            stamps = np.array(sorted(stamp for stamp in packets.stamps if stamp is not None and base > 0), np.int64)
            rate, lost = rate_of(stream, stamps * base), loss_of(container, stream, packets, stamps * base)
    except av.FFmpegError as error:
        raise InputError(f"{path}: can't be read as a video ({error.strerror}); convert it to H.264.") from None
    count = len(packets.stamps)
    if count > FRAME_LIMIT:
        raise InputError(f"{path}: has over {FRAME_LIMIT} frames; cut it into shorter videos.")
    if not count:
        raise InputError(f"{path}: was opened but gave no frame; convert it to H.264 in an .mp4 file.")
    first, colours, remarks = _first_frame(path)
    height, width, _ = upright(first, path, aspect, colours, crop).shape
    told = len(np.unique(stamps)) == count
    ordered = stamps if told else np.arange(count)
    index = VideoIndex(
        path,
        ordered,
        np.array(sorted(packets.keys), np.int64),
        even_times(ordered * base, rate[0], base),
        height,
        width,
        16 if is_deep(first) else 8,
        rate,
        aspect,
        crop,
        exposure,
        loss=f"{path.name} is damaged or cut off: {lost}" if lost else None,
        tick_s=base,
        colours=colours,
        capture=capture,
        interlaced=interlaced,
        remarks=(*remarks, *((_SLOW.format(path.name),) if slow else ())),
    )
    if not told:
        return index.by_number(f"{path.name} {'repeats or lacks' if len(stamps) else 'has no'} time stamps")
    return index.by_number(_OTHERS_STAMPS.format(path.name)) if packets.as_decoded else index


def _first_frame(path: Path) -> tuple[av.VideoFrame, Stated, tuple[str, ...]]:
    """Decode the first frame; return it with the container's stated colours and remarks for the user."""
    try:
        with open_video(path) as container:
            stream = video_stream(container)
            stated = stated_colours(stream)
            for frame in container.decode(stream):
                check_size(path, frame.width, frame.height)
                refuse_hdr(frame, stated, str(path))
                return frame, stated, tuple(colour_remarks(frame, stated, path.name))
    except av.FFmpegError as error:
        raise InputError(f"{path}: can't be read as a video ({error.strerror}); convert it to H.264.") from None
    raise InputError(f"{path}: was opened but gave no frame; convert it to H.264 in an .mp4 file.")


def _recorded_exposure(metadata: dict[str, str]) -> tuple[float, str] | None:
    """Return (seconds, source) of container metadata with an exposure time, a number or a fraction."""
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
