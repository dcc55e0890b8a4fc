"""From handles to what the method works on."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from hfb.body.assets import load_body
from hfb.body.model import Body
from hfb.geometry.camera import PinholeCamera
from hfb.io.media.pictures import read_matte, read_picture_srgb
from hfb.photometry import Transfer, as_srgb, linear_to_srgb, srgb_to_linear
from hfb.rendering.observation import Observation
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.typing import Array


def load_picture(picture: FileHandle, clip: ClipHandle) -> Tensor:
    """A picture (H, W, 3) in the light in which the clip's blur is an average."""
    return in_light(read_picture_srgb(picture.path, clip.transfer), clip.transfer, clip.light)


def in_light(picture: Array, transfer: Transfer, light: Literal["srgb", "linear"]) -> Tensor:
    """A picture (H, W, 3) as it was stored, in the light in which blur is an average."""
    stored = torch.from_numpy(as_srgb(picture, transfer))
    if transfer == light:
        return stored
    if light == "linear":
        return srgb_to_linear(stored)
    return linear_to_srgb(stored) if transfer == "linear" else stored


def load_camera(clip: ClipHandle) -> PinholeCamera:
    return PinholeCamera.from_matrix(torch.tensor(clip.K, dtype=torch.float64), clip.height, clip.width)


def load_observation(clip: ClipHandle, mattes: Sequence[FileHandle]) -> Observation:
    """The whole clip with its mattes."""
    return Observation(
        frames_linear=torch.stack([load_picture(frame, clip) for frame in clip.frames]),
        plate_linear=load_picture(clip.background, clip),
        mattes=load_mattes(mattes),
        camera=load_camera(clip),
        exposure_s=clip.exposure_s,
        interval_s=clip.interval_s,
        light=clip.light,
    )


def load_mattes(mattes: Sequence[FileHandle]) -> Tensor:
    """The person's share (T, H, W) of each pixel."""
    return torch.from_numpy(np.stack([read_matte(matte.path) for matte in mattes]))


def load_chosen_body(body: FileHandle | None) -> Body:
    """The user's body model, or the embedded one."""
    return load_body(body.path if body else None)


def load_texture(texture: FileHandle) -> Tensor:
    """The fitted texture (A, A, 3), in the clip's light."""
    with np.load(texture.path, allow_pickle=False) as file:
        return torch.from_numpy(file["texture"])
