"""DeepMimic's motions: a humanoid that looks along x, made by the published layout of a frame."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.motions.folder import FolderMotions
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.skeletons.kinematics import joint_positions, rest_joints, to_world
from hfb.errors import InputError
from hfb.geometry.quaternions import from_axis_angle, rotate

_J = {name: number for number, name in enumerate(JOINT_NAMES)}
_FPS, _FRAMES = 30, 45


def turn(axis: str, degrees: float) -> list[float]:
    """Return a quaternion, w first."""
    return Rotation.from_euler(axis, degrees, degrees=True).as_quat(scalar_first=True).tolist()


def walk(durations: np.ndarray | None = None) -> dict[str, object]:
    """A step: the right thigh goes forward, the left one back, the left knee bends; the right elbow bends forward."""
    frames = []
    for number in range(_FRAMES):
        swing = 30 * np.sin(2 * np.pi * number / 30)
        bend, elbow = np.deg2rad(-20 - abs(swing)), np.deg2rad(70.0)
        duration = 1 / _FPS if durations is None else float(durations[number])
        frame = [duration, 1.2 * number / _FPS, 0.9, 0.0, *turn("y", 0), *turn("z", -5), *turn("y", 20)]
        frame += [*turn("z", swing), bend, *turn("z", 5), *turn("x", -40), elbow]
        frame += [*turn("z", -swing), bend, *turn("z", 5), *turn("x", 10), 0.1]
        assert len(frame) == 44
        frames.append(frame)
    return {"Loop": "wrap", "Frames": frames}


def load(folder: Path, content: object, name: str = "humanoid3d_walk.txt") -> MotionClip:
    (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    (folder / "notes.txt").write_text("no motion")
    source = FolderMotions(folder)
    assert list(source.names()) == [name]
    return source.load(0)


def test_a_step(tmp_path: Path) -> None:
    clip = load(tmp_path, walk())
    assert (clip.fps, clip.poses.shape) == (pytest.approx(_FPS), (_FRAMES, 24, 3))
    world = to_world(from_axis_angle(clip.poses))
    joints = joint_positions(world, clip.translations, rest_joints())
    assert rotate(world[:, 0], np.array([0, 1.0, 0]))[:, 1].min() > 0.99
    forward = rotate(world[:, 0], np.array([0, 0, 1.0]))
    way = joints[-1, 0] - joints[0, 0]
    assert way @ forward[0] / np.linalg.norm(way) > 0.99  # walks where it looks
    assert 1.5 < np.linalg.norm(way) < 2.0  # 1.76 m, by the ratio of the legs
    ahead = ((joints[:, _J["right_ankle"]] - joints[:, _J["left_ankle"]]) * forward).sum(-1)
    assert ahead[7] > 0.3  # a quarter through the swing the right foot is in front
    assert ahead[22] < -0.3
    bend = clip.poses[:, [_J["left_knee"], _J["right_knee"]], 0].mean(1)
    expected = np.deg2rad(20 + abs(30 * np.sin(np.arange(_FRAMES) / 15 * np.pi)))
    assert np.abs(bend - expected).max() < 0.2  # SMPL's legs are not quite straight at rest: a constant
    np.testing.assert_allclose(bend - bend.mean(), expected - expected.mean(), atol=0.02)
    assert clip.poses[:, _J["right_elbow"], 1].mean() == pytest.approx(np.deg2rad(70), abs=0.1)
    left = rotate(world[:, 0], np.array([1.0, 0, 0]))
    assert (((joints[:, _J["right_wrist"]] - joints[:, _J["right_shoulder"]]) * left).sum(-1) < -0.1).all()  # raised
    assert (joints[:, _J["right_wrist"], 1] < joints[:, _J["right_shoulder"], 1]).all()
    look = rotate(world[:, _J["head"]], np.array([0, 0, 1.0]))
    assert ((look * left).sum(-1) > 0.25).all()  # the head is turned to its left


def test_durations_may_differ(tmp_path: Path) -> None:
    durations = np.full(_FRAMES, 1 / _FPS)
    durations[10], durations[-1] = 3 / _FPS, 0.0
    clip = load(tmp_path, walk(durations))
    assert len(clip.poses) == _FRAMES + 2


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"Frames": [[0.1] * 61] * 3}, "frames of 61 numbers.*44"),
        ({"Frames": [[0.1] * 44]}, "1 frames"),
        ({"Frames": 3}, "no motion of DeepMimic"),
        ('{"Frames": [', "no motion of DeepMimic"),
        ({"Frames": [[0.1] * 43 + ["a"]] * 3}, "no motion of DeepMimic"),
        ({"Frames": [[0.1] * 44] * 3}, "unit quaternions"),
        ({"Frames": [[float("nan")] * 44] * 3}, "not finite"),
        ({"Frames": [[0.0] * 44] * 3}, "without a duration"),
    ],
)
def test_what_is_no_motion_is_a_sentence(tmp_path: Path, content: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        load(tmp_path, content)
