"""Truth files come back as they were written, say which kind they are, and refuse what is neither."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from hfb.body.assets import load_default_body
from hfb.datasets.truth import (
    JointTruth,
    Truth,
    load_joint_truth,
    load_truth,
    load_truth_of,
    save_joint_truth,
    save_truth,
)
from hfb.errors import InputError
from hfb.motion.motion_file import save_motion, write_arrays
from tests.scenes import moving_scene


@pytest.fixture
def joints() -> JointTruth:
    """Two frames of three instants; a wrist that is lost for one of them."""
    rng = np.random.default_rng(0)
    known = rng.normal(0, 0.5, (6, 4, 3))
    known[3, 2] = np.nan
    return JointTruth(
        known,
        np.array([1, 2, 20, 15]),
        np.linspace(0, 0.1, 6),
        np.repeat([0, 1], 3),
        ("lhip", "rhip", "lwrist", "tête"),
    )


def _arrays(truth: JointTruth) -> dict[str, np.ndarray]:
    return {field.name: np.array(getattr(truth, field.name)) for field in fields(truth)}


def test_known_joints_come_back_with_their_gaps(joints: JointTruth, tmp_path: Path) -> None:
    path = tmp_path / "truth.npz"
    save_joint_truth(path, joints)
    for again in (load_joint_truth(path), load_truth_of(path)):
        assert isinstance(again, JointTruth)
        np.testing.assert_array_equal(again.joints, joints.joints)  # NaN equals NaN here
        np.testing.assert_array_equal(again.smpl_joints, joints.smpl_joints)
        np.testing.assert_array_equal(again.times_s, joints.times_s)
        np.testing.assert_array_equal(again.frame_index, joints.frame_index)
        assert again.names == joints.names


def test_the_whole_truth_comes_back_through_either_door(tmp_path: Path) -> None:
    truth = moving_scene(load_default_body(), size_px=36, instants=8).truth
    path = tmp_path / "truth.npz"
    save_truth(path, truth)
    for again in (load_truth(path), load_truth_of(path)):
        assert isinstance(again, Truth)
        np.testing.assert_array_equal(again.silhouettes, truth.silhouettes)
        np.testing.assert_array_equal(again.motion.joints, truth.motion.joints)
        assert again.betas_space == "hfb"


@pytest.mark.parametrize(
    ("member", "value"),
    [
        ("joints", np.zeros((6, 4, 2))),
        ("joints", np.zeros((6, 3, 3))),
        ("joints", np.zeros((5, 4, 3))),
        ("smpl_joints", np.array([1, 2, 20, 24])),
        ("smpl_joints", np.array([1, 2, 20, 20])),
        ("smpl_joints", np.array([1, 2])),
        ("frame_index", np.zeros(5, int)),
        ("names", np.array(["a"])),
        ("times_s", np.array(["a"] * 6)),
    ],
)
def test_members_that_do_not_fit_are_refused(
    joints: JointTruth, tmp_path: Path, member: str, value: np.ndarray
) -> None:
    path = tmp_path / "truth.npz"
    write_arrays(path, _arrays(joints) | {member: value})
    with pytest.raises(InputError, match="not a truth file"):
        load_truth_of(path)


def test_damaged_missing_and_other_files_are_refused(joints: JointTruth, tmp_path: Path) -> None:
    path = tmp_path / "truth.npz"
    with pytest.raises(InputError, match="no truth file"):
        load_truth_of(path)
    save_joint_truth(path, joints)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="not a truth file"):
        load_truth_of(path)
    with pytest.raises(InputError, match="not a truth file"):
        load_joint_truth(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match="not a truth file"):
        load_truth_of(path)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))  # an array alone, no archive
    with pytest.raises(InputError, match="not a truth file"):
        load_truth_of(path)
    save_motion(path, moving_scene(load_default_body(), size_px=36, instants=8).truth.motion, "hfb")
    with pytest.raises(InputError, match="no true silhouettes"):
        load_truth_of(path)


def test_a_pickle_inside_is_not_run(joints: JointTruth, tmp_path: Path) -> None:
    path = tmp_path / "truth.npz"
    np.savez(path, **_arrays(replace(joints, names=())) | {"names": np.array([object()] * 4)})
    with pytest.raises(InputError, match="not a truth file"):
        load_truth_of(path)
