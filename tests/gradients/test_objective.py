"""Every free parameter reaches the loss, with a finite gradient that matches finite differences in float64."""

from dataclasses import replace

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import Weights
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.trajectory import Trajectory, trajectory_at_rest
from hfb.objective.objective import Objective
from hfb.objective.texture import texel_neighbours
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.texels import texel_faces
from tests.scenes import moving_scene

PARAMETERS = ("rotation", "translation", "betas", "texture")
EVERY_TERM = Weights(
    image=1, matte=1, texture=0.1, pose=0.01, shape=0.01, motion=0.01, background=0.1, boundary=1, start=0.1
)  # fmt: skip


def objective_and_leaves(kind: str, silhouette: str, backend: str) -> tuple[Objective, dict[str, torch.Tensor]]:
    body = load_default_body(torch.float64)
    size_px = 32 if backend == "cpu" else 16  # the reference looks at every face from every pixel
    scene = moving_scene(load_default_body(), size_px=size_px, frames=2)
    seen = scene.observation
    seen = replace(
        seen,
        frames_linear=seen.frames_linear.double(),
        plate_linear=seen.plate_linear.double(),
        mattes=(seen.mattes * 0.97).double(),  # nowhere exactly equal to a rendered alpha: min and max have kinks there
    )
    texels = texel_neighbours(body.mesh, body.template, texel_faces(body.mesh, 16))
    objective = Objective(
        seen,
        body,
        make_rasterizer(silhouette, backend, 1),
        AnatomicalPrior(),
        EVERY_TERM,
        subframes=3,
        texels=texels,
        first=axis_angle_to_matrix(torch.stack([first.pose for first in scene.middle]).double()),
    )
    generator = torch.Generator().manual_seed(5)
    poses = torch.stack([first.pose for first in scene.middle]).double()
    poses = poses + 0.1 * torch.randn(poses.shape, generator=generator, dtype=torch.float64)
    translations = torch.stack([first.translation for first in scene.middle]).double()
    trajectory = trajectory_at_rest(poses, translations, 2, kind)
    rotation = trajectory.rotation + 0.03 * torch.randn(
        trajectory.rotation.shape, generator=generator, dtype=torch.float64
    )
    translation = trajectory.translation + 0.03 * torch.randn(
        trajectory.translation.shape, generator=generator, dtype=torch.float64
    )
    leaves = {
        "rotation": rotation,
        "translation": translation,
        "betas": 0.3 * torch.randn(10, generator=generator, dtype=torch.float64),
        "texture": torch.rand(16, 16, 3, generator=generator, dtype=torch.float64),
    }
    return objective, {name: leaf.requires_grad_() for name, leaf in leaves.items()}


def loss_of(objective: Objective, kind: str, leaves: dict[str, torch.Tensor]) -> torch.Tensor:
    trajectory = Trajectory(leaves["rotation"], leaves["translation"], kind)
    return objective.total(objective.terms(trajectory, leaves["betas"], leaves["texture"]))


@pytest.mark.parametrize("kind", ["quaternion", "axis-angle"])
@pytest.mark.parametrize("silhouette", ["coverage", "dibr"])
@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_gradients_match_finite_differences(kind: str, silhouette: str, backend: str) -> None:
    objective, leaves = objective_and_leaves(kind, silhouette, backend)
    loss = loss_of(objective, kind, leaves)
    gradients = dict(zip(PARAMETERS, torch.autograd.grad(loss, [leaves[name] for name in PARAMETERS]), strict=True))
    generator = torch.Generator().manual_seed(7)
    for name in PARAMETERS:
        gradient = gradients[name]
        assert torch.isfinite(gradient).all(), name
        assert gradient.abs().max() > 0, f"{name} does not reach the loss"
        direction = torch.randn(gradient.shape, generator=generator, dtype=torch.float64)
        direction = direction * (gradient != 0) / direction.norm()
        step = 1e-6
        with torch.no_grad():
            ahead = loss_of(objective, kind, leaves | {name: leaves[name] + step * direction})
            behind = loss_of(objective, kind, leaves | {name: leaves[name] - step * direction})
        numeric = float(ahead - behind) / (2 * step)
        analytic = float((gradient * direction).sum())
        scale = max(abs(analytic), float(gradient.norm()) * 1e-2)
        assert abs(numeric - analytic) <= 1e-3 * scale, f"{name}: {numeric} against {analytic}"
