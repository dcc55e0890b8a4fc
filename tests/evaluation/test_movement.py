"""Laws of the figures about pixels, depth, front and motion, on bodies that are made to break one at a time."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES, MIRROR
from hfb.evaluation.baselines.rows import motion_of_rows
from hfb.evaluation.movement import MovementErrors, at_instants, movement_errors
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.fronts import mirrored_in_depth
from hfb.motion.static_pose import FirstBody
from hfb.rendering.observation import Observation

CAMERA = PinholeCamera.from_focal(500.0, 400, 300)
LIMBS = [
    JOINT_NAMES.index(f"{side}_{part}")
    for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
    for side in ("left", "right")
]
ROWS = 5


def body_joints(pose: np.ndarray) -> np.ndarray:
    """The joints [m] of a body 3 m before the camera, one row per pose; facing it with a root of (pi, 0, 0)."""
    body = load_default_body()
    poses = torch.from_numpy(np.atleast_3d(pose).reshape(-1, 24, 3)).float()
    picture = torch.zeros(1, 400, 300, 3)
    seen = Observation(picture, picture[0], picture[..., 0], CAMERA, 0.1, 0.1)
    places = torch.tensor([0.0, 0.2, 3.0]).expand(len(poses), 3)
    return motion_of_rows(poses, places, torch.zeros(10), seen, body).joints


def upright(turn_deg: float = 0.0) -> np.ndarray:
    """A pose turned about the vertical."""
    pose = np.zeros((24, 3))
    half = np.deg2rad(turn_deg) / 2
    pose[0] = np.pi * np.array([np.cos(half), 0.0, np.sin(half)])  # a half turn about an axis across the vertical
    pose[16, 2], pose[17, 2] = -1.0, 1.1  # the arms hang, not quite alike
    pose[4, 0] = 0.4
    return pose


def walk(frames: int = 1) -> np.ndarray:
    """Somebody who walks and swings the arms, ROWS instants per frame: (R, 24, 3) m."""
    poses = np.stack([upright() for _ in range(frames * ROWS)])
    poses[:, 18, 1] += np.linspace(0, 0.9, frames * ROWS)
    return body_joints(poses) + np.linspace(0, 0.4, frames * ROWS)[:, None, None] * np.array([1.0, 0, 0.5])


def compare(claimed: np.ndarray, true: np.ndarray, frames: int = 1, known: list[int] = LIMBS) -> MovementErrors:
    index = np.repeat(np.arange(frames), len(true) // frames)
    return movement_errors(claimed[:, known], true[:, known], known, index, CAMERA)


def test_the_truth_itself_has_no_error() -> None:
    true = walk(2)
    errors = compare(true, true, 2)
    assert errors.still_motion_mm > 50
    assert errors.path_mm == errors.true_path_mm > 5
    rest = [errors.in_plane_px, errors.ray_depth_mm, errors.lean_deg, errors.front_wrong, errors.spin_deg]
    assert rest == pytest.approx([0] * 5, abs=1e-9)
    assert errors.motion_mm == errors.better_motion_mm == pytest.approx(0, abs=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_a_still_body_has_the_truths_own_motion_as_its_error(seed: int, frames: int) -> None:
    """Wherever it stands and whatever its pose: the ratio of the two is 1, and its path has no length."""
    rng = np.random.default_rng(seed)
    true = rng.normal(0, 0.3, (frames * ROWS, 24, 3)) + (0, 0, 3)
    still = np.repeat(rng.normal(0, 0.3, (frames, 24, 3)) + (0, 0, 3), ROWS, 0)
    errors = compare(still, true, frames)
    assert errors.motion_mm == pytest.approx(errors.still_motion_mm)
    assert errors.better_motion_mm == pytest.approx(errors.still_motion_mm)
    assert errors.path_mm == pytest.approx(0, abs=1e-9)


def test_a_place_that_is_wrong_all_along_is_no_motion_error() -> None:
    true = walk()
    errors = compare(true + (0.1, 0, 0.3), true)
    assert errors.motion_mm == pytest.approx(0, abs=1e-9)
    assert errors.path_mm == pytest.approx(errors.true_path_mm)
    assert errors.ray_depth_mm == pytest.approx(0, abs=1e-9)  # the roots are in one place
    assert errors.in_plane_px > 5


def test_motion_told_backwards_is_twice_wrong_and_right_the_other_way() -> None:
    true = walk()
    errors = compare(true[::-1], true)
    assert errors.motion_mm == pytest.approx(2 * errors.still_motion_mm, rel=0.02)
    assert errors.better_motion_mm == pytest.approx(0, abs=1e-9)
    assert errors.path_mm == pytest.approx(errors.true_path_mm)


def test_half_the_motion_is_half_the_error_and_half_the_path() -> None:
    true = walk()
    errors = compare(true.mean(0) + (true - true.mean(0)) / 2, true)
    assert errors.motion_mm == pytest.approx(errors.still_motion_mm / 2)
    assert errors.path_mm == pytest.approx(errors.true_path_mm / 2)


@pytest.mark.parametrize(("turn_deg", "wrong"), [(0, 1), (35, 1), (-150, 1), (180, 1), (60, 0), (-120, 0)])
def test_the_mirrored_body_faces_the_wrong_way_but_near_profile(turn_deg: float, wrong: float) -> None:
    """Near profile the mirror image faces nearly the same way: what is wrong there are the limbs' depths."""
    pose = upright(turn_deg)
    first = FirstBody(torch.from_numpy(pose).float(), torch.zeros(3), torch.zeros(10), "test")
    mirrored = mirrored_in_depth(first).pose.double().numpy()
    true, other = (body_joints(np.stack([one] * ROWS)) for one in (pose, mirrored))
    assert compare(other, true).front_wrong == wrong
    assert compare(other[:, list(MIRROR)], true).in_plane_px < 12  # the outline is the same: other limbs, same places
    assert np.isnan(compare(other, true).spin_deg)  # of one frame there is none


