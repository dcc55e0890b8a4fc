"""Bodies laid onto meshes and joints: the bars are those of noise, not of luck."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import PosedBody
from hfb.body.skeleton import H36M_14, JOINT_NAMES
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.keypoint_registration import register_keypoints
from hfb.initialization.limb_angles import kabsch, rotations_from_joints
from hfb.initialization.point_registration import Registered, register_joints, register_vertices
from hfb.initialization.pose_bank import bank_rotations
from hfb.priors.anatomy import AnatomicalPrior
from hfb.typing import Tensor
from tests.angles import angle_between

BODY = load_default_body()
COCO = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True)
class Person:
    betas: Tensor
    rotations: Tensor
    posed: PosedBody

    def noisy(self, what: str, sigma_m: float) -> np.ndarray:
        points = getattr(self.posed, what)
        noise = torch.randn(points.shape, generator=torch.Generator().manual_seed(5))
        return (points + sigma_m * noise).double().numpy()

    def errors_mm(self, found: Registered) -> Tensor:
        joints = BODY.shape(found.betas).joints_of(axis_angle_to_matrix(found.poses), found.translations)
        return 1000 * (joints - self.posed.joints).norm(dim=-1)


def person(count: int, seed: int = 0) -> Person:
    """Disturbed poses of the bank, turned to the camera, some metres away."""
    generator = torch.Generator().manual_seed(seed)
    _, bank = bank_rotations()
    chosen = torch.arange(count) % len(bank)
    limbs = axis_angle_to_matrix(bank[chosen].float() + 0.15 * torch.randn(count, 23, 3, generator=generator))
    roots = torch.tensor([np.pi, 0, 0]) + 0.5 * torch.randn(count, 3, generator=generator)
    rotations = torch.cat([axis_angle_to_matrix(roots.float())[:, None], limbs], 1)
    betas = torch.randn(10, generator=generator)
    places = torch.tensor([0.2, 0.1, 4.0]) + torch.randn(count, 3, generator=generator)
    return Person(betas, rotations, BODY.shape(betas).pose(rotations, places))


def test_kabsch_finds_a_turn_and_invents_no_twist() -> None:
    rest = torch.randn(1, 5, 3, generator=torch.Generator().manual_seed(0))
    turn = axis_angle_to_matrix(torch.tensor([[0.3, -2.0, 0.7]]))
    found = kabsch(rest, rest @ turn.transpose(1, 2), torch.ones(1, 5))
    assert float(angle_between(found, turn)) < 1e-3
    alone = kabsch(torch.tensor([[[1.0, 0, 0]]]), torch.tensor([[[0.0, 2.0, 0]]]), torch.ones(1, 1))
    quarter = axis_angle_to_matrix(torch.tensor([[0, 0, np.pi / 2]]).float())
    assert float(angle_between(alone, quarter)) < 1e-3


def test_exact_joints_give_exact_bones() -> None:
    """With the person's own bone lengths the closed form alone puts every joint where it is."""
    true = person(8)
    rest = BODY.rest_joints(true.betas)
    found = rotations_from_joints(true.posed.joints, rest, torch.eye(3).expand(24, 3, 3))
    joints = BODY.shape(true.betas).joints_of(found, torch.zeros(8, 3))
    moved = joints + (true.posed.joints - joints)[:, :1]
    assert float((moved - true.posed.joints).norm(dim=-1).mean()) < 0.01


def test_a_bent_elbow_tells_the_twist_of_the_upper_arm() -> None:
    pose = torch.zeros(1, 24, 3)
    elbow, shoulder = JOINT_NAMES.index("left_elbow"), JOINT_NAMES.index("left_shoulder")
    pose[0, elbow] = torch.tensor([0, -1.2, 0])
    pose[0, shoulder] = torch.tensor([0.9, 0, 0])  # about the arm itself
    true = axis_angle_to_matrix(pose)
    joints = BODY.shape(torch.zeros(10)).joints_of(true, torch.zeros(1, 3))
    found = rotations_from_joints(joints, BODY.rest_joints(torch.zeros(10)), torch.eye(3).expand(24, 3, 3))
    assert float(angle_between(found[0, shoulder], true[0, shoulder])) < 0.15


def test_joints_with_ten_millimetres_of_noise() -> None:
    true = person(12)
    found = register_joints(true.noisy("joints", 0.010), BODY)
    assert float(true.errors_mm(found).mean()) < 15
    assert float(AnatomicalPrior()(found.poses[:, 1:]).mean()) < 60  # still people
    again = register_joints(true.noisy("joints", 0.010), BODY)
    assert torch.equal(found.poses, again.poses)


