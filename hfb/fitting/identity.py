"""Identity of a person in a clip: shape and texture, constant in every window."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hfb.errors import InputError
from hfb.io.array_files import read_arrays
from hfb.motion.motion_file import write_arrays
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
