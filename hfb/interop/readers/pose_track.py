"""Another system's result in hfb's conventions, the common form of all readers."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hfb.errors import InputError
from hfb.io.safe.contents import array_in, frame_numbers, named, numbers, read_contents, text_of
from hfb.motion.motion_file import write_arrays
from hfb.typing import Array, Bool, Float, Int

BetasSpace = Literal["smpl", "smplx", "hfb"]
OPTIONAL = ("poses", "trans", "betas", "pelvis", "joints", "pixels", "K")
_SAVED = tuple(name for name in OPTIONAL if name != "pixels")  # bodies have been fitted to them by then
_NEAR = 0.02
_LEAST_JOINTS = 6
"""Number of joints that fitting a body needs (`hfb.initialization.point_registration`)."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PoseTrack:
    """One person over the frames in which a system saw them.

    Attributes:
        system: name of the system.
        person: the system's name or number for the person.
        frames: numbers of the video's frames, increasing, the first being 0.
        size: (height, width) of the images that K is about; None where the system does not say.
        poses: axis-angle of the 24 joints [rad]; the root's takes the rest body into the camera's axes (x right, y
            down, z forward), where K is None into those of an upright camera whose direction is not known.
        trans: SMPL's translation [m].
        betas: shape coefficients, `betas_space` says whose.
        pelvis: position of the root joint [m], for systems that know it better than `trans`.
        joints: SMPL's joints [m], NaN where unknown; of systems without poses.
        pixels: SMPL's joints in the image [px], NaN where unknown; for systems that know no depth.
        turn_is_known: False where the root's turn about the vertical means nothing to the camera.
        K: the system's own pinhole camera per frame [px]: what it meant is where this camera shows the body.
        images: names of the images, of systems that go by names; see `image_names.by_pictures`.
        rate_hz: frame rate of a motion with its own clock; its frame numbers are then its own, too, not the video's.
    """

    system: str
    person: str
    frames: Int[Array, "R"]
    size: tuple[int, int] | None = None
    poses: Float[Array, "R 24 3"] | None = None
    trans: Float[Array, "R 3"] | None = None
    betas: Float[Array, "R 10"] | None = None
    betas_space: BetasSpace = "smpl"
    pelvis: Float[Array, "R 3"] | None = None
    joints: Float[Array, "R 24 3"] | None = None
    pixels: Float[Array, "R 24 2"] | None = None
    K: Float[Array, "R 3 3"] | None = None
    turn_is_known: bool = True
    rate_hz: float | None = None
    images: tuple[str, ...] | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def rows(self, chosen: Int[Array, "n"]) -> "PoseTrack":
        """Return some of the frames.

        Args:
            chosen: numbers of rows.
        """
        arrays = {name: getattr(self, name) for name in OPTIONAL}
        cut: dict[str, Any] = {name: None if array is None else array[chosen] for name, array in arrays.items()}
        images = None if self.images is None else tuple(self.images[row] for row in chosen)
        return replace(self, frames=self.frames[chosen], images=images, **cut)

    def at_size(self, height: int, width: int) -> "PoseTrack":
        """Scale the camera to images of another resolution.

        Args:
            height: height of the images [px].
            width: width of the images [px].

        Raises:
            InputError: images of another shape: they are not the same ones.
        """
        if self.size is None or self.size == (height, width) or self.K is None:
            return self
        down, right = height / self.size[0], width / self.size[1]
        if abs(down / right - 1) > _NEAR:
            raise InputError(
                f"the {self.system} result is about pictures of {self.size[1]} x {self.size[0]} px and the frames have "
                f"{width} x {height}: give the result for these frames"
            )
        scale = np.array([[right, 1, right], [1, down, down], [1, 1, 1]])
        return replace(self, K=self.K * scale, size=(height, width))


def tidy(track: PoseTrack) -> PoseTrack:
    """Sort by time and keep every frame once; drop unusable rows and log their number.

    Args:
        track: as read.

    Raises:
        InputError: most poses are in degrees.
    """
    usable = np.flatnonzero(_usable(track))
    if len(usable) < len(track):
        _log.warning(
            "%s: %d of %d rows of person %s are left out: not finite, fewer than %d joints, or behind the camera",
            track.system,
            len(track) - len(usable),
            len(track),
            track.person,
            _LEAST_JOINTS,
        )
    _, first = np.unique(track.frames[usable], return_index=True)
    return track.rows(usable[first])