@pytest.mark.parametrize(("turn_deg", "wrong"), [(0, 0), (80, 0), (-80, 0), (100, 1), (-100, 1), (180, 1)])
def test_front_and_spin_are_turns_about_the_vertical(turn_deg: float, wrong: float) -> None:
    true = np.concatenate([body_joints(np.stack([upright(30)] * ROWS))] * 2)
    turned = body_joints(np.stack([upright(30 + turn_deg)] * ROWS))
    assert compare(turned, true[:ROWS]).front_wrong == wrong
    pair = compare(np.concatenate([true[:ROWS], turned]), true, 2)
    assert pair.front_wrong == wrong / 2
    assert pair.spin_deg == pytest.approx(abs(turn_deg), abs=0.5)


def test_a_spin_that_the_truth_makes_too_is_none() -> None:
    both = np.concatenate([body_joints(np.stack([upright(turn)] * ROWS)) for turn in (-60, 90)])
    assert compare(both, both, 2).spin_deg == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("lean_deg", [0, 7, -15, 40])
def test_lean_is_the_angle_towards_the_camera(lean_deg: float) -> None:
    """Bent at the hips' height as a whole: nothing else of the trunk changes, and depth shows it too."""
    true = body_joints(np.stack([upright()] * ROWS))
    angle, pelvis = np.deg2rad(lean_deg), true[:, :1]
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    errors = compare((true - pelvis) @ turn.T + pelvis, true)
    assert errors.lean_deg == pytest.approx(abs(lean_deg))
    assert (errors.ray_depth_mm > 20) == (lean_deg != 0)
    assert errors.front_wrong == 0


def test_of_somebody_who_lies_across_the_view_no_lean_is_told() -> None:
    true = body_joints(np.stack([upright()] * ROWS))
    across = true[..., [1, 0, 2]]
    assert np.isnan(compare(true, across).lean_deg)


def test_depth_errors_lie_along_the_ray() -> None:
    true = body_joints(np.stack([upright()] * ROWS))
    claimed = true.copy()
    wrist = JOINT_NAMES.index("left_wrist")
    claimed[:, wrist] *= 1.1  # farther away on its own ray: the picture does not show it
    errors = compare(claimed, true)
    assert errors.in_plane_px == pytest.approx(0, abs=1e-9)
    away = 100 * np.linalg.norm(true[0, wrist])
    assert errors.ray_depth_mm == pytest.approx(away / len(LIMBS), rel=1e-6)


def test_unknown_joints_count_nowhere_and_a_single_instant_is_no_motion() -> None:
    true = walk()
    gaps = true.copy()
    gaps[1, JOINT_NAMES.index("left_knee")] = np.nan
    gaps[:, JOINT_NAMES.index("right_elbow")] = np.nan
    assert compare(true, gaps).motion_mm == pytest.approx(0, abs=1e-9)
    still = np.repeat(true[2:3], ROWS, 0)
    held = compare(still, gaps)
    assert held.motion_mm == pytest.approx(held.still_motion_mm)
    one = compare(true[:1], true[:1])
    assert one.in_plane_px == 0
    assert np.isnan([one.motion_mm, one.still_motion_mm, one.path_mm, one.true_path_mm]).all()
    nothing = compare(true, np.full_like(true, np.nan))
    assert np.isnan(list(vars(replace(nothing)).values())).all()


def test_between_its_own_instants_an_exposure_moves_on_straight_lines() -> None:
    joints = np.arange(2 * 2 * 3, dtype=float).reshape(2, 2, 3)
    found = at_instants(joints, np.array([0.0, 1.0]), np.array([0.0, 0.25, 1.0]))
    np.testing.assert_allclose(found[1], joints[0] + 0.25 * (joints[1] - joints[0]))
    np.testing.assert_array_equal(found[[0, 2]], joints)
