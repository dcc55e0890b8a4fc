"""Joints of any system: their unit, their names, and what is said of a file that is none."""

import json
import logging
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.interop.readers.sniff import read_tracks
from tests.interop.readers import files
from tests.interop.readers.files import HEIGHT, WIDTH, Person

K = np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]])
JOINTS = Person.some(3).standing + np.array([0.1, 0.2, 4.0])
_14 = [8, 5, 2, 1, 4, 7, 21, 19, 17, 16, 18, 20, 12, 15]


def read_joints(path: Path) -> np.ndarray:
    (track,) = read_tracks([path], HEIGHT, WIDTH)
    assert track.joints is not None
    return track.joints


@pytest.mark.parametrize(("scale", "unit"), [(1.0, None), (100.0, "centimetres"), (1000.0, "millimetres")])
@pytest.mark.parametrize("place", [0.0, 1.0])
def test_the_unit_is_told_by_the_bones(
    tmp_path: Path, scale: float, unit: str | None, place: float, caplog: pytest.LogCaptureFixture
) -> None:
    given = JOINTS - JOINTS[:, :1] + place * JOINTS[:, :1]
    np.savez(tmp_path / "a.npz", joints=given * scale, **({"K": K} if place else {}))
    with caplog.at_level(logging.WARNING):
        np.testing.assert_allclose(read_joints(tmp_path / "a.npz"), given, atol=1e-12)
    assert [record.getMessage() for record in caplog.records if "bones" in record.getMessage()] == (
        [f"the joints are in {unit}, by the lengths of their bones: taken as such"] if unit else []
    )


def test_few_joints_and_gaps_tell_the_unit_too(tmp_path: Path) -> None:
    given = JOINTS[:, _14].copy()
    given[1:, 3:5] = np.nan
    np.savez(tmp_path / "a.npz", joints=given * 1000)
    np.testing.assert_allclose(read_joints(tmp_path / "a.npz")[:, _14], given, atol=1e-12)


@pytest.mark.parametrize("scale", [3.28, 39.4, 0.1, 1e6])
def test_other_units_are_refused(tmp_path: Path, scale: float) -> None:
    np.savez(tmp_path / "a.npz", joints=JOINTS * scale)
    with pytest.raises(InputError, match="times as long as a person's in metres; give the joints in metres"):
        read_joints(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["joints3d", "joints_3d", "keypoints3d", "keypoints_3d"])
def test_other_names(tmp_path: Path, name: str) -> None:
    np.savez(tmp_path / "a.npz", **{name: JOINTS}, K=K)
    np.testing.assert_array_equal(read_joints(tmp_path / "a.npz"), JOINTS)


def test_an_array_alone(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", JOINTS)
    np.savez(tmp_path / "a.npz", JOINTS)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(JOINTS))
    (tmp_path / "a.json").write_text(json.dumps(JOINTS.tolist()))
    for path in tmp_path.iterdir():
        np.testing.assert_array_equal(read_joints(path), JOINTS)
    np.save(tmp_path / "b.npy", JOINTS[:, :22])
    with pytest.raises(InputError, match=r"no result that hfb knows.*`joints` \(frames, 24, 3\)"):
        read_joints(tmp_path / "b.npy")


@pytest.mark.parametrize("empty", [{}, [], {0: {}}, [[], []]])
def test_a_file_without_anybody(tmp_path: Path, empty: Any) -> None:
    (tmp_path / "wham_output.pkl").write_bytes(pickle.dumps(empty))
    with pytest.raises(InputError, match=r"wham_output\.pkl cannot be used: it holds nobody$"):
        read_tracks([tmp_path / "wham_output.pkl"], HEIGHT, WIDTH)


def test_poses_of_other_bodies(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", poses=np.zeros((3, 63)), trans=np.zeros((3, 3)), mocap_framerate=30)
    with pytest.raises(InputError, match="63 columns; SMPL's have 72, SMPL-H's 156, SMPL-X's 165"):
        read_joints(tmp_path / "a.npz")
    written = files.hybrik(tmp_path, Person.some())
    written.content["pred_thetas"] = np.zeros((files.COUNT, 55 * 9))
    written.path.write_bytes(pickle.dumps(written.content))
    with pytest.raises(InputError, match="HybrIK-X, whose body is SMPL-X; give HybrIK's"):
        read_joints(written.path)
    written.content["pred_thetas"] = Person.some().matrices
    written.content["pred_betas"] = np.zeros((files.COUNT, 9))
    written.path.write_bytes(pickle.dumps(written.content))
    with pytest.raises(InputError, match=r"in pred_betas it holds numbers of the shape \(5, 9\)"):
        read_joints(written.path)


def test_lost_joints_that_are_written_as_zeros(tmp_path: Path) -> None:
    given = JOINTS - JOINTS[:, :1]  # about the pelvis, which is no lost joint
    given[1, [20, 21]] = 0.0
    np.savez(tmp_path / "a.npz", joints=given)
    read = read_joints(tmp_path / "a.npz")
    assert np.isnan(read[1, [20, 21]]).all()
    np.testing.assert_array_equal(np.delete(read, [20, 21], 1), np.delete(given, [20, 21], 1))
    np.testing.assert_array_equal(read[[0, 2]], given[[0, 2]])


def test_poses_in_degrees_are_refused(tmp_path: Path) -> None:
    poses = np.full((5, 72), 20.0)
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.ones((5, 3)), mocap_framerate=30.0)
    with pytest.raises(InputError, match="convert its degrees to radians"):
        read_tracks([tmp_path / "a.npz"], HEIGHT, WIDTH)
