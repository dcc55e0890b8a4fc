"""What another system found, in hfb's conventions: the one form between their files and our first bodies."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hfb.errors import InputError
from hfb.export.motion_file import write_arrays
from hfb.initialize.readers.contents import array_in, named, numbers, read_contents, text_of
from hfb.shapes import Array, Float, Int

BetasSpace = Literal["smpl", "smplx", "hfb"]
_OPTIONAL = ("poses", "trans", "betas", "pelvis", "joints", "K")


@dataclass(frozen=True)
class PoseTrack:
    """One person over the frames in which a system saw them.

    Attributes:
        system: whose result it is. person: the system's name or number for the person.
        frames: numbers of the video's frames, increasing, the first being 0.
        size: (height, width) of the pictures that K is about; None where the system does not say.
        poses: axis-angle of the 24 joints [rad]; the root's takes the rest body into the camera's axes (x right, y
            down, z forward), where K is None into those of an upright camera whose direction is not known.
        trans: SMPL's translation [m]. betas: shape coefficients, `betas_space` says whose.
        pelvis: where the root joint is [m], for systems that know it better than `trans`.
        joints: SMPL's joints [m], NaN where unknown; of systems without poses.
        turn_is_known: False where the root's turn about the vertical means nothing to the camera.
        K: the system's own pinhole camera per frame [px]: what it meant is where this camera shows the body.
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
    K: Float[Array, "R 3 3"] | None = None
    turn_is_known: bool = True

    def __len__(self) -> int:
        return len(self.frames)

    def rows(self, chosen: Int[Array, "n"]) -> "PoseTrack":
        """Some of its frames."""
        arrays = {name: getattr(self, name) for name in _OPTIONAL}
        cut: dict[str, Any] = {name: None if array is None else array[chosen] for name, array in arrays.items()}
        return replace(self, frames=self.frames[chosen], **cut)

    def at_size(self, height: int, width: int) -> "PoseTrack":
        """For pictures of another resolution.

        Raises:
            InputError: pictures of another shape: they are not the same ones.
        """
        if self.size is None or self.size == (height, width) or self.K is None:
            return self
        down, right = height / self.size[0], width / self.size[1]
        if abs(down / right - 1) > 0.02:
            raise InputError(
                f"the {self.system} result is about pictures of {self.size[1]} x {self.size[0]} px and the frames have "
                f"{width} x {height}: give the result for these frames"
            )
        scale = np.array([[right, 1, right], [1, down, down], [1, 1, 1]])
        return replace(self, K=self.K * scale, size=(height, width))


def tidy(track: PoseTrack) -> PoseTrack:
    """In the order of time, every frame once."""
    _, first = np.unique(track.frames, return_index=True)
    return track.rows(first)


def pinhole(focal_px: float, cx: float, cy: float) -> Float[Array, "3 3"]:
    """K of one focal length [px]."""
    return np.array([[focal_px, 0, cx], [0, focal_px, cy], [0, 0, 1]], np.float64)


def save_track(path: Path, track: PoseTrack) -> None:
    """Write the canonical .npz, whole or not at all; no pickle."""
    arrays = {name: getattr(track, name) for name in _OPTIONAL if getattr(track, name) is not None}
    facts = {name: np.array(getattr(track, name)) for name in ("system", "person", "betas_space", "turn_is_known")}
    size = {} if track.size is None else {"size": np.array(track.size)}
    write_arrays(path, {"frame_index": track.frames, **arrays, **facts, **size})


def load_track(path: Path) -> PoseTrack:
    """Read a canonical .npz.

    Raises:
        InputError: damaged, or something else.
    """
    try:
        return track_of(named(read_contents(path)))
    except KeyError as error:
        raise InputError(f"{path} is no canonical result: it has no {error}; give a result of hfb") from None


def track_of(content: dict[str, Any]) -> PoseTrack:
    """The record out of a canonical file's members.

    Raises:
        InputError: numbers of other shapes. KeyError: it is no such file.
    """
    frames = numbers(content["frame_index"], None).astype(np.int64)
    count = len(frames)
    shapes = {"poses": (count, 24, 3), "joints": (count, 24, 3), "K": (count, 3, 3), "betas": (count, 10)}
    read = {
        name: (
            _joints(content[name], count) if name == "joints" else numbers(content[name], *shapes.get(name, (count, 3)))
        )
        for name in _OPTIONAL
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
        **read,
    }
    return PoseTrack(system, person, frames, None if size is None else (size[0], size[1]), **known)


def _joints(value: object, count: int) -> Float[Array, "R 24 3"]:
    joints = array_in(value)
    if joints.shape != (count, 24, 3):
        raise InputError(f"it has joints of the shape {joints.shape} instead of {(count, 24, 3)}")
    return joints
