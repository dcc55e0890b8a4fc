"""The terms of body and motion: compiled operators against the readable formulas, and as torch itself checks them."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import PARENT_TABLE
from hfb.config import Weights
from hfb.evidence.joint_evidence import JointEvidence
from hfb.evidence.joint_network import Window
from hfb.fitting.variables import Variables
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.kernels.dispatch import readable_formulas
from hfb.kernels.motion.motion_operators import boundary
from hfb.kernels.motion.rescale_operators import as_large
from hfb.kernels.objective import evidence_operators as evidence
from hfb.kernels.objective.regularizer_operators import motion_size, start_distance
from hfb.motion.trajectory import trajectory_at_rest
from hfb.objective.objective import Objective
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer
from tests.scenes import moving_scene

BODY = load_default_body(torch.float64)
TERMS = ("joints", "path", "pose", "start", "height", "shape", "motion", "boundary")
WEIGHTS = Weights(image=0, matte=0, background=0, adversarial=0, texture=0, **dict.fromkeys(TERMS, 1.0))


def random(*size: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def problem(frames: int, warm_up: bool, way: float) -> tuple[Objective, Variables]:
    """Somebody who moves, and claims that are wrong; `way`: how far the body moves."""
    scene = moving_scene(load_default_body(), size_px=48, frames=frames)
    seen = scene.observation
    poses = torch.stack([one.pose for one in scene.middle]).double() + 0.2 * random(frames, 24, 3)
    trajectory = trajectory_at_rest(
        poses, torch.stack([one.translation for one in scene.middle]).double(), 3, origin=0.5
    )
    rotation = trajectory.rotation + way * 0.1 * random(frames, 4, 24, 4, seed=1)
    translation = trajectory.translation + way * 0.1 * random(frames, 4, 4, seed=2)
    rotation[:, 0] = trajectory.rotation[:, 0]
    windows = tuple(Window.around(matte.numpy(), seen.camera) for matte in seen.mattes)
    middle, scale, path = (0.5 * random(frames, 24, 3, seed=seed) for seed in (3, 4, 5))
    claims = JointEvidence(
        windows,
        middle,
        0.1 + scale.abs(),
        path,
        torch.ones(frames),
        middle,
        torch.tensor(0.5, dtype=torch.float64),
        torch.tensor(0.05, dtype=torch.float64),
    )
    first = axis_angle_to_matrix(poses + 0.3 * random(frames, 24, 3, seed=6))
    objective = Objective(
        seen,
        BODY,
        make_rasterizer(),
        AnatomicalPrior(),
        WEIGHTS,
        5,
        first,
        evidence=claims,
        xy_weight=0.3,
        warm_up=warm_up,
    )
    betas = random(10, seed=7)
    return objective, Variables(
        trajectory.with_coefficients(rotation, translation), betas, torch.zeros(8, 8, 3), betas + random(10, seed=8)
    )


def found(objective: Objective, variables: Variables, with_course: bool) -> dict[str, tuple[torch.Tensor, ...]]:
    """Every term's value and gradients."""
    leaves = [one.clone().requires_grad_() for one in variables.leaves()[:3]]
    moving = replace(variables, trajectory=variables.trajectory.with_coefficients(*leaves[:2]), betas=leaves[2])
    motion = moving.motion(BODY)
    if with_course:
        terms = objective.vertices_and_terms(motion, leaves[2])[1]
    else:
        terms = objective.body_terms(motion, leaves[2], BODY.shape(leaves[2]))
    values = {}
    for name, term in terms.items():
        gradients = torch.autograd.grad(term, leaves, retain_graph=True, allow_unused=True)
        values[name] = (
            term.detach(),
            *(torch.zeros_like(leaf) if one is None else one for leaf, one in zip(leaves, gradients, strict=True)),
        )
    return values


