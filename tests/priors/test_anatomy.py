"""The anatomical prior: real poses pass, impossible ones do not, and left and right are the same."""

from math import pi, radians

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES, MIRROR
from hfb.datasets.motions.files.bvh import read_bvh
from hfb.datasets.motions.skeletons.retargeting import retarget
from hfb.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quaternion,
    multiply_quaternions,
    quaternion_to_axis_angle,
)
from hfb.kernels.dispatch import readable_formulas
from hfb.priors.anatomy import AnatomicalPrior, twist_swing
from hfb.priors.pose import PosePrior
from tests.shared import SHARED_DATA

PRIOR = AnatomicalPrior()
_MOCAP = SHARED_DATA / "cmu_bvh"


def _pose(**degrees: tuple[float, float, float]) -> torch.Tensor:
    """A pose at rest but for the named joints."""
    pose = torch.zeros(1, 23, 3, dtype=torch.float64)
    for name, angles in degrees.items():
        pose[0, JOINT_NAMES.index(name) - 1] = torch.tensor([radians(angle) for angle in angles])
    return pose


def _joints(pose: torch.Tensor) -> dict[str, torch.Tensor]:
    """Where the default body's joints are, relative to the pelvis (x to its left, y up, z forward)."""
    shaped = load_default_body(torch.float64).shape(torch.zeros(10, dtype=torch.float64))
    rotations = axis_angle_to_matrix(torch.cat([torch.zeros(1, 1, 3, dtype=torch.float64), pose], 1))
    joints = shaped.joints_of(rotations, torch.zeros(1, 3, dtype=torch.float64))[0]
    return dict(zip(JOINT_NAMES, joints - joints[0], strict=True))


# Each motion goes well within its range one way, far beyond it the other: the signs of the table, seen on the body.
_MOTIONS = [
    ("left_knee", (90, 0, 0), "left_ankle", 2, -0.2),  # the shin goes back
    ("right_knee", (90, 0, 0), "right_ankle", 2, -0.2),
    ("left_hip", (-100, 0, 0), "left_knee", 2, 0.2),  # the thigh comes forward
    ("right_hip", (-100, 0, 0), "right_knee", 2, 0.2),
    ("left_elbow", (0, -100, 0), "left_wrist", 2, 0.1),  # the hand comes forward
    ("right_elbow", (0, 100, 0), "right_wrist", 2, 0.1),
    ("left_ankle", (50, 0, 0), "left_foot", 1, -0.02),  # the toes go down
    ("left_collar", (0, 0, 35), "left_shoulder", 1, 0.02),  # the shoulder goes up
    ("right_collar", (0, 0, -35), "right_shoulder", 1, 0.02),
    ("left_shoulder", (0, -130, 0), "left_elbow", 2, 0.1),  # the arm comes across the chest
    ("right_shoulder", (0, 130, 0), "right_elbow", 2, 0.1),
    ("left_hip", (0, 0, 50), "left_knee", 0, 0.2),  # the leg goes out
    ("right_hip", (0, 0, -50), "right_knee", 0, -0.2),
    ("spine1", (40, 0, 0), "neck", 2, 0.1),  # the back bends forward
]


@pytest.mark.parametrize(("joint", "degrees", "moved", "axis", "by"), _MOTIONS)
def test_limits_allow_what_the_body_can_do_and_not_its_opposite(joint, degrees, moved, axis, by):
    possible = _pose(**{joint: degrees})
    shift = (_joints(possible)[moved] - _joints(_pose())[moved])[axis].item()
    assert shift * by > 0
    assert abs(shift) > abs(by)
    assert PRIOR.limit_penalty(possible).item() == 0
    impossible = PRIOR.limit_penalty(-possible).item()
    assert impossible > (3 if abs(sum(degrees)) < 60 else 20)


@pytest.mark.parametrize(
    "impossible",
    [
        _pose(head=(0, 150, 0)),
        _pose(left_knee=(60, 60, 0)),  # a hinge does not turn
        _pose(left_knee=(0, 0, 30)),  # nor open sideways
        _pose(right_elbow=(0, 0, 40)),
        _pose(left_hip=(0, 150, 0)),
        _pose(spine1=(0, 90, 0)),
        _pose(left_shoulder=(150, 0, 0)),
    ],
)
def test_twisted_bodies_cost_more_than_a_whole_ordinary_pose(impossible):
    assert PRIOR.limit_penalty(impossible).item() > 10


