"""The static body that every fit starts from."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from hfb.body.model import Body, bone_length
from hfb.errors import InputError
from hfb.io.array_files import read_arrays
from hfb.motion.motion_file import write_arrays
from hfb.typing import Float, Tensor

_NUMBERS = {"pose": (24, 3), "translation": (3,), "betas": (10,)}


@dataclass(frozen=True)
class FirstBody:
    """One body for one frame, in camera coordinates.

    Attributes:
        pose: axis-angle per joint [rad], the root first; the root rotates the rest body into the camera's frame.
        translation: added to the posed vertices, as in SMPL [m].
        betas: shape coefficients of the body model in use.
        source: which estimator made it, e.g. ``"mediapipe"`` or ``"matte"``.
    """

    pose: Float[Tensor, "24 3"]
    translation: Float[Tensor, "3"]
    betas: Float[Tensor, "10"]
    source: str


def rescale_first_body(first: FirstBody, betas: Float[Tensor, "10"], body: Body) -> FirstBody:
    """Change the shape of a first body and keep its size in the image.

    The pelvis keeps its direction from the camera; its distance changes by the ratio of the total bone lengths.

    Args:
        first: the body to change.
        betas: its new shape coefficients.
        body: the body model.
    """
    dtype = body.template.dtype
    before, after = (body.rest_joints(one.to(dtype)) for one in (first.betas, betas))
    factor = bone_length(after) / bone_length(before)
    translation = factor * (first.translation.to(dtype) + before[0]) - after[0]
    return replace(first, translation=translation.to(first.translation), betas=betas.to(first.betas).clone())


@dataclass(frozen=True)
class OtherFront:
    """The same frames' bodies facing the other way, for starts whose front is doubtful.

    Attributes:
        bodies: one per frame.
        doubt: how much surer the joint network is of the bodies as found (`hfb.initialization.fronts.front_doubts`).
        to_the_end: fit them to the end, however clear it is before.
    """

    bodies: tuple[FirstBody, ...]
    doubt: float
    to_the_end: bool = False


def save_first_body(path: Path, first: FirstBody) -> None:
    """Write a first body (.npz, no pickle) whole or not at all.

    Args:
        path: the .npz file.
        first: the body.
    """
    numbers = {name: getattr(first, name).double().numpy() for name in _NUMBERS}
    write_arrays(path, numbers | {"source": np.array(first.source)})


def load_first_body(path: Path) -> FirstBody:
    """Read a first body.

    Args:
        path: the .npz file.

    Raises:
        InputError: missing, damaged, or of other shapes.
    """
    try:
        found = read_arrays(path, (*_NUMBERS, "source"))
        numbers, source = {name: found[name] for name in _NUMBERS}, str(found["source"])
    except FileNotFoundError:
        raise InputError(f"there is no first body at {path}") from None
    except (KeyError, ValueError, OSError) as error:
        raise InputError(f"{path} is not a first body of hfb ({error})") from None
    for name, shape in _NUMBERS.items():
        if (
            numbers[name].shape != shape
            or numbers[name].dtype.kind not in "fiu"
            or not np.isfinite(numbers[name]).all()
        ):
            raise InputError(f"{path} is not a first body of hfb: {name} must be {shape} finite numbers")
    tensors = {name: torch.from_numpy(array).float() for name, array in numbers.items()}
    return FirstBody(**tensors, source=source)
