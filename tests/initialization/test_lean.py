"""The lean of a first body in depth: lessened by a fifth, for bodies that stand."""

import math

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.lean import lean_rad, less_lean
from hfb.motion.static_pose import FirstBody

BODY = load_default_body()


def standing(about_x_deg: float, about_y_deg: float = 0.0, about_z_deg: float = 0.0) -> FirstBody:
    """Upright before the camera (y down), turned about the camera's axes, the vertical first."""
    turns = [torch.zeros(3).index_fill(0, torch.tensor(axis), math.radians(deg)) for axis, deg in (
        (2, about_z_deg), (0, about_x_deg + 180), (1, about_y_deg),
    )]  # fmt: skip
    R_x, R_y, R_z = axis_angle_to_matrix(torch.stack([turns[1], turns[2], turns[0]]))
    pose = torch.zeros(24, 3)
    pose[0] = matrix_to_axis_angle((R_z @ R_x @ R_y)[None])[0]
    return FirstBody(pose, torch.tensor([0.1, 0.2, 3.0]), torch.zeros(BODY.shape_count), "mediapipe")


def posed(first: FirstBody) -> torch.Tensor:
    """Its joints."""
    return BODY.shape(first.betas).joints_of(axis_angle_to_matrix(first.pose)[None], first.translation[None])[0]


def lean_deg(first: FirstBody) -> float:
    return math.degrees(lean_rad(posed(first)))


@pytest.mark.parametrize("facing_deg", [0.0, 60.0, 180.0])
def test_a_lean_is_lessened_by_a_fifth_about_the_root(facing_deg: float) -> None:
    rest = lean_deg(standing(0.0, facing_deg))
    for turn in (-20.0, -8.0, 12.0):
        first = standing(turn, facing_deg)
        before, after = lean_deg(first), lean_deg(less_lean(first, BODY))
        assert abs(abs(before - rest) - abs(turn)) < 0.1
        assert after == pytest.approx(0.8 * before, abs=0.3)
        assert torch.allclose(posed(less_lean(first, BODY))[0], posed(first)[0], atol=1e-5)


def test_who_stands_straight_or_lies_stays() -> None:
    straight = standing(-lean_deg(standing(0.0)))
    for first in (straight, standing(0.0, 90.0, 90.0), standing(-85.0), standing(80.0)):
        moved_mm = 1000 * (posed(less_lean(first, BODY)) - posed(first)).norm(dim=1).max()
        assert moved_mm < 30
