"""A rolling shutter: each row of an image is exposed at a time of its own."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.fitting.fit import fit
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.static_pose import FirstBody
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose, see_by_rows
from hfb.rendering.observation import Observation
from tests.recovery.test_fit import small
from tests.scenes import standing_pose

To = Literal["down", "up", "left", "right"]
SIZE_PX, STEP_M, READOUT = 96, 0.3, 0.5
"""The body moves by a fifth of the image while the shutter is open, and half as far while the image is read."""


def motion(u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return poses and translations [m]: a step to +x while both arms rise."""
    poses = standing_pose().expand(len(u), 24, 3).clone()
    poses[:, 16, 2] += 0.5 * u
    poses[:, 17, 2] -= 0.5 * u
    return poses, torch.tensor([0.0, 0.1, 3.4]) + torch.stack([STEP_M * (u - 0.5), 0 * u, 0 * u], -1)


def camera() -> PinholeCamera:
    return PinholeCamera.from_focal(1.4 * SIZE_PX, SIZE_PX, SIZE_PX)


def by_rows(to: To, instants: int = 40) -> Observation:
    """Return the exact image: every row the mean of the instants in its own exposure, from drawings of each instant."""
    body, margin = load_default_body(), round(READOUT * instants / 2)
    u = (torch.arange(-margin, instants + margin) + 0.5) / instants
    poses, translations = motion(u)
    generator = torch.Generator().manual_seed(0)
    plate = 0.3 + 0.4 * torch.rand(SIZE_PX, SIZE_PX, 3, generator=generator)
    vertices = body.shape(torch.zeros(10)).pose(axis_angle_to_matrix(poses), translations).vertices
    drawn = make_rasterizer("coverage", "cpu", 1).render(vertices, texture(), camera(), body.mesh)
    lines = drawn.movedim(2 if to in ("left", "right") else 1, 0)  # along the readout, then the instants
    lines = lines.flip(0) if to in ("up", "left") else lines
    late = READOUT * ((torch.arange(SIZE_PX) + 0.5) / SIZE_PX - 0.5)
    means = torch.stack([line[(u > at) & (u < at + 1)].mean(0) for line, at in zip(lines, late, strict=True)])
    means = means.flip(0) if to in ("up", "left") else means
    mean = means.movedim(0, 1) if to in ("left", "right") else means
    return Observation(compose(mean, plate)[None], plate, mean[..., 3][None], camera(), 0.03, 0.03)


def texture() -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(8, 8, 3, generator=generator).repeat_interleave(8, 0).repeat_interleave(8, 1)


@pytest.mark.parametrize("to", ["down", "up", "left", "right"])
def test_the_image_is_that_of_rows_exposed_one_after_another(to: To) -> None:
    body, seen = load_default_body(), by_rows(to)
    poses, translations = motion(torch.linspace(0, 1, 81))
    vertices = body.shape(torch.zeros(10)).pose(axis_angle_to_matrix(poses), translations).vertices
    rolling = camera().with_readout(READOUT, to)
    rasterizer = make_rasterizer("coverage", "cpu", 1)

    def error(places: torch.Tensor) -> float:
        alpha = rasterizer.silhouette_mean(places, camera(), body.mesh)
        return float((alpha - seen.mattes[0]).abs().sum())

    assert error(see_by_rows(vertices, rolling)) < 0.25 * error(vertices)


def test_a_crop_and_another_size_see_the_same_rows() -> None:
    vertices = torch.rand(5, 30, 3, generator=torch.Generator().manual_seed(2)) + torch.tensor([-0.5, -0.5, 3.0])
    whole = camera().with_readout(READOUT, "down")
    for other in (whole.crop(13, -7, 40, 50), whole.resize(24, 48), whole.crop(5, 5, 30, 30).resize(60, 60)):
        assert torch.equal(see_by_rows(vertices, other), see_by_rows(vertices, whole))


def test_without_a_readout_nothing_moves() -> None:
    vertices = torch.rand(5, 30, 3) + torch.tensor([0.0, 0.0, 3.0])
    assert see_by_rows(vertices, camera()) is vertices
    assert camera().with_readout(0.0, "down") == camera()
    rolling = camera().with_readout(READOUT, "down")
    still = vertices[:1].expand(5, 30, 3)
    torch.testing.assert_close(see_by_rows(still, rolling), still)


def test_the_first_row_is_early_and_the_last_late() -> None:
    u = torch.linspace(0, 1, 5)[:, None, None]
    rows = torch.tensor([-0.5, 0.0, 0.5]) / 1.4 * 4  # top, middle and bottom of the image at 4 m
    places = torch.stack([torch.zeros(3), rows, torch.full((3,), 4.0)], -1)
    moving = places + u * torch.tensor([0.8, 0.0, 0.0])
    seen = see_by_rows(moving, camera().with_readout(READOUT, "down"))
    torch.testing.assert_close(seen - moving, torch.tensor([-0.2, 0.0, 0.2])[:, None] * torch.eye(3)[0].expand(5, 3, 3))


def test_the_derivative_is_the_formulas() -> None:
    generator = torch.Generator().manual_seed(3)
    vertices = torch.rand(2, 4, 6, 3, generator=generator, dtype=torch.float64) + torch.tensor([-0.5, -0.5, 3.0])
    rolling = camera().with_readout(READOUT, "left")
    assert torch.autograd.gradcheck(lambda one: see_by_rows(one, rolling), vertices.requires_grad_())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_fit_that_knows_the_readout_finds_the_body_upright(seed: int) -> None:
    """One frame does not tell the direction: whichever was fitted first, the lean is the rows', not the body's."""
    seen, body = by_rows("down"), load_default_body()
    poses, translations = motion(torch.tensor([0.5]))
    start = FirstBody(poses[0], translations[0], torch.zeros(10), "truth")
    joints = body.shape(torch.zeros(10)).joints_of(axis_angle_to_matrix(poses), translations)[0].double().numpy()
    known = replace(seen, camera=seen.camera.with_readout(READOUT, "down"))

    def error_mm(one: Observation) -> float:
        found = fit(one, [start], body, small(), seed, AnatomicalPrior()).motion.joints
        return 1000 * float(np.linalg.norm((found.mean(0) - joints)[:, :2], axis=-1).mean())  # across the view

    assert error_mm(known) < 0.65 * error_mm(seen)
