"""Small synthetic scenes that several tests share: a body that moves, seen by one camera."""

from dataclasses import dataclass

import torch

from hfb.body.model import Body
from hfb.datasets.truth import Truth
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.clock import subframe_times_s
from hfb.motion.sampled import SampledMotion
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation


@dataclass(frozen=True)
class Scene:
    """What is seen, what happened, and a still body in the middle of it."""

    observation: Observation
    truth: Truth
    middle: list[FirstBody]


def standing_pose() -> torch.Tensor:
    """Upright, facing the camera, arms held away from the body; axis-angle [rad]."""
    pose = torch.zeros(24, 3)
    pose[0, 0] = torch.pi
    pose[16, 2], pose[17, 2] = -0.7, 0.7
    return pose


def moving_scene(
    body: Body, size_px: int = 96, frames: int = 1, instants: int = 15, step_m: float = 0.15, arm_rad: float = 0.5
) -> Scene:
    """The body steps to its left (+x) by step_m per frame while both arms rise by arm_rad per frame."""
    u = torch.linspace(0, frames, instants * frames)
    poses = standing_pose().expand(len(u), 24, 3).clone()
    poses[:, 16, 2] += arm_rad * u / frames
    poses[:, 17, 2] -= arm_rad * u / frames
    translations = torch.tensor([0.0, 0.1, 3.4]) + torch.stack([step_m * (u - frames / 2), 0 * u, 0 * u], -1)
    camera = PinholeCamera.from_focal(1.4 * size_px, size_px, size_px)
    generator = torch.Generator().manual_seed(0)
    plate = 0.3 + 0.4 * torch.rand(size_px, size_px, 3, generator=generator)
    texture = torch.rand(8, 8, 3, generator=generator).repeat_interleave(8, 0).repeat_interleave(8, 1)
    betas = torch.zeros(10)
    posed = body.shape(betas).pose(axis_angle_to_matrix(poses), translations)
    pictures = make_rasterizer("coverage", "cpu", 1).render(posed.vertices, texture, camera, body.mesh)
    mean = pictures.unflatten(0, (frames, instants)).mean(1)
    times_s, frame_index = subframe_times_s(frames, instants, 0.03, 0.03 * instants / (instants - 1))
    motion = SampledMotion(
        poses.flatten(1).double().numpy(),
        translations.double().numpy(),
        betas.double().numpy(),
        posed.joints.double().numpy(),
        times_s,
        frame_index,
        camera.matrix().double().numpy(),
    )
    observation = Observation(compose(mean, plate), plate, mean[..., 3], camera, 0.03, 0.03 * instants / (instants - 1))
    middle = range(instants // 2, len(u), instants)
    still = [FirstBody(poses[row], translations[row], betas, "middle of the truth") for row in middle]
    return Scene(observation, Truth(motion, (pictures[..., 3] >= 0.5).numpy(), body.betas_space), still)
