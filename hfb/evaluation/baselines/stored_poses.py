"""Another system's results for a case: an .npz with poses, joints or meshes of its sub-frames."""

from pathlib import Path

import numpy as np
import torch

from hfb.body.model import Body
from hfb.errors import InputError
from hfb.evaluation.baselines.estimates import Estimate
from hfb.evaluation.baselines.estimators import regress_joints
from hfb.initialization.joint_layouts import joints_as_24
from hfb.io.array_files import read_arrays
from hfb.typing import Array, Float

_LIMIT_BYTES = 256 << 20
_KNOWN = ("poses", "joints", "vertices", "trans")


def read_estimates(path: Path, frames: int, body: Body) -> list[list[Estimate | None]]:
    """Read the estimates of every frame's sub-frames; rows of NaN are instants without a detection.

    Args:
        path: the .npz.
        frames: number of blurred frames.
        body: model of the poses or meshes.

    Raises:
        InputError: no such file, damaged, nothing known in it, or rows that do not fit the frames.
    """
    arrays = _read(path)
    kind = next((name for name in ("poses", "vertices", "joints") if name in arrays), None)
    if kind is None:
        raise InputError(f"{path} holds no poses; give poses (R,72), vertices (R,V,3) or joints (R,24,3)")
    rows = len(arrays[kind])
    if rows == 0 or rows % frames:
        raise InputError(f"{path}: {rows} rows do not divide into {frames} frames; give equally many for each, in time")
    places = arrays.get("trans")
    if places is not None and places.shape != (rows, 3):
        raise InputError(f"{path}: trans is {places.shape} instead of ({rows}, 3)")
    found: list[Estimate | None] = []
    for row, value in enumerate(arrays[kind]):
        if not np.isfinite(value).any():
            found.append(None)
            continue
        if not np.isfinite(value).all() or (places is not None and not np.isfinite(places[row]).all()):
            raise InputError(f"{path}: row {row} is only partly finite; a row without a person is all NaN")
        found.append(_estimate(kind, value, None if places is None else places[row], body, path))
    per_frame = [found[start : start + rows // frames] for start in range(0, rows, rows // frames)]
    if not all(any(frame) for frame in per_frame):
        raise InputError(f"{path}: a frame has no estimate at all")
    return per_frame


def _estimate(kind: str, value: Array, place: Array | None, body: Body, path: Path) -> Estimate:
    translation = None if place is None else torch.from_numpy(place).float()
    if kind == "poses":
        if value.size != 72:
            raise InputError(f"{path}: a pose has {value.size} numbers instead of 72 (axis-angle of 24 joints)")
        return Estimate(torch.from_numpy(value.reshape(24, 3)).float(), translation)
    if value.ndim != 2 or value.shape[1] != 3:
        raise InputError(f"{path}: {kind} has rows of {value.shape} instead of (number, 3)")
    points = regress_joints(value, body, str(path)) if kind == "vertices" else value
    return Estimate(translation=translation, joints=joints_as_24(points))


def _read(path: Path) -> dict[str, Float[Array, "..."]]:
    """Read the known members; sizes are checked first and no pickle is opened."""
    try:
        arrays = read_arrays(path, _KNOWN, _LIMIT_BYTES)
    except FileNotFoundError:
        raise InputError(f"there are no poses at {path}; give one .npz per case") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as an .npz of plain arrays ({error})") from None
    for name, array in arrays.items():
        if array.dtype.kind not in "fiu" or array.ndim < 2:
            raise InputError(f"{path}: {name} holds no rows of numbers")
    return {name: array.astype(np.float64) for name, array in arrays.items()}
