"""From a network's numbers to a body: joint layouts, crops, cameras, and estimates in time."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import H36M_14, JOINT_NAMES
from hfb.errors import InputError
from hfb.evaluation.baselines.estimates import Estimate, interpolate
from hfb.evaluation.baselines.estimators import regress_joints
from hfb.evaluation.baselines.stored_poses import read_estimates
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.joint_layouts import joints_as_24
from hfb.initialization.person_crop import cut_square, person_square, weak_perspective_place
from tests.scenes import moving_scene


def test_fourteen_joints_find_their_places() -> None:
    full = joints_as_24(np.arange(14.0)[:, None].repeat(3, 1))
    at = {name: full[index, 0] for index, name in enumerate(JOINT_NAMES)}
    assert (at["right_ankle"], at["left_hip"], at["right_wrist"], at["left_shoulder"]) == (0, 3, 6, 9)
    assert (at["neck"], at["head"]) == (12, 13)
    assert at["pelvis"] == 2.5  # the middle of the hips, 2 and 3
    assert np.isnan(full[[JOINT_NAMES.index("left_foot"), JOINT_NAMES.index("spine2")]]).all()
    assert np.isfinite(full).all(1).sum() == 15


def test_seventeen_joints_find_their_places() -> None:
    """Human3.6M's order: pelvis, right leg, left leg, torso, neck, nose, head, left arm, right arm."""
    full = joints_as_24(np.arange(17.0)[:, None].repeat(3, 1))
    at = {name: full[index, 0] for index, name in enumerate(JOINT_NAMES)}
    assert [at[name] for name in ("pelvis", "right_hip", "right_knee", "right_ankle", "left_hip")] == [0, 1, 2, 3, 4]
    assert [at[name] for name in ("neck", "head", "left_shoulder", "left_wrist", "right_wrist")] == [8, 10, 11, 13, 16]
    assert set(full[list(H36M_14), 0]) == {3, 2, 1, 4, 5, 6, 16, 15, 14, 11, 12, 13, 8, 10}


def test_other_numbers_of_joints() -> None:
    with pytest.raises(InputError, match="19 joints"):
        joints_as_24(np.zeros((19, 3)))


def test_the_crop_is_about_the_person() -> None:
    matte = np.zeros((40, 60), np.float32)
    matte[10:30, 44:54] = 1
    left, top, side = person_square(matte, margin=1.5)
    assert (left, top, side) == (34, 5, 30)
    picture = matte[..., None].repeat(3, 2)
    crop = cut_square(picture, left, top, side, 15)
    assert crop.shape == (15, 15, 3)
    assert crop.sum() == pytest.approx(3 * matte.sum() / 4)  # half the scale: each pixel the mean of four
    rows, columns = np.nonzero(crop[..., 0])
    assert rows.mean() == pytest.approx(7, abs=0.5)
    assert columns.mean() == pytest.approx(7, abs=0.5)


def test_beyond_the_picture_the_crop_is_black() -> None:
    crop = cut_square(np.ones((20, 20, 3), np.float32), -10, -10, 20, 20)
    assert crop[:10].max() == 0
    assert crop[:, :10].max() == 0
    assert crop[10:, 10:].min() == 1
    assert cut_square(np.ones((20, 20, 3), np.float32), 30, 0, 10, 8).max() == 0


def test_a_weak_perspective_place_appears_where_it_was_seen() -> None:
    camera = PinholeCamera.from_focal(300, 200, 320)
    place = weak_perspective_place(0.8, 0.1, -0.2, (250.0, 60.0), 120.0, camera)
    points = torch.tensor([[0.0, 0, 0], [0.3, -0.5, 0], [-0.2, 0.4, 0]])
    expected = torch.tensor([250.0, 60.0]) + 60 * 0.8 * (points[:, :2] + torch.tensor([0.1, -0.2]))
    assert torch.allclose(camera.project(points + place), expected, atol=1e-3)
    with pytest.raises(InputError, match="scale"):
        weak_perspective_place(0.0, 0, 0, (1.0, 1.0), 10.0, camera)


