"""Footage of one static camera: a video file, a folder or a list of images, as a stream of exact frames.

The whole range is decoded once first, which verifies every frame and gives its time. Frames are then read from any
place; memory is that of a few frames, whatever the length of the footage.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np

from hfb.errors import InputError
from hfb.io.media.capture_rate import capture_remark, differs
from hfb.io.media.footage_files import footage_files, name_remarks, one_size, sample_remarks
from hfb.io.media.footage_names import PICTURE_SUFFIXES
from hfb.io.media.images.image_io import read_picture_srgb, recorded_exposure
from hfb.io.media.lens.lens import Lens
from hfb.io.media.video.clean_aperture import WHOLE
from hfb.io.media.video.frame_times import irregular, is_pulled_down, nominal_interval
from hfb.io.media.video.interlacing import Scan
from hfb.io.media.video.video_index import OnProgress, VideoIndex, index_video
from hfb.io.media.video.video_packets import ASSUMED_FPS
from hfb.photometry import Transfer, as_srgb, linear_to_srgb, srgb_to_linear
from hfb.typing import Array, Float

_PULLED_DOWN = (
    "{} shows its frames for two and three fields in turn, as film on television: taken for even, {:.6g} per second"
)
_Wanted = tuple[int, int | None, float | None, float | None, Path]


@dataclass(frozen=True, eq=False)
class Footage:
    """Frames 0 .. count - 1 of the chosen range; paths and numbers only, so that it can be sent between processes.

    Attributes:
        source: the video, or the folder or first image.
        files: the video, or the images in order.
        times_s: time of each frame on the footage's own clock; of an average, its first frame's.
        interval_s: nominal, from frame to frame.
        average: number of the file's frames that are averaged to one.
        first: number of the range's first frame in the file.
        bits: 8, or 16 where a frame holds more than 8 bits can.
        transfer: the light of the frames that `frames` yields.
        loss: loss in a damaged file, one sentence.
        remarks: this and all else that a user should know.
        recorded_exposure: (seconds, where the file says so) of its metadata.
        lens: lens whose distortion is removed from every frame; see `through`.
        tick_s: the resolution of the clock of its time stamps.
    """

    source: Path
    files: tuple[Path, ...]
    height: int
    width: int
    times_s: Float[Array, "T"]
    interval_s: float
    bits: int
    transfer: Literal["srgb", "linear"]
    first: int = 0
    average: int = 1
    stored: Transfer = "srgb"
    index: VideoIndex | None = None
    loss: str | None = None
    remarks: tuple[str, ...] = ()
    recorded_exposure: tuple[float, str] | None = None
    lens: Lens | None = None
    tick_s: float = 0.0

    @property
    def count(self) -> int:
        """How many frames."""
        return len(self.times_s)

    def through(self, lens: Lens | None) -> "Footage":
        """Return the footage with a lens' distortion removed from every frame.

        Args:
            lens: lens whose distortion is removed; None for none.
        """
        return replace(self, lens=lens)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Float[Array, "H W 3"]]:
        """Yield frames from `start` up to `stop` in [0, 1], encoded as `transfer` says.

        Args:
            start: first frame.
            stop: frame after the last one; None for all.

        Raises:
            InputError: the range is not within the footage, or the file is no longer what it was.
        """
        stop = self.count if stop is None else stop
        if not 0 <= start < stop <= self.count:
            raise InputError(f"{self.source}: has frames 0 to {self.count - 1}, not {start} to {stop - 1}.")
        if self.average == 1:
            yield from self._checked(self._single(start, stop), stop - start)
            return
        single = self._checked(self._single(start * self.average, stop * self.average), (stop - start) * self.average)
        for _ in range(start, stop):
            total = np.zeros((self.height, self.width, 3))
            for frame in islice(single, self.average):
                total += self._linear(frame)
            mean = (total / self.average).astype(np.float32)
            yield mean if self.transfer == "linear" else linear_to_srgb(mean).astype(np.float32)

    def chosen(self, numbers: Sequence[int]) -> Iterator[Float[Array, "H W 3"]]:
        """Yield some frames as `frames` does; cheaper than one call each.

        Args:
            numbers: numbers of the frames, ascending.
        """
        if self.index is None or self.average > 1:
            for number in numbers:
                yield from self.frames(number, number + 1)
            return
        yield from self._checked(self.index.chosen([self.first + number for number in numbers]), len(numbers))

    def _linear(self, frame: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        return frame if self.transfer == "linear" else srgb_to_linear(frame)

    def _checked(self, frames: Iterator[Float[Array, "H W 3"]], count: int) -> Iterator[Float[Array, "H W 3"]]:
        given = 0
        for frame in frames:
            if frame.shape[:2] != (self.height, self.width):
                raise InputError(
                    f"{self.source}: a frame of {frame.shape[1]} x {frame.shape[0]} pixels follows on "
                    f"{self.width} x {self.height}; give footage of one size."
                )
            given += 1
            yield self.developed(frame)
        if given < count:
            raise InputError(f"{self.source}: gives fewer frames than when it was opened; was it replaced or cut off?")

    def developed(self, stored: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        """Encode and undistort a stored image like the frames: for a plate from a file.

        Args:
            stored: as the camera stored it, in [0, 1].
        """
        frame = as_srgb(stored, self.stored)
        return frame if self.lens is None else self.lens.undistorted(frame)

    def _single(self, start: int, stop: int) -> Iterator[Float[Array, "H W 3"]]:
        """Yield frames of the file as stored."""
        if self.index is None:
            yield from (
                read_picture_srgb(path, self.stored) for path in self.files[self.first + start : self.first + stop]
            )
        else:
            yield from self.index.frames(self.first + start, self.first + stop)


def open_footage(
    source: Path | Sequence[Path],
    *,
    start: int = 0,
    stop: int | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    average: int = 1,
    transfer: Transfer = "srgb",
    fps: float | None = None,
    scan: Literal["auto", "progressive"] = "auto",
    on_progress: OnProgress | None = None,
) -> Footage:
    """Look through footage: how many frames decode, when each was taken, what is lost.

    Args:
        source: a video, a folder of images (in the natural order of their names), or images in the given order.
        start: range of frames of the file, `stop` exclusive.
        stop: range of frames of the file, `stop` exclusive.
        start_s: the same in seconds, on the file's clock from its first frame.
        stop_s: the same in seconds, on the file's clock from its first frame.
        average: number of neighbouring frames that are averaged to one, in linear light.
        transfer: transfer curve of the file.
        fps: frame rate of images, which have no clock; it has priority over a video's own rate: its times are scaled.
        scan: ``progressive``: frames are whole images, whatever their flags say.
        on_progress: called with (frames looked at, of how many).

    Raises:
        InputError: nothing there, nothing decodes, an empty range, images of different sizes, an absurd size,
            interlaced or high dynamic range video.
    """
    if average < 1:
        raise InputError(f"--average {average}: give 1 or more frames to average.")
    files = footage_files(source)
    place = source if isinstance(source, Path) else files[0]
    wanted = (start, stop, start_s, stop_s, place)
    if files[0].suffix.lower() in PICTURE_SUFFIXES:
        whole = _of_pictures(place, files, fps, transfer)
        first, last = _range(whole.times_s, *wanted)
    else:
        whole, first, last = _of_video(place, files, wanted, scan == "auto", on_progress)
        if not fps and whole.index and differs(whole.index.capture, 1 / whole.interval_s):
            assert whole.index.capture is not None
            fps = whole.index.capture[0]
            told = capture_remark(place.name, whole.index.capture, 1 / whole.interval_s)
            whole = replace(whole, remarks=(*whole.remarks, told))
    if whole.index and whole.index.counted and not fps:
        whole = replace(whole, remarks=(whole.index.counted, *whole.remarks))
    chosen = replace(
        _within(whole, first, last, fps),
        stored=transfer,
        transfer="linear" if transfer == "linear" else "srgb",
        bits=16 if transfer in ("bt709", "gamma22") else whole.bits,
    )
    return _averaged(chosen, average) if average > 1 else chosen


def _of_pictures(place: Path, files: tuple[Path, ...], fps: float | None, transfer: Transfer) -> Footage:
    height, width, bits = one_size(files)
    told = (*name_remarks(files), *sample_remarks(files, transfer))
    assumed = f"no frame rate given: assuming {ASSUMED_FPS:g} per second (fps in clip.toml)"
    return Footage(
        place,
        files,
        height,
        width,
        np.arange(len(files)) / (fps or ASSUMED_FPS),
        1 / (fps or ASSUMED_FPS),
        bits,
        "srgb",
        remarks=told if fps else (assumed, *told),
        recorded_exposure=recorded_exposure(files[0]),
    )


def _of_video(
    place: Path, files: tuple[Path, ...], wanted: _Wanted, watched: bool, on_progress: OnProgress | None
) -> tuple[Footage, int, int]:
    """Return the footage, the number of frames lost, and the wanted frames that can be read as (first, last + 1).

    Args:
        place: path of the footage.
        files: the video alone.
        wanted: range of frames.
        watched: refuse interlaced frames.
        on_progress: called with (frames done, of how many).
    """
    name, index = place.name, index_video(files[0])
    first, last = _range(index.times_s, *wanted)
    scan = Scan(files[0], index.interlaced) if watched else None
    readable = index.look_through(first, last, on_progress, scan)
    if readable < last and (recounted := index.recounted(on_progress, scan)):
        index = recounted
        first, last = _range(index.times_s, *wanted)
        readable = last
    if readable <= first:
        raise InputError(f"{name}: was opened but gave no frame in the chosen range; convert it to H.264 in an .mp4.")
    loss = index.loss
    if readable < last:
        loss = f"{name} is damaged: frames {readable} to {last - 1} cannot be read and are left out"
    footage = Footage(
        place,
        files,
        index.height,
        index.width,
        index.times_s,
        nominal_interval(index.times_s),
        index.bits,
        "srgb",
        index=index,
        loss=loss,
        remarks=tuple(one for one in (loss, *_remarks(index), scan and scan.remark()) if one),
        recorded_exposure=index.recorded_exposure,
        tick_s=index.tick_s,
    )
    return footage, first, readable


def _remarks(index: VideoIndex) -> Iterator[str]:
    """Yield remarks for the user on how a video is read."""
    yield from index.remarks
    if index.crop != WHOLE:
        yield (
            f"{index.path.name} has a clean aperture: frames are cropped to it by {str(index.crop)[1:-1]} px (top, "
            "bottom, left, right), and plates and the camera's numbers have to be for the rest"
        )
    if index.aspect != 1:
        yield (
            f"{index.path.name} has pixels that are not square: frames are stretched to {index.width} x "
            f"{index.height}, as players show them, and the camera's numbers have to be for that size"
        )


def _within(whole: Footage, first: int, last: int, fps: float | None) -> Footage:
    """Return a range of frames; a stated rate has priority, as for high-speed footage that is stored to play slowly."""
    times_s, interval_s, remarks = whole.times_s, whole.interval_s, whole.remarks
    if is_pulled_down(times_s):
        interval_s = float(times_s[-1] - times_s[0]) / (len(times_s) - 1)
        times_s = times_s[0] + np.arange(len(times_s)) * interval_s
        remarks = (*remarks, _PULLED_DOWN.format(whole.source.name, 1 / interval_s))
    if fps:
        times_s, interval_s = times_s[0] + (times_s - times_s[0]) / (fps * interval_s), 1 / fps
    times_s = times_s[first:last]
    remarks = (*remarks, *irregular(times_s, interval_s))
    tick_s = 0.0 if fps else whole.tick_s
    return replace(whole, times_s=times_s, interval_s=interval_s, first=first, remarks=remarks, tick_s=tick_s)


def _averaged(sharp: Footage, average: int) -> Footage:
    """Average every `average` frames to one; a rest at the end is dropped."""
    left_over = sharp.count % average
    if sharp.count < average:
        raise InputError(
            f"{sharp.source}: has {sharp.count} frames, too few to average {average}; give a smaller --average."
        )
    remarks = sharp.remarks
    if left_over:
        remarks = (*remarks, f"the last {left_over} frames are left out: {average} make one")
    return replace(
        sharp,
        times_s=sharp.times_s[: sharp.count - left_over : average],
        interval_s=sharp.interval_s * average,
        bits=16,
        average=average,
        remarks=remarks,
    )


def _range(
    times_s: Float[Array, "T"], start: int, stop: int | None, start_s: float | None, stop_s: float | None, place: Path
) -> tuple[int, int]:
    """Return the (first, last + 1) frame of the file."""
    clock = times_s - times_s[0]
    tolerance = 1e-6
    first = max(start, int(np.searchsorted(clock, start_s - tolerance)) if start_s is not None else 0)
    last = len(times_s) if stop is None else min(stop, len(times_s))
    if stop_s is not None:
        last = min(last, int(np.searchsorted(clock, stop_s - tolerance)))
    if start < 0 or first >= last:
        raise InputError(
            f"{place}: no frame lies in the chosen range; it has {len(times_s)} frames and lasts {clock[-1]:.3f} s."
        )
    return first, last
