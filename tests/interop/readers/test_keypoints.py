"""2D keypoints in the layouts that systems write: the right joints at the right pixels, of the right people."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.interop.readers.pose_track import PoseTrack
from hfb.interop.readers.sniff import choose_person, read_tracks
from hfb.interop.track_bodies import body_at, share_on_matte, with_poses
from tests.interop.readers import files
from tests.interop.readers.files import COUNT, HEIGHT, WIDTH, Person

SMPL = files.smpl()
COCO = (
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
)
KNEE = JOINT_NAMES.index("left_knee")


def shown(folder: Path) -> np.ndarray:
    """Where a person's 24 joints appear in COUNT pictures."""
    return files.wham(folder, Person.some()).pixels


def as_coco(pixels: np.ndarray) -> np.ndarray:
    """(17, 3): x, y, confidence; the face is of no joint."""
    rows = [[*pixels[JOINT_NAMES.index(name)], 0.9] if name in JOINT_NAMES else [1.0, 2.0, 0.8] for name in COCO]
    return np.array(rows)


def read(folder: Path, content: Any) -> tuple[PoseTrack, ...]:
    path = folder / "keypoints.json"
    path.write_text(json.dumps(content))
    return read_tracks([path], HEIGHT, WIDTH)


def test_arrays(tmp_path: Path) -> None:
    pixels = shown(tmp_path)
    coco = np.stack([as_coco(one) for one in pixels])
    coco[1, COCO.index("left_knee"), 2] = 0.05  # not seen
    np.savez(tmp_path / "k.npz", keypoints=coco, frame_index=np.arange(COUNT) + 3)
    (track,) = read_tracks([tmp_path / "k.npz"], HEIGHT, WIDTH)
    assert track.frames.tolist() == [3 + at for at in range(COUNT)]
    assert track.pixels is not None
    np.testing.assert_allclose(track.pixels[0, KNEE], pixels[0, KNEE], atol=1e-3)
    assert np.isnan(track.pixels[1, KNEE]).all()
    hips = [JOINT_NAMES.index(f"{side}_hip") for side in ("left", "right")]
    np.testing.assert_allclose(track.pixels[0, 0], pixels[0, hips].mean(0), atol=1e-3)
    (all_joints,) = read(tmp_path, {"joints2d": pixels.tolist()})
    assert all_joints.pixels is not None
    np.testing.assert_allclose(all_joints.pixels, pixels, atol=1e-3)


def test_keypoints_at_0_0_were_not_seen(tmp_path: Path) -> None:
    pixels = shown(tmp_path)
    coco = np.stack([as_coco(one) for one in pixels])[..., :2]  # as YOLO's `keypoints.xy`, without a confidence
    coco[1, COCO.index("left_knee")] = 0.0
    np.savez(tmp_path / "k.npz", keypoints=coco)
    (track,) = read_tracks([tmp_path / "k.npz"], HEIGHT, WIDTH)
    assert track.pixels is not None
    assert np.isnan(track.pixels[1, KNEE]).all()
    np.testing.assert_allclose(track.pixels[0, KNEE], pixels[0, KNEE], atol=1e-3)


def test_results_of_coco_and_alphapose(tmp_path: Path) -> None:
    pixels = shown(tmp_path)
    body = [
        {"image_id": f"{n}.jpg", "score": 2.9, "idx": 4, "keypoints": as_coco(pixels[n]).ravel().tolist()}
        for n in range(COUNT)
    ]
    other = [{**one, "idx": 2, "score": 3.0, "keypoints": [v + 100 for v in one["keypoints"]]} for one in body[:2]]
    tracks = read(tmp_path, [*other, *body])
    assert [(track.person, len(track)) for track in tracks] == [("2", 2), ("4", COUNT)]
    assert tracks[1].frames.tolist() == list(range(COUNT))
    by_score = read(
        tmp_path, [{key: one[key] for key in ("image_id", "keypoints", "score")} for one in [*body, *other]]
    )
    assert by_score[0].pixels is not None
    np.testing.assert_allclose(by_score[0].pixels[0, KNEE], pixels[0, KNEE] + 100, atol=1e-3)  # the likeliest first


def test_openpose(tmp_path: Path) -> None:
    points = np.zeros((25, 3))
    points[8] = 5, 6, 0.9
    points[1:8], points[9:15] = [7, 8, 0.9], [9, 10, 0.9]
    (track,) = read(
        tmp_path, {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": points.ravel().tolist()}]}
    )
    assert track.pixels is not None
    assert track.pixels[0, 0].tolist() == [5, 6]
    assert track.pixels[0, JOINT_NAMES.index("right_ankle")].tolist() == [9, 10]
    assert np.isnan(track.pixels[0, JOINT_NAMES.index("head")]).all()


def test_a_body_appears_where_its_keypoints_are(tmp_path: Path) -> None:
    pixels = shown(tmp_path)
    (track,) = read(tmp_path, {"keypoints": [as_coco(one).tolist() for one in pixels]})
    assert share_on_matte(track, 0, np.ones((HEIGHT, WIDTH), np.float32), SMPL) > 0.9
    assert share_on_matte(track, 0, np.zeros((HEIGHT, WIDTH), np.float32), SMPL) == 0
    posed, camera = with_poses(track, SMPL), PinholeCamera.from_focal(800.0, HEIGHT, WIDTH)
    assert posed.pixels is None
    first = body_at(posed, 1, camera, SMPL)
    assert first is not None
    turns = axis_angle_to_matrix(first.pose)[None]
    shaped = SMPL.shape(first.betas.to(SMPL.template))
    joints = shaped.joints_of(turns.to(SMPL.template), first.translation[None].to(SMPL.template))[0]
    apart = np.linalg.norm(camera.project(joints).numpy() - pixels[1], axis=-1)
    assert np.median(apart) < 0.05 * np.ptp(pixels[1], axis=0).max()
    assert float(joints[:, 2].min()) > 1
    assert not torch.isnan(first.translation).any()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"keypoints": [[[1, 2]] * 9]}, "9 keypoints are of no known layout"),
        ({"keypoints": [[1, 2, 3, 4]]}, "instead of"),
        ([{"image_id": "left.jpg", "keypoints": [1, 2, 0.5] * 17}], "no number in it"),
        ([{"image_id": 0, "keypoints": [1, 2]}], "x, y, confidence"),
    ],
)
def test_what_is_no_keypoints_is_a_sentence(tmp_path: Path, content: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        choose_person(read(tmp_path, content), None)