def test_vertices_with_five_millimetres_of_noise() -> None:
    """The embedded body's own mesh stands in for SMPL's 6890 vertices, which need its licensed file."""
    true = person(8, seed=1)
    found = register_vertices(true.noisy("vertices", 0.005), BODY)
    assert float(true.errors_mm(found).mean()) < 8
    held = register_vertices(true.noisy("vertices", 0.005)[:3], BODY, betas=true.betas)
    assert torch.equal(held.betas, true.betas)
    assert float(held.residual_m.max()) < 0.012


def test_fourteen_joints_are_met_where_they_are_known() -> None:
    true = person(6, seed=2)
    joints = np.full((6, 24, 3), np.nan)
    known = list(H36M_14)
    joints[:, known] = true.noisy("joints", 0.005)[:, known]
    found = register_joints(joints, BODY)
    assert float(true.errors_mm(found)[:, known].mean()) < 25
    assert float(found.residual_m.mean()) < 0.02


def test_what_cannot_be_registered_is_said() -> None:
    with pytest.raises(InputError, match=r"6890 vertices .* give the SMPL file"):
        register_vertices(np.zeros((1, 6890, 3)), BODY)
    with pytest.raises(InputError, match="not finite"):
        register_vertices(np.full((1, len(BODY.template), 3), np.nan), BODY)
    few = np.full((1, 24, 3), np.nan)
    few[0, :3] = 0.1
    with pytest.raises(InputError, match="fewer than 6 joints"):
        register_joints(few, BODY)


def test_angles_are_those_of_the_start_s_frame() -> None:
    """A turn of everything turns the root alone."""
    true = person(2, seed=4)
    turn = axis_angle_to_matrix(torch.tensor([0.2, 0.4, -0.1]))
    one = register_joints(true.posed.joints.double().numpy(), BODY, true.betas)
    other = register_joints((true.posed.joints @ turn.T).double().numpy(), BODY, true.betas)
    turned = matrix_to_axis_angle(turn @ axis_angle_to_matrix(one.poses[:, 0]))
    assert float(angle_between(axis_angle_to_matrix(turned), axis_angle_to_matrix(other.poses[:, 0])).max()) < 0.05


def test_keypoints_of_a_picture() -> None:
    """Depth is open: what the picture shows is met, and most people stand about as they do."""
    someone, camera = person(24), PinholeCamera.from_focal(900.0, 720, 1280)
    shown = camera.project(someone.posed.joints).numpy()
    seen = np.full_like(shown, np.nan)
    coco = [JOINT_NAMES.index(f"{side}_{name}") for name in COCO for side in ("left", "right")]
    seen[:, coco] = (shown + np.random.default_rng(0).normal(0, 3, shown.shape))[:, coco]
    found = register_keypoints(seen, camera, BODY)
    joints = BODY.shape(found.betas).joints_of(axis_angle_to_matrix(found.poses), found.translations)
    apart = np.linalg.norm(camera.project(joints).numpy() - shown, axis=-1)[:, coco].mean(1)
    assert np.median(apart / np.ptp(shown, axis=1).max(-1)) < 0.012
    true = someone.posed.joints
    off_mm = 1000 * ((joints - joints[:, :1]) - (true - true[:, :1])).norm(dim=-1).mean(1)
    assert float(off_mm.median()) < 140  # 116 over forty; the mean pose upright and facing the camera has 280
    facing = angle_between(axis_angle_to_matrix(found.poses[:, 0]), someone.rotations[:, 0]).rad2deg()
    assert float(facing.quantile(0.8)) < 45


def test_one_wrong_keypoint_drags_nobody_along() -> None:
    someone, camera = person(6), PinholeCamera.from_focal(900.0, 720, 1280)
    shown = camera.project(someone.posed.joints).numpy()
    wrong = shown.copy()
    wrong[:, JOINT_NAMES.index("left_wrist")] += 400
    found = register_keypoints(wrong, camera, BODY)
    joints = BODY.shape(found.betas).joints_of(axis_angle_to_matrix(found.poses), found.translations)
    trunk = [JOINT_NAMES.index(name) for name in ("pelvis", "neck", "left_hip", "right_shoulder")]
    apart = np.linalg.norm(camera.project(joints).numpy() - shown, axis=-1)[:, trunk].mean(1)
    assert (apart / np.ptp(shown, axis=1).max(-1) < 0.05).all()


def test_too_few_keypoints_are_a_sentence() -> None:
    seen = np.full((2, 24, 2), np.nan)
    seen[:, :5] = 10
    with pytest.raises(InputError, match="fewer than 6 keypoints"):
        register_keypoints(seen, PinholeCamera.from_focal(900.0, 720, 1280), BODY)
