"""A row of which no body can be made is left out; the others are read as if it were not there."""

import logging
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
import torch

from hfb.errors import InputError
from hfb.interop.readers.pose_track import PoseTrack
from hfb.interop.readers.sniff import read_tracks
from tests.interop.readers import files
from tests.interop.readers.files import COUNT, HEIGHT, PICKLED, WIDTH, Person, Written

Break = Callable[[Any], None]


def _set(array: Any, value: Any) -> None:
    array[2] = value


BAD_ROWS: dict[str, tuple[Callable[[Path, Person], Written], Break]] = {
    "a place that is not finite": (files.wham, lambda content: _set(content[0]["trans"], np.nan)),
    "a pose that is not finite": (files.wham, lambda content: _set(content[0]["pose"], np.inf)),
    "betas that are not finite": (files.wham, lambda content: _set(content[0]["betas"], np.nan)),
    "a body behind the camera": (files.wham, lambda content: _set(content[0]["trans"], [0, 0, -2])),
    "a scale below zero": (files.pymaf, lambda content: _set(content[1]["orig_cam"], [-0.1, -0.1, 0, 0])),
    "a scale of zero": (files.pymaf, lambda content: _set(content[1]["orig_cam"], 0)),
    "a box without width": (files.hybrik, lambda content: _set(content["bbox"], [5, 5, 5, 9])),
    "a matrix that is not finite": (files.hybrik, lambda content: _set(content["pred_thetas"], np.nan)),
    "a matrix that is no rotation": (files.tram, lambda content: _set(content["pred_rotmat"], 0)),
    "a tensor that is not finite": (files.tram, lambda content: _set(content["pred_trans"], torch.nan)),
    "a camera that is not finite": (
        lambda folder, person: files.gvhmr(folder, person, np.zeros((1, 3))),
        lambda content: _set(content["K_fullimg"], torch.nan),
    ),
    "keypoints behind the camera": (
        files.sam3d,
        lambda content: content[2][0].update(pred_cam_t=np.array([0.0, 0, -1])),
    ),
    "keypoints that are not finite": (
        files.sam3d,
        lambda content: content[2][0].update(pred_keypoints_3d=np.full((70, 3), np.nan)),
    ),
}


def longest(path: Path) -> PoseTrack:
    return max(read_tracks([path], HEIGHT, WIDTH), key=len)


@pytest.mark.parametrize("what", BAD_ROWS)
def test_a_bad_row_leaves_the_others(tmp_path: Path, what: str, caplog: pytest.LogCaptureFixture) -> None:
    write, spoil = BAD_ROWS[what]
    written = write(tmp_path, Person.some())
    whole = longest(written.path)
    spoil(written.content)
    PICKLED[written.path.name](written.content, written.path)
    with caplog.at_level(logging.WARNING):
        track = longest(written.path)
    others = whole.rows(np.array([0, 1, 3, 4]))
    for name in ("frames", "poses", "trans", "betas", "pelvis", "joints", "K"):
        np.testing.assert_array_equal(getattr(track, name), getattr(others, name))
    (line,) = [record.getMessage() for record in caplog.records]
    assert "1 of 5" in line
    assert whole.system in line


def test_whoever_has_no_rows_left_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    written = files.wham(tmp_path, Person.some())
    content = {0: written.content[0], 7: {**written.content[0], "trans": np.full((COUNT, 3), np.nan)}}
    joblib.dump(content, written.path)
    (track,) = read_tracks([written.path], HEIGHT, WIDTH)
    assert (track.person, len(track)) == ("0", COUNT)
    assert "WHAM: 5 of 5 rows of person 7 are left out" in caplog.text
    del content[0]
    joblib.dump(content, written.path)
    with pytest.raises(InputError, match="cannot be used: nobody is left: its numbers are not finite"):
        read_tracks([written.path], HEIGHT, WIDTH)


def test_joints_may_be_unknown_but_not_all(tmp_path: Path) -> None:
    joints = Person.some().standing + np.array([0.0, 0, 4])
    joints[1, 3:] = np.nan
    joints[2, 10] = np.nan
    joints[3] = np.nan
    K = np.tile(np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]]), (COUNT, 1, 1))
    K[4] = np.nan
    np.savez(tmp_path / "a.npz", joints=joints, K=K)
    (track,) = read_tracks([tmp_path / "a.npz"], HEIGHT, WIDTH)
    assert track.frames.tolist() == [0, 2]


def test_what_is_no_rotation_anywhere_is_refused(tmp_path: Path) -> None:
    written = files.hybrik(tmp_path, Person.some())
    written.content["pred_thetas"] = np.ones((COUNT, 216))
    written.path.write_bytes(pickle.dumps(written.content))
    with pytest.raises(InputError, match="matrices that are no rotations"):
        longest(written.path)