def test_joints_of_a_mesh_need_the_body_it_belongs_to() -> None:
    body = load_default_body()
    joints = regress_joints(body.template.double().numpy(), body, "net.pt")
    assert np.allclose(joints, body.joint_template.numpy(), atol=1e-5)
    with pytest.raises(InputError, match=r"net\.pt: a mesh of 431 vertices"):
        regress_joints(np.zeros((431, 3)), body, "net.pt")


def test_a_missing_sub_frame_is_bridged() -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), 32)
    start = scene.middle[0]
    turned = [start.pose.clone() for _ in range(3)]
    for index, pose in enumerate(turned):
        pose[18, 1] = 0.4 * index
    whole = [Estimate(pose) for pose in turned]
    times = np.array([0.0, 0.5, 1.0])
    every, _ = interpolate([whole], times, scene.observation, scene.middle, body, 5)
    some, _ = interpolate([[whole[0], None, whole[2]]], times, scene.observation, scene.middle, body, 5)
    ends, _ = interpolate([[None, whole[1], None]], times, scene.observation, scene.middle, body, 5)
    assert every is not None
    assert some is not None
    assert ends is not None
    assert np.allclose(every.joints, some.joints, atol=1e-5)
    assert every.poses[:, 18 * 3 + 1] == pytest.approx([0, 0.2, 0.4, 0.6, 0.8], abs=1e-5)
    assert ends.poses[:, 18 * 3 + 1] == pytest.approx(5 * [0.4], abs=1e-5)
    assert np.allclose(every.trans, start.translation.numpy())


def write(path: Path, **arrays: np.ndarray) -> Path:
    np.savez(path, **arrays)
    return path


def test_stored_poses(tmp_path: Path) -> None:
    body = load_default_body()
    poses = np.random.default_rng(0).normal(0, 0.3, (6, 72))
    poses[4] = np.nan
    first, second = read_estimates(write(tmp_path / "a.npz", poses=poses, trans=np.ones((6, 3))), 2, body)
    assert [one is not None for one in first + second] == [True, True, True, True, False, True]
    assert first[1] is not None
    assert first[1].pose is not None
    assert np.allclose(first[1].pose.numpy().ravel(), poses[1], atol=1e-6)
    assert first[1].translation is not None


def test_stored_joints_and_meshes(tmp_path: Path) -> None:
    body = load_default_body()
    mesh = body.template.numpy()[None] + np.array([[[1.0, 2, 3]]])
    (frame,) = read_estimates(write(tmp_path / "a.npz", vertices=mesh), 1, body)
    assert frame[0] is not None
    assert frame[0].joints is not None
    assert np.allclose(frame[0].joints, body.joint_template.numpy() + [1, 2, 3], atol=1e-4)
    (frame,) = read_estimates(write(tmp_path / "b.npz", joints=np.ones((3, 24, 3))), 1, body)
    assert len(frame) == 3


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"betas": np.zeros((3, 10))}, "no poses"),
        ({"poses": np.zeros((3, 72))}, "3 rows do not divide into 2"),
        ({"poses": np.zeros((2, 156))}, "156 numbers instead of 72"),
        ({"poses": np.zeros((2, 72)), "trans": np.zeros((3, 3))}, "trans"),
        ({"poses": np.full((2, 72), np.nan)}, "no estimate"),
        ({"poses": np.array([[np.nan] + 71 * [0.0]] * 2)}, "partly finite"),
        ({"poses": np.array([["a"], ["b"]])}, "no rows of numbers"),
        ({"poses": np.array([{}, {}], dtype=object)}, "plain arrays"),
    ],
)
def test_stored_poses_that_are_wrong(tmp_path: Path, arrays: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_estimates(write(tmp_path / "case_0001.npz", **arrays), 2, load_default_body())


def test_stored_poses_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there are no poses"):
        read_estimates(tmp_path / "case_0001.npz", 1, load_default_body())
    (tmp_path / "case_0001.npz").write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(InputError, match="cannot be read"):
        read_estimates(tmp_path / "case_0001.npz", 1, load_default_body())
