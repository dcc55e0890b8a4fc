"""The bank's poses are human: within the joints' ranges, different from each other, mirrored exactly."""

import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES, MIRROR
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.pose_bank import BANK, bank_rotations
from hfb.priors.anatomy import AnatomicalPrior


def _joints(poses: torch.Tensor) -> torch.Tensor:
    shaped = load_default_body(torch.float64).shape(torch.zeros(10, dtype=torch.float64))
    full = torch.cat([torch.zeros(len(poses), 1, 3, dtype=torch.float64), poses], 1)
    return shaped.joints_of(axis_angle_to_matrix(full), torch.zeros(len(poses), 3, dtype=torch.float64))


def test_poses_are_within_human_ranges() -> None:
    names, poses = bank_rotations(torch.float64)
    penalty = AnatomicalPrior().limit_penalty(poses)
    worst = {name: float(cost) for name, cost in zip(names, penalty, strict=True) if cost > 8}
    assert not worst


def test_names_are_unique_and_poses_differ() -> None:
    names, poses = bank_rotations(torch.float64)
    assert len(set(names)) == len(names) > len(BANK)
    joints = _joints(poses)
    apart = torch.cdist(joints.flatten(1), joints.flatten(1)) + 10 * torch.eye(len(names))
    assert float(apart.min()) > 0.1


def test_mirrored_poses_are_mirror_images() -> None:
    names, poses = bank_rotations(torch.float64)
    rotations = axis_angle_to_matrix(poses)
    reflect = torch.diag(torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64))
    swap = [joint - 1 for joint in MIRROR[1:]]
    pairs = [k for k, name in enumerate(names) if name.endswith(", mirrored")]
    assert pairs
    for k in pairs:
        assert torch.allclose(rotations[k], reflect @ rotations[k - 1][swap] @ reflect, atol=1e-9)


def test_limbs_point_where_the_words_say() -> None:
    names, poses = bank_rotations(torch.float64)
    joints = _joints(poses)
    at = {name: index for index, name in enumerate(JOINT_NAMES)}

    def direction(pose: str, start: str, end: str) -> torch.Tensor:
        bone = joints[names.index(pose), at[end]] - joints[names.index(pose), at[start]]
        return bone / bone.norm()

    assert direction("standing", "left_shoulder", "left_wrist")[1] < -0.8
    assert direction("arms up", "right_shoulder", "right_elbow")[1] > 0.9
    assert direction("arms forward", "left_shoulder", "left_elbow")[2] > 0.9
    assert direction("stride", "left_hip", "left_knee")[2] > 0.35
    assert direction("stride", "right_hip", "right_knee")[2] < -0.2
    assert direction("stride", "left_shoulder", "left_elbow")[2] < -0.3
    assert direction("crouch", "left_knee", "left_ankle")[2] < 0
    assert direction("boxing", "left_elbow", "left_wrist")[2] > 0