def _usable(track: PoseTrack) -> Bool[Array, "R"]:
    usable = np.ones(len(track), bool)
    if (
        track.poses is not None
        and (np.linalg.norm(track.poses[:, 1:], axis=-1) > 2 * np.pi).any(1).sum() > len(track) / 2
    ):
        raise InputError("its joints turn by more than a full turn: convert its degrees to radians")
    for name in ("poses", "trans", "betas", "pelvis", "K"):
        array = getattr(track, name)
        if array is not None:
            usable &= np.isfinite(array).all(tuple(range(1, array.ndim)))
    for points in (track.joints, track.pixels):
        if points is not None:
            usable &= np.isfinite(points).all(-1).sum(1) >= _LEAST_JOINTS
    place = track.joints if track.pelvis is None and track.trans is None else track.pelvis
    place = track.trans if place is None else place
    if track.K is not None:
        usable &= (track.K[:, 0, 0] > 0) & (track.K[:, 1, 1] > 0)
    if track.K is not None and place is not None:
        usable &= ~(place[..., 2] <= 0).any(tuple(range(1, place.ndim - 1)))  # NaN is no depth behind it
    return usable


def size_seen(K: Float[Array, "R 3 3"], size: tuple[int, int]) -> tuple[int, int]:
    """Return (height, width) [px] of a system's images, whose camera's axis is assumed in the middle.

    Args:
        K: its cameras, NaN where unknown.
        size: size of the frames, which is meant where the other is nearly the same.
    """
    centres = K[:, [1, 0], 2]
    centres = centres[np.isfinite(centres).all(1)]
    if not len(centres):
        return size
    height, width = (round(2 * float(side)) for side in np.median(centres, 0))
    if min(height, width) < 1:
        raise InputError(f"its camera looks through ({width / 2:g}, {height / 2:g}) px, which is no picture's middle")
    near = abs(height / size[0] - 1) <= _NEAR and abs(width / size[1] - 1) <= _NEAR
    return size if near else (height, width)


def pinhole(focal_px: float, cx: float, cy: float) -> Float[Array, "3 3"]:
    """Return K of one focal length.

    Args:
        focal_px: focal length.
        cx: principal point [px].
        cy: principal point [px].
    """
    return np.array([[focal_px, 0, cx], [0, focal_px, cy], [0, 0, 1]], np.float64)


def save_track(path: Path, track: PoseTrack) -> None:
    """Write the canonical .npz, whole or not at all; no pickle.

    Args:
        path: the .npz file.
        track: track to write.
    """
    arrays = {name: getattr(track, name) for name in _SAVED if getattr(track, name) is not None}
    facts = {name: np.array(getattr(track, name)) for name in ("system", "person", "betas_space", "turn_is_known")}
    known = {name: np.array(getattr(track, name)) for name in ("size", "rate_hz") if getattr(track, name) is not None}
    write_arrays(path, {"frame_index": track.frames, **arrays, **facts, **known})


def load_track(path: Path) -> PoseTrack:
    """Read a canonical .npz.

    Args:
        path: the .npz file.

    Raises:
        InputError: damaged, or something else.
    """
    try:
        return track_of(named(read_contents(path)))
    except KeyError as error:
        raise InputError(f"{path} is no canonical result: it has no {error}; give a result of hfb") from None


def track_of(content: dict[str, Any]) -> PoseTrack:
    """Build the record from a canonical file's members.

    Args:
        content: members by name.

    Raises:
        InputError: numbers of other shapes.
        KeyError: it is no such file.
    """
    frames = frame_numbers(numbers(content["frame_index"], None))
    count = len(frames)
    shapes = {"poses": (count, 24, 3), "joints": (count, 24, 3), "K": (count, 3, 3), "betas": (count, 10)}
    read = {
        name: (
            _joints(content[name], count)
            if name == "joints"
            else numbers(content[name], *shapes.get(name, (count, 3)), finite=False)
        )
        for name in _SAVED
        if name in content
    }
    size = tuple(int(side) for side in numbers(content["size"], 2)) if "size" in content else None
    space = text_of(content.get("betas_space", "smpl"))
    if space not in ("smpl", "smplx", "hfb"):
        raise InputError(f"it has betas of an unknown body, {space}")
    system, person = text_of(content["system"]), text_of(content.get("person", "0"))
    known: Any = {
        "turn_is_known": bool(array_in(content.get("turn_is_known", True)).all()),
        "betas_space": space,
        "rate_hz": _rate_hz(content["rate_hz"]) if "rate_hz" in content else None,
        **read,
    }
    return PoseTrack(system, person, frames, None if size is None else (size[0], size[1]), **known)


def _rate_hz(value: object) -> float:
    rate_hz = float(numbers(value, 1)[0])
    if rate_hz <= 0:
        raise InputError(f"it has a rate of {rate_hz:g} frames per second")
    return rate_hz


def _joints(value: object, count: int) -> Float[Array, "R 24 3"]:
    joints = array_in(value)
    if joints.shape != (count, 24, 3):
        raise InputError(f"it has joints of the shape {joints.shape} instead of {(count, 24, 3)}")
    return joints
