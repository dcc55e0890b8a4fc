"""C in the body's own frame: what must not change it, and what reversing time does to it."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hfb.body.assets import load_default_body
from hfb.body.skeleton import MIRROR
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.trajectory import trajectory_at_rest
from hfb.priors.motion_columns import (
    CLOCK,
    COLUMN_COUNT,
    LIMBS,
    at_instants,
    joint_places,
    motion_columns,
    reversed_columns,
)
from hfb.training.priors.motion_corruption import mirrored_columns
from tests.priors.motions import as_axis_angle_at_rest, backwards, from_origin, moving, seen_by_another_camera

EVERYTHING = torch.ones(1, COLUMN_COUNT, dtype=torch.bool)


@given(st.integers(0, 1000))
def test_no_camera_changes_it(seed: int) -> None:
    motion = moving(seed, dtype=torch.float64)
    elsewhere = seen_by_another_camera(motion, seed)
    assert not torch.allclose(elsewhere.at(torch.tensor([0.3]).double())[1], motion.at(torch.tensor([0.3]).double())[1])
    torch.testing.assert_close(motion_columns(elsewhere), motion_columns(motion), rtol=1e-9, atol=1e-9)


@given(st.integers(0, 1000))
def test_reversed_time_turns_the_odd_coefficients_round(seed: int) -> None:
    motion = moving(seed, frames=2, dtype=torch.float64)
    expected = reversed_columns(motion_columns(motion), EVERYTHING.expand(2, -1))
    torch.testing.assert_close(motion_columns(backwards(motion)), expected, rtol=1e-9, atol=1e-9)


def test_kind_and_origin_of_the_polynomials_do_not_matter() -> None:
    motion = moving(dtype=torch.float64)
    torch.testing.assert_close(motion_columns(from_origin(motion, 0.0)), motion_columns(motion), rtol=1e-9, atol=1e-9)
    still = [motion_columns(as_axis_angle_at_rest(kind)) for kind in ("quaternion", "axis-angle")]
    torch.testing.assert_close(still[1], still[0], rtol=0, atol=1e-5)
    assert still[0][:, 1:].abs().max() < 1e-5


def test_axis_angle_motion_is_the_motion_it_describes() -> None:
    still = as_axis_angle_at_rest("axis-angle")
    rotation, translation = still.rotation.clone(), still.translation.clone()
    rotation[:, 1, :, 3] = 0.4  # every joint turns on about its own axis
    translation[:, 0, :3], translation[:, 1, 3] = torch.tensor([0.0, 0.6, 0.8]), 0.5
    motion = still.with_coefficients(rotation, translation)
    columns = motion_columns(motion)
    relative, path = at_instants(columns, torch.tensor(CLOCK))
    expected, place = motion.at(torch.tensor(CLOCK))
    torch.testing.assert_close(relative[:, :, 1:], expected[:, :, 1:], rtol=0, atol=2e-3)
    assert (path[:, -1] - path[:, 0]).norm() == pytest.approx(float((place[:, -1] - place[:, 0]).norm()), rel=1e-4)


def test_gradients_reach_every_coefficient() -> None:
    motion = moving()
    leaf = motion.rotation.clone().requires_grad_()
    path = motion.translation.clone().requires_grad_()
    columns = motion_columns(replace(motion, rotation=leaf, translation=path))
    (columns * torch.randn(columns.shape, generator=torch.Generator().manual_seed(3))).sum().backward()
    assert torch.isfinite(leaf.grad).all()
    assert (leaf.grad[:, 1:].abs().amax((1, 3)) > 0).all()
    assert (path.grad[:, 1:, :3] != 0).all()


def test_a_still_body_has_finite_gradients() -> None:
    still = trajectory_at_rest(torch.zeros(1, 24, 3), torch.zeros(1, 3), 2, "quaternion", 0.5)
    leaf = still.rotation.clone().requires_grad_()
    motion_columns(replace(still, rotation=leaf)).square().sum().backward()
    assert torch.isfinite(leaf.grad).all()


def test_places_are_the_bodys() -> None:
    shaped = load_default_body(torch.float64).shape(torch.linspace(-1, 1, 10, dtype=torch.float64))
    rotations = axis_angle_to_matrix(torch.randn(4, 24, 3, dtype=torch.float64))
    translations = torch.randn(4, 3, dtype=torch.float64)
    ours = joint_places(shaped.joints, rotations, translations)
    torch.testing.assert_close(ours, shaped.joints_of(rotations, translations))


def test_a_mirror_shows_the_mirrored_motion() -> None:
    columns = motion_columns(moving(dtype=torch.float64))
    torch.testing.assert_close(mirrored_columns(mirrored_columns(columns)), columns)
    u = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)
    rest = load_default_body(torch.float64).joint_template
    symmetric = (rest + rest[list(MIRROR)] * rest.new_tensor([-1, 1, 1])) / 2
    places = [
        joint_places(symmetric, *(one[0] for one in at_instants(c, u))) for c in (columns, mirrored_columns(columns))
    ]
    flipped = places[0][:, list(MIRROR)] * rest.new_tensor([-1, 1, 1])
    flipped = flipped - flipped[1:2, :1] + places[1][1:2, :1]
    torch.testing.assert_close(places[1], flipped, rtol=1e-9, atol=1e-9)


def test_limbs_share_out_the_columns() -> None:
    assert sorted(column for members in LIMBS.values() for column in members) == list(range(COLUMN_COUNT))