def test_real_poses_are_within_the_limits():
    names = ("09_01", "09_12_a", "10_01", "10_05", "13_10_a", "13_11", "13_26_a", "13_30_a", "13_33", "13_37")
    paths = [_MOCAP / f"cmu_{name}.bvh" for name in names]  # runs, kicks, jumps, reaching, squats, a ladder ...
    if not all(path.is_file() for path in paths):
        pytest.skip("the shared motion capture is not here")
    poses = torch.cat([torch.from_numpy(retarget(read_bvh(path))[0][::6, 1:]) for path in paths])
    assert len(poses) > 500
    limits, total = PRIOR.limit_penalty(poses), PRIOR(poses)
    assert (limits < 5).double().mean() >= 0.99
    assert (limits < 0.5).double().mean() >= 0.9
    assert total.median() < 25
    scrambled = poses[:, torch.randperm(23, generator=torch.Generator().manual_seed(0))]
    assert PRIOR(scrambled).median() > 4 * total.median()


def test_compiled_limits_are_the_readable_ones_with_their_gradient():
    poses = torch.randn(40, 23, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    fast, readable = (poses.clone().requires_grad_() for _ in range(2))
    PRIOR.limit_penalty(fast).sum().backward()
    with readable_formulas():
        expected = PRIOR.limit_penalty(readable)
    expected.sum().backward()
    torch.testing.assert_close(PRIOR.limit_penalty(fast), expected)
    torch.testing.assert_close(fast.grad, readable.grad)


def test_a_mirrored_pose_is_as_likely():
    poses = torch.randn(20, 23, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    mirrored = poses[:, [MIRROR[joint] - 1 for joint in range(1, 24)]] * torch.tensor([1.0, -1.0, -1.0])
    torch.testing.assert_close(PRIOR(mirrored), PRIOR(poses))


def test_hanging_arms_are_likelier_than_a_t_pose_and_than_raised_ones():
    hanging = _pose(left_shoulder=(0, 0, -65), right_shoulder=(0, 0, 65))
    raised = _pose(left_shoulder=(0, 0, 80), right_shoulder=(0, 0, -80))
    assert PRIOR(hanging) < PRIOR(_pose()) < PRIOR(raised)
    assert isinstance(PRIOR, PosePrior)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_finite_gradients_at_rest_at_pi_and_everywhere(dtype):
    generator = torch.Generator().manual_seed(2)
    poses = torch.randn(6, 23, 3, dtype=dtype, generator=generator)
    poses = torch.cat([poses, torch.zeros(1, 23, 3, dtype=dtype), 1e-7 * poses[:1]])
    half_turns = pi * torch.eye(3, dtype=dtype)[:, None].expand(3, 23, 3)
    poses = torch.cat([poses, half_turns]).requires_grad_()
    value = PRIOR(poses)
    value.sum().backward()
    assert torch.isfinite(value).all()
    assert (value >= 0).all()
    assert torch.isfinite(poses.grad).all()


def test_gradients_match_finite_differences():
    poses = 0.7 * torch.randn(2, 23, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    poses[0, :4] = 0
    poses[0, 4:8] *= 1e-7
    assert torch.autograd.gradcheck(PRIOR, (poses.requires_grad_(),))


@pytest.mark.parametrize("first", [0, 1, 2])
def test_twist_then_swing_give_the_rotation_back(first):
    generator = torch.Generator().manual_seed(4)
    rotations = torch.randn(50, 1, 3, dtype=torch.float64, generator=generator)
    order = torch.tensor([[first, (first + 1) % 3, (first + 2) % 3]])
    parts = twist_swing(rotations, order)
    twist, swing = torch.zeros_like(rotations), torch.zeros_like(rotations)
    twist[..., order[0, 0]] = parts[..., 0]
    swing[..., order[0, 1:]] = parts[..., 1:]
    whole = multiply_quaternions(axis_angle_to_quaternion(swing), axis_angle_to_quaternion(twist))
    torch.testing.assert_close(
        quaternion_to_axis_angle(whole), quaternion_to_axis_angle(axis_angle_to_quaternion(rotations))
    )
