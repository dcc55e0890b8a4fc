"""The pictures that `test_golden.py` compares with the ones stored here; see `regenerate.py`."""

from collections.abc import Callable

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, multiply_quaternions
from hfb.photometry import linear_to_srgb
from hfb.rendering.backends import make_rasterizer

SIZE_PX = 96
LEFT_SHOULDER, RIGHT_SHOULDER, LEFT_ELBOW, RIGHT_ELBOW = 16, 17, 18, 19
BACKGROUND_LINEAR = 0.18


def _texture() -> torch.Tensor:
    """Squares in colours that tell one part of the body from another."""
    rows, columns = torch.meshgrid(torch.arange(64), torch.arange(64), indexing="ij")
    squares = ((rows // 4 + columns // 4) % 2).float()[..., None]
    hue = torch.stack([rows / 63, columns / 63, 1 - rows / 63], -1)
    return 0.15 + 0.7 * hue * (0.4 + 0.6 * squares)


def _standing(yaw_rad: float) -> torch.Tensor:
    pose = torch.zeros(24, 3)
    upright, turn = torch.tensor([0.0, 1.0, 0.0, 0.0]), torch.tensor([np.cos(yaw_rad / 2), 0, np.sin(yaw_rad / 2), 0])
    quaternion = multiply_quaternions(upright, turn.float())
    pose[0] = 2 * torch.acos(quaternion[0]) * torch.nn.functional.normalize(quaternion[1:], dim=0)
    pose[LEFT_SHOULDER, 2], pose[RIGHT_SHOULDER, 2] = -1.0, 1.0
    return pose


def _front() -> torch.Tensor:
    return _standing(0.0)


def _side() -> torch.Tensor:
    return _standing(1.4)


def _arm_over_torso() -> torch.Tensor:
    pose = _standing(0.3)
    pose[RIGHT_SHOULDER] = torch.tensor([0.0, 0.5, 1.0])
    pose[RIGHT_ELBOW] = torch.tensor([0.0, 1.0, 1.4])
    return pose


POSES: dict[str, Callable[[], torch.Tensor]] = {"front": _front, "side": _side, "arm_over_torso": _arm_over_torso}
VIEWS = [f"{pose}_{silhouette}" for pose in POSES for silhouette in ("coverage", "dibr")]


def draw_view(name: str) -> np.ndarray:
    """One view as stored: 8-bit sRGB over grey."""
    pose, silhouette = name.rsplit("_", 1)
    body = load_default_body()
    person = body.shape(torch.zeros(10))
    place = torch.tensor([[0.0, -0.02, 3.0]]) - person.joints[0]
    posed = person.pose(axis_angle_to_matrix(POSES[pose]())[None], place)
    camera = PinholeCamera.from_focal(1.42 * SIZE_PX, SIZE_PX, SIZE_PX)
    picture = make_rasterizer(silhouette, "cpu", 1).render_mean(posed.vertices, _texture(), camera, body.mesh)
    over_grey = picture[..., :3] + (1 - picture[..., 3:]) * BACKGROUND_LINEAR
    return (linear_to_srgb(over_grey).numpy() * 255 + 0.5).astype(np.uint8)
