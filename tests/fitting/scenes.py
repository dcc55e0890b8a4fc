"""A fit that is done: the scene's own motion as polynomials, turned as a test wants it."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.height import height_m
from hfb.config import preset
from hfb.evidence.joint_evidence import JointEvidence
from hfb.evidence.joint_network import Window
from hfb.fitting.reversal import limb_columns, reverse_columns
from hfb.fitting.variables import Variables
from hfb.geometry.rotations import axis_angle_to_matrix, axis_angle_to_quaternion
from hfb.motion.trajectory import trajectory_at_rest
from hfb.objective.objective import Objective
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.motion_columns import LIMBS
from hfb.priors.motion_prior import MotionPrior
from hfb.rendering.backends import make_rasterizer
from tests.scenes import Scene, moving_scene

LIMB = {name: place for place, name in enumerate(LIMBS)}


@dataclass(frozen=True)
class Done:
    """A scene, variables that explain it but for what was turned, and its objectives at two sizes."""

    scene: Scene
    found: Variables
    coarse: Objective
    fine: Objective


def done(frames: int = 1, turned: tuple[tuple[int, str], ...] = (), prior: MotionPrior | None = None) -> Done:
    """The body steps aside and raises both arms; each (frame, limb) of `turned` runs backwards.

    Limb "all" is the whole body. The texture is one colour: the matte and the picture's outline say what moved.
    """
    body = load_default_body()
    scene = moving_scene(body, size_px=72, frames=frames, instants=9, step_m=0.4, arm_rad=0.9)
    truth = scene.truth.motion
    poses = torch.from_numpy(truth.poses).float().unflatten(1, (24, 3)).unflatten(0, (frames, -1))
    path = torch.from_numpy(truth.trans).float().unflatten(0, (frames, -1))
    motion = trajectory_at_rest(poses[:, 4], path[:, 4], 2, "quaternion", 0.5)
    rotation, translation = motion.rotation.clone(), motion.translation.clone()
    ends = axis_angle_to_quaternion(poses[:, [0, -1]])
    rotation[:, 1] = ends[:, 1] - ends[:, 0]  # about the middle, nearly straight: an arm turns at a steady rate
    translation[:, 1, :3] = path[:, -1] - path[:, 0]
    limbs = torch.zeros(frames, 5, dtype=torch.bool)
    for frame, name in turned:
        limbs[frame, slice(None) if name == "all" else LIMB[name]] = True
    motion = reverse_columns(motion.with_coefficients(rotation, translation), limb_columns(limbs))
    found = Variables(motion, torch.zeros(10), torch.full((8, 8, 3), 0.5))
    window = scene.observation.cropped(*scene.observation.region())
    weights = preset("best").fit.weights.model_copy(update={"joints": 0.0, "path": 0.0, "height": 0.0})
    first = axis_angle_to_matrix(torch.stack([one.pose for one in scene.middle]))
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    fine = Objective(
        window.resized(72), body, rasterizer, AnatomicalPrior(), weights, 6, first, matte_scales=3, motion_prior=prior
    )
    return Done(scene, found, replace(fine, observation=window.resized(40)), fine)


def true_joints(scene: Scene, rows: int) -> np.ndarray:
    """The truth at the instants of a fit with `rows` rows."""
    times = scene.truth.motion.times_s
    frames = len(scene.middle)
    exposures = [scene.observation.interval_s * k + np.linspace(0, 0.03, rows // frames) for k in range(frames)]
    wanted = np.concatenate(exposures)
    return scene.truth.motion.joints[np.abs(times[None] - wanted[:, None]).argmin(1)]


def true_evidence(scene: Scene, log_odds: float = 1.0) -> JointEvidence:
    """What a joint network would say that is always right, as sure as asked about which way each frame's path runs."""
    seen, truth = scene.observation, scene.truth.motion
    windows, middles, paths = [], [], []
    for frame, matte in enumerate(seen.mattes):
        window = Window.around(matte.numpy(), seen.camera)
        units = window.to_units(torch.from_numpy(truth.joints[truth.frame_index == frame]).float())
        windows.append(window)
        middles.append(units[len(units) // 2])
        paths.append(units[-1] - units[0])
    middle, path = torch.stack(middles), torch.stack(paths)
    odds = torch.full((len(windows),), log_odds)
    log_height = height_m(load_default_body(), torch.from_numpy(truth.betas).float()).log()
    scale = torch.full_like(middle, 0.02)
    return JointEvidence(tuple(windows), middle, scale, path, odds, middle, log_height, torch.tensor(0.02))
