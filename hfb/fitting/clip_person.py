"""One person for a whole clip: shape and texture that every window holds on to."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from hfb.body.model import Body, bone_length
from hfb.errors import InputError
from hfb.io.array_files import read_arrays
from hfb.motion.motion_file import write_arrays
from hfb.motion.static_pose import FirstBody
from hfb.typing import Float, Tensor


@dataclass(frozen=True)
class ClipPerson:
    """Who is seen: shape coefficients of the body model in use, and a texture in linear light."""

    betas: Float[Tensor, "10"]
    texture: Float[Tensor, "A A 3"]


def as_person(first: FirstBody, betas: Float[Tensor, "10"], body: Body) -> FirstBody:
    """The same pose and place in the picture with another shape: who is larger stands further away.

    The pelvis keeps its direction from the camera, its distance changes by the ratio of the total bone lengths.
    """
    dtype = body.template.dtype
    before, after = (body.rest_joints(one.to(dtype)) for one in (first.betas, betas))
    factor = bone_length(after) / bone_length(before)
    translation = factor * (first.translation.to(dtype) + before[0]) - after[0]
    return replace(first, translation=translation.to(first.translation), betas=betas.to(first.betas).clone())


def save_person(path: Path, person: ClipPerson) -> None:
    """Write a person (.npz, no pickle) whole or not at all."""
    write_arrays(path, {"betas": person.betas.double().numpy(), "texture": person.texture.float().numpy()})


def load_person(path: Path) -> ClipPerson:
    """Read a person.

    Raises:
        InputError: missing, damaged, or of other shapes.
    """
    try:
        found = read_arrays(path, ("betas", "texture"))
        betas, texture = found["betas"].astype(np.float64), found["texture"].astype(np.float64)
    except FileNotFoundError:
        raise InputError(f"there is no person at {path}") from None
    except (KeyError, ValueError, OSError) as error:
        raise InputError(f"{path} is not a person of hfb ({error}); delete it to have it made again") from None
    square = texture.ndim == 3 and texture.shape[0] == texture.shape[1] and texture.shape[2] == 3
    if betas.shape != (10,) or not square or not (np.isfinite(betas).all() and np.isfinite(texture).all()):
        raise InputError(f"{path} is not a person of hfb; delete it to have it made again")
    return ClipPerson(torch.from_numpy(betas).float(), torch.from_numpy(texture).float())