@pytest.mark.parametrize("warm_up", [False, True])
@pytest.mark.parametrize("with_course", [False, True])
@pytest.mark.parametrize(("frames", "way"), [(1, 1.0), (1, 0.0), (3, 1.0)])
def test_compiled_terms_are_the_readable_ones(frames: int, way: float, with_course: bool, warm_up: bool) -> None:
    objective, variables = problem(frames, warm_up, way)
    fast = found(objective, variables, with_course)
    with readable_formulas():
        slow = found(objective, variables, with_course)
    expected = set(TERMS) - ({"boundary"} if frames == 1 else set() if warm_up else {"path"})
    assert set(fast) == set(slow) == expected
    for name, values in fast.items():
        for ours, theirs in zip(values, slow[name], strict=True):
            # A body at rest goes neither way: there the two gradients of the path cancel each other.
            torch.testing.assert_close(
                ours, theirs, rtol=1e-9, atol=1e-9, msg=lambda told, name=name: f"{name}: {told}"
            )


def test_a_reversed_way_is_as_far() -> None:
    """The gradient of whichever way is nearer: both signs of the same way have the same loss."""
    joints = random(1, 3, 24, 3) + torch.tensor([0.0, 0, 5], dtype=torch.float64)
    lenses, path = torch.tensor([[2.0, 2, 0.1, 0.2, 0.3]], dtype=torch.float64), random(1, 24, 3, seed=1)
    values = [
        evidence.off_path(way, lenses, sign * path, torch.ones_like(path), True)
        for way in (joints, joints[:, [1, 0, 2]])
        for sign in (1, -1)
    ]
    for value, gradient in values[1:]:
        torch.testing.assert_close(value, values[0][0])
        torch.testing.assert_close(gradient.square().sum(), values[0][1].square().sum())


def operators() -> dict[str, tuple[Any, tuple[Any, ...]]]:
    joints = random(2, 4, 24, 3) + torch.tensor([0.0, 0, 5], dtype=torch.float64)
    lenses, claims, scale = 1 + random(2, 5).abs(), random(2, 24, 3, seed=1), 1 + random(2, 24, 3, seed=2).abs()
    rows = random(10, 72)
    return {
        "off_middle": (evidence.off_middle, (joints, lenses, claims, scale, torch.tensor([0.2, 0.2, 1.0]).double())),
        "off_path": (evidence.off_path, (joints, lenses, claims, scale, True)),
        "off_height": (evidence.off_height, (random(10), 0.05 * random(10, seed=1), 1.7, 0.5, 0.1)),
        "motion_size": (motion_size, (random(2, 3, 24, 4), random(2, 3, 4, seed=1), 1e-6)),
        "start_distance": (start_distance, (random(2, 4, 24, 3, 3), random(2, 24, 3, 3, seed=1))),
        "boundary": (boundary, (random(3, 6, 24, 3, 3), random(3, 6, 24, 3, seed=1), 0.02)),
        "as_large": (
            as_large, (random(2, 3, 4), random(10, seed=1), random(10, seed=2), random(24, 3), rows, PARENT_TABLE),
        ),
    }  # fmt: skip


@pytest.mark.parametrize("name", operators())
def test_an_operator_is_well_formed(name: str) -> None:
    operator, arguments = operators()[name]
    moving = {"motion_size": 2, "boundary": 2, "as_large": 2}.get(name, 1)
    leaves = [one.requires_grad_() for one in arguments[:moving]]
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(operator.registered, arguments, test_utils=checks)

    def value(*leaves: torch.Tensor) -> torch.Tensor:
        result = operator(*leaves, *arguments[moving:])
        return result[0] if isinstance(result, tuple) else result

    assert torch.autograd.gradcheck(value, leaves, fast_mode=True)


def test_coefficients_of_zero_cost_nothing() -> None:
    still = torch.zeros(1, 3, 24, 4), torch.zeros(1, 3, 4)
    assert all(not one.any() for one in motion_size(*still, 1e-6))
