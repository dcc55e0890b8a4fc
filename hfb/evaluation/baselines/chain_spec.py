"""chains.toml: deblur-then-estimate baselines with a user's own networks, images and poses.

    [bin-metro]                            # a method's name for --methods
    deblurrer = "bin.pt"                   # TorchScript or ONNX; or pictures = "DIR"; neither: the blurred frame itself
    estimator = "metro.onnx"               # or "mediapipe", or "matte"; or poses = "DIR" in place of both

    [bin-metro.deblurrer_layout]           # every key may be left out; the values shown are the defaults
    frames = "one"                         # "stacked": all frames as channels of one tensor; "list": one argument each
    normalisation = "unit"                 # sRGB in 0..1; "signed" -1..1; "imagenet"; the same for its output
    channels = "rgb"                       # or "bgr"
    multiple_of = 1                        # picture sides are padded to a multiple of this [px]
    output = 0                             # number or name of the output that holds the sub-frames, (N,3,H,W) or
                                           # (1,3N,H,W); when not given, all of them do, one after another
    times = [0.0, 0.5, 1.0]                # of its sub-frames, in exposures; evenly from 0 to 1 when not given

    [bin-metro.estimator_layout]
    size_px = 224                          # square crop around the person
    margin = 1.2                           # crop's side over the matte's longer one
    normalisation = "imagenet"
    channels = "rgb"
    y_up = false                           # the network's y axis points up (the picture's points down)
    pose = 0                               # outputs by number or name, those that there are; the first wins:
    vertices = 4                           #   (V, 3) [m]: all of the body model in use, 6890 of SMPL's
    joints = 1                             #   (24|17|14, 3) [m]: SMPL's, Human3.6M's 17, the usual 14
    camera = 3                             # weak perspective (scale, x, y) in the crop; else the start's place
    betas = 4                              # else the start's

A pose is 24 axis-angles, matrices, or pairs of matrix columns (6D).
Layouts in short: Jin et al. and AfB take one frame, BIN takes several. METRO: camera = 0, joints = 1, or with SMPL's
body vertices = 4, its finest mesh. Of 14 or 17 joints the 14-joint errors can be told, no silhouettes.
Folders: pictures/case_0001/frame_0/00.png, 01.png, ... or pictures/case_0001/frame_0.mp4; poses/case_0001.npz with
poses (R,72) or joints (R,24,3) or vertices (R,6890,3), optionally trans (R,3), frame after frame.
Paths are relative to the chains file.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hfb.config import Record
from hfb.errors import InputError
from hfb.io.toml_file import read_toml, to_record

Output = Annotated[int, Field(ge=0)] | str
Normalisation = Literal["unit", "signed", "imagenet"]
_BUILT_IN = ("mediapipe", "matte")


class DeblurrerLayout(Record):
    """Input and output of a deblurring network."""

    frames: Literal["one", "stacked", "list"] = "one"
    normalisation: Normalisation = "unit"
    channels: Literal["rgb", "bgr"] = "rgb"
    multiple_of: int = Field(1, ge=1, le=256)
    output: Output | None = None
    times: tuple[Annotated[float, Field(ge=0, le=1)], ...] | None = Field(None, min_length=1)

    @model_validator(mode="after")
    def _in_time(self) -> DeblurrerLayout:
        if self.times is not None and list(self.times) != sorted(set(self.times)):
            raise ValueError("times must increase")
        return self


class EstimatorLayout(Record):
    """Input and output of a pose network."""

    size_px: int = Field(224, ge=8, le=4096)
    margin: float = Field(1.2, gt=0, le=4)
    normalisation: Normalisation = "imagenet"
    channels: Literal["rgb", "bgr"] = "rgb"
    y_up: bool = False
    pose: Output | None = None
    joints: Output | None = None
    vertices: Output | None = None
    camera: Output | None = None
    betas: Output | None = None

    @property
    def says_pose(self) -> bool:
        """Return whether any output is named from which limbs can be computed."""
        return any(output is not None for output in (self.pose, self.joints, self.vertices))


class ChainSpec(Record):
    """One table of a chains file."""

    deblurrer: Path | None = None
    pictures: Path | None = None
    estimator: Path | Literal["mediapipe", "matte"] | None = None
    poses: Path | None = None
    deblurrer_layout: DeblurrerLayout = DeblurrerLayout()
    estimator_layout: EstimatorLayout = EstimatorLayout()

    @model_validator(mode="after")
    def _one_way(self) -> ChainSpec:
        if (self.estimator is None) == (self.poses is None):
            raise ValueError('give estimator = "NETWORK" (or "mediapipe", "matte") or poses = "DIR", one of them')
        if self.deblurrer is not None and self.pictures is not None:
            raise ValueError("give deblurrer or pictures, not both")
        if self.poses is not None and (self.deblurrer is not None or self.pictures is not None):
            raise ValueError("poses need no deblurrer and no pictures; leave them out")
        if isinstance(self.estimator, Path) and not self.estimator_layout.says_pose:
            raise ValueError("estimator_layout must name the network's output: pose = 0, joints = 0 or vertices = 0")
        return self

    def paths(self) -> list[Path]:
        """Return every file and folder that the chain names."""
        named = (self.deblurrer, self.pictures, self.estimator, self.poses)
        return [path for path in named if isinstance(path, Path)]


def read_chains(path: Path) -> dict[str, ChainSpec]:
    """Read the methods of a chains file; relative paths are resolved against its folder.

    Args:
        path: a chains.toml, a table per method.

    Raises:
        InputError: no such file, no TOML, or a table with an unknown or impossible entry.
    """
    chains = {}
    for name, table in read_toml(path).items():
        if not re.fullmatch(r"[A-Za-z0-9_.+-]+", name):
            raise InputError(f"{path}: [{name}] is no name of a method; use letters, digits, '-', '_', '+' and '.'")
        content = table if isinstance(table, dict) else {"": table}
        chains[name] = to_record(ChainSpec, _absolute(content, path.parent), f"{path}, [{name}]")
    return chains


def _absolute(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Resolve paths against the chains file's folder, and convert TOML's texts and lists to pydantic's strict types."""
    content = dict(table)
    for key in ("deblurrer", "pictures", "estimator", "poses"):
        value = content.get(key)
        if isinstance(value, str) and not (key == "estimator" and value in _BUILT_IN):
            try:
                content[key] = (folder / value).resolve()
                content[key].exists()  # a name that is too long is found out here
            except (OSError, ValueError, RuntimeError):  # a name that no file can have
                raise InputError(f"{key} {value[:80]!r} is no name of a file") from None
    return content
