"""Identity of a person in a clip: shape and texture, constant in every window."""

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
class Identity:
    """Shape and texture of one person.

    Attributes:
        betas: coefficients of the body model in use.
        texture: linear light.
    """

    betas: Float[Tensor, "10"]
    texture: Float[Tensor, "A A 3"]


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


def save_identity(path: Path, identity: Identity) -> None:
    """Write an identity (.npz, no pickle) atomically.

    Args:
        path: file to write.
        identity: shape and texture.
    """
    write_arrays(path, {"betas": identity.betas.double().numpy(), "texture": identity.texture.float().numpy()})


def load_identity(path: Path) -> Identity:
    """Read an identity.

    Args:
        path: the file.

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
    return Identity(torch.from_numpy(betas).float(), torch.from_numpy(texture).float())
