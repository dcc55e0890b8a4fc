"""The embedded example: one blurred image of the embedded body in motion, with its truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.synthetic.backgrounds import room_background
from hfb.datasets.synthetic.textures import clothes_texture
from hfb.datasets.truth import Truth, save_truth
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import (
    axis_angle_to_quaternion,
    in_hemisphere_of,
    multiply_quaternions,
    normalize_quaternion,
    quaternion_to_axis_angle,
    quaternion_to_matrix,
)
from hfb.io.media.images.image_io import write_png
from hfb.motion.clock import subframe_times_s
from hfb.motion.sampled import SampledMotion
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.typing import Float, Tensor

_SIZE_PX = 384
_EXPOSURE_S = 1 / 30
# Dense enough that neighbouring instants are less than a pixel apart; 7 * 8 + 1 holds the instants of N = 8.
_INSTANTS = 57
_SENSOR_NOISE = 0.004
# Seed 0 draws this one, a good case to show: docs/experiments has the figures of seven draws, good and bad.
_FIRST_DRAW = 9

# The stretch between the key poses that the exposure covers: a blur rate of about 0.6.
_FROM, _TO = 0.25, 0.47

# Key poses of a side step with both arms swinging: axis-angle in degrees, SMPL's rest frame (x left, y up, z front).
_START = {
    "left_shoulder": (0, 0, -62), "right_shoulder": (0, 0, 50), "left_elbow": (0, -35, 0), "right_elbow": (0, 45, 0),
    "left_hip": (-12, 0, 6), "right_hip": (-18, 0, -8), "left_knee": (22, 0, 0), "right_knee": (30, 0, 0),
    "left_ankle": (-8, 0, 0), "right_ankle": (-10, 0, 0), "spine1": (6, 0, 0), "neck": (4, 6, 0),
}  # fmt: skip
_END = {
    "left_shoulder": (0, -12, -8), "right_shoulder": (0, 10, -12), "left_elbow": (0, -20, 0), "right_elbow": (0, 22, 0),
    "left_hip": (-20, 0, 26), "right_hip": (-14, 0, -10), "left_knee": (28, 0, 0), "right_knee": (20, 0, 0),
    "left_ankle": (-8, 0, 0), "right_ankle": (-6, 0, 0), "spine1": (4, 8, 0), "spine2": (0, 6, 3), "neck": (0, -8, 0),
}  # fmt: skip


@dataclass(frozen=True)
class ExamplePaths:
    """Files of one example."""

    frame: Path
    background: Path
    truth: Path


def write_example(folder: Path, seed: int = 0) -> ExamplePaths:
    """Write the example into a folder: ``frame_0.png``, ``background.png`` and ``truth.npz``.

    The frame is the mean of 57 sub-frames in linear light, with sensor noise, stored in 8 bits. The motion is the
    same for every seed.

    Args:
        folder: written to; created where missing.
        seed: seed of shape, clothes, room and noise.
    """
    rng = np.random.default_rng(seed + _FIRST_DRAW)
    body = load_default_body()
    camera = PinholeCamera.from_focal(float(np.hypot(_SIZE_PX, _SIZE_PX)), _SIZE_PX, _SIZE_PX)
    betas = torch.from_numpy(np.clip(rng.normal(0, 0.7, 10), -1.5, 1.5)).float()
    poses, translations = _side_step(torch.linspace(0, 1, _INSTANTS))
    plate_srgb = room_background(_SIZE_PX, _SIZE_PX, rng).astype(np.float32)
    plate = srgb_to_linear(torch.from_numpy(plate_srgb))
    texture = clothes_texture(body, 512, rng)

    shaped = body.shape(betas)
    posed = shaped.pose(quaternion_to_matrix(axis_angle_to_quaternion(poses)), translations)
    rasterizer = make_rasterizer("coverage", "cpu", threads=1)
    pictures = rasterizer.render(posed.vertices, texture, camera, body.mesh)
    picture = compose(pictures.mean(0), plate).numpy()
    noisy = picture + rng.normal(0, _SENSOR_NOISE, picture.shape)
    frame_srgb = linear_to_srgb(torch.from_numpy(np.clip(noisy, 0, 1))).numpy().astype(np.float32)

    folder.mkdir(parents=True, exist_ok=True)
    paths = ExamplePaths(folder / "frame_0.png", folder / "background.png", folder / "truth.npz")
    write_png(paths.frame, frame_srgb)
    write_png(paths.background, plate_srgb)
    save_truth(paths.truth, _truth(body, poses, translations, betas, posed.joints, camera, pictures[..., 3]))
    return paths


def _truth(
    body: Body,
    poses: Float[Tensor, "S 24 3"],
    translations: Float[Tensor, "S 3"],
    betas: Float[Tensor, "10"],
    joints: Float[Tensor, "S 24 3"],
    camera: PinholeCamera,
    silhouettes: Float[Tensor, "S H W"],
) -> Truth:
    times_s, frame_index = subframe_times_s(1, len(poses), _EXPOSURE_S, _EXPOSURE_S)
    motion = SampledMotion(
        poses=poses.flatten(1).double().numpy(),
        trans=translations.double().numpy(),
        betas=betas.double().numpy(),
        joints=joints.double().numpy(),
        times_s=times_s,
        frame_index=frame_index,
        K=camera.matrix().double().numpy(),
    )
    return Truth(motion, (silhouettes >= 0.5).numpy(), body.betas_space)


def _side_step(u: Float[Tensor, "S"]) -> tuple[Float[Tensor, "S 24 3"], Float[Tensor, "S 3"]]:
    """Return poses (axis-angle, camera frame) and translations [m] of a person who steps aside and swings both arms."""
    eased = (_FROM + (_TO - _FROM) * (u + 0.12 * torch.sin(2 * torch.pi * u) / torch.pi))[:, None, None]
    start, end = axis_angle_to_quaternion(_key(_START)), axis_angle_to_quaternion(_key(_END))
    end = in_hemisphere_of(end, start)
    joints = normalize_quaternion((1 - eased) * start + eased * end)
    yaw = (0.45 - 0.5 * eased[:, 0, :]) * u.new_tensor([[0.0, 1.0, 0.0]])
    to_camera = axis_angle_to_quaternion(u.new_tensor([torch.pi, 0.0, 0.0]))
    joints[:, 0] = multiply_quaternions(to_camera.expand(len(u), 4), axis_angle_to_quaternion(yaw))
    path = u.new_tensor([[-0.15, 0.1, 3.6]]) + eased[:, 0, :] * u.new_tensor([[0.3, -0.03, -0.2]])
    return quaternion_to_axis_angle(joints), path


def _key(degrees: Mapping[str, tuple[float, float, float]]) -> Float[Tensor, "24 3"]:
    pose = torch.zeros(24, 3)
    for name, angles in degrees.items():
        pose[JOINT_NAMES.index(name)] = torch.deg2rad(torch.tensor(angles, dtype=torch.float32))
    return pose
