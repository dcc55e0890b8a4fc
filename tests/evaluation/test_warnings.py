"""What goes wrong is told: every warning on inputs that have its fault, none on clean ones, real recordings too."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from hfb.body.assets import load_body
from hfb.datasets.motions.folder import FolderMotions
from hfb.datasets.motions.resampling import has_jump, resample
from hfb.evaluation.warnings import (
    Look,
    check_front,
    check_left_over,
    check_light,
    check_limits,
    check_matte_iou,
    check_never_left,
    check_spin,
    check_static,
    find_warnings,
)
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.motion.sampled import SampledMotion
from hfb.tracking.tracks import find_tracks
from tests.shared import SHARED_DATA

HEIGHT, WIDTH = 120, 200
Change = Callable[[Look], Look]


def room() -> np.ndarray:
    """A scene with some structure."""
    noise = np.random.default_rng(5).uniform(0.25, 0.75, (12, 20, 3)).astype(np.float32)
    return cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).clip(0.05, 0.95)


def walk(count: int = 8, step: int = 15) -> list[Look]:
    """Somebody who crosses the scene, or stands there (step 0), explained by a body that covers the matte."""
    rng, looks = np.random.default_rng(2), []
    for number in range(count):
        matte = np.zeros((HEIGHT, WIDTH), np.float32)
        matte[40:110, 20 + step * number : 45 + step * number] = 1
        frame = np.where(matte[..., None] > 0, np.float32(0.05), room())
        frame = (frame + rng.normal(0, 0.005, frame.shape)).clip(0, 1).astype(np.float32)
        looks.append(Look(number, frame, matte, matte))
    return looks


def motion(turns_deg: list[float], interval_s: float) -> SampledMotion:
    """Two sub-frames per frame, the trunk upright and turned about the vertical by so much."""
    rows = 2 * len(turns_deg)
    poses = np.zeros((rows, 72))
    poses[:, 1] = np.repeat(np.deg2rad(turns_deg), 2)
    times_s = (np.repeat(np.arange(len(turns_deg)), 2) + np.tile([0.0, 0.8], len(turns_deg))) * interval_s
    index = np.repeat(np.arange(len(turns_deg)), 2)
    return SampledMotion(poses, np.zeros((rows, 3)), np.zeros(10), np.zeros((rows, 24, 3)), times_s, index, np.eye(3))


STILL = motion([0.0] * 8, 1 / 30)


def changed(looks: list[Look], change: Callable[[np.ndarray], None]) -> list[Look]:
    """The same frames after something happened to the scene."""
    out = []
    for look in looks:
        frame = look.frame_srgb.copy()
        change(frame)
        out.append(replace(look, frame_srgb=frame.clip(0, 1)))
    return out


def shade(frame: np.ndarray) -> None:
    frame[:, : frame.shape[1] // 3] *= 0.9


def longer_exposure(frame: np.ndarray) -> None:
    frame *= 1.25 ** (1 / 2.2)


def chair(frame: np.ndarray) -> None:
    """A thing that the plate does not have, away from the person's feet."""
    height, width = frame.shape[:2]
    frame[int(0.6 * height) : int(0.8 * height), int(0.05 * width) : int(0.2 * width)] = (0.3, 0.2, 0.1)


def test_a_clean_result_has_none() -> None:
    good = dict.fromkeys(range(8), 0.9)
    assert find_warnings(walk(), room(), STILL, good) == ()
    assert find_warnings(walk(1), room(), motion([0.0], 1 / 30), good) == ()
    assert find_warnings(walk(8, step=0), room(), STILL, good) == ()  # who stands still is no chair


def test_a_body_that_does_not_cover_the_matte() -> None:
    assert check_matte_iou({0: 0.9, 1: 0.71}) is None
    found = check_matte_iou({0: 0.9, 3: 0.55, 4: 0.69})
    assert found is not None
    assert (found.code, found.value, found.frames) == ("matte_iou", 0.55, (3, 4))
    assert "frames 3, 4" in found.message
    assert "hfb models fetch" in found.message
    assert [one.code for one in find_warnings(walk(), room(), STILL, {2: 0.5})] == ["matte_iou"]
    listed = check_matte_iou(dict.fromkeys(range(40), 0.1))
    assert listed is not None
    assert listed.message.count(",") < 20
    assert "and 32 more" in listed.message


@pytest.mark.parametrize(
    ("turns_deg", "fps", "spins"),
    [
        ([0, 5, 155, 150], 60 / 9, (2,)),  # front and back mistaken between two exposures of 9 frames at 60 fps
        ([170, -170, 170], 30, ()),  # 20 degrees, whatever the numbers say
        ([0, 24, 48, 72, 96], 30, ()),  # a pirouette
        ([0, 60, 120, 180], 30, ()),  # the fastest skater
        ([0, 90], 2, ()),  # half a second is enough to turn
        ([0, 180, 0], 30, (1, 2)),
    ],
)
def test_a_trunk_that_spins(turns_deg: list[float], fps: float, spins: tuple[int, ...]) -> None:
    found = check_spin(motion([float(one) for one in turns_deg], 1 / fps))
    assert (found.frames if found else ()) == spins


def test_frames_on_both_sides_of_a_gap_are_no_spin() -> None:
    turned = motion([0, 180], 1 / 30)
    assert check_spin(replace(turned, frame_index=np.array([0, 0, 9, 9]))) is None


def test_a_part_of_the_matte_that_is_no_body() -> None:
    looks = walk()
    for look in looks:
        look.matte[90:110, 2:16] = 1  # a chair that was moved, in the matte
    looks = [replace(look, alpha=np.where(np.arange(WIDTH) < 18, 0, look.matte).astype(np.float32)) for look in looks]
    found = check_left_over(looks)
    assert found is not None
    assert found.code == "matte_left_over"
    assert found.frames == tuple(range(8))


@pytest.mark.parametrize("change", [shade, longer_exposure])
def test_another_light(change: Callable[[np.ndarray], None]) -> None:
    found = check_light(changed(walk(), change), room())
    assert found is not None
    assert found.code == "light"
    assert found.frames == tuple(range(8))
    passing = [*walk()[:5], *changed(walk()[5:], change)]
    found = check_light(passing, room())
    assert found is not None
    assert found.frames == (5, 6, 7)


def test_a_thing_that_was_moved() -> None:
    found = check_static(changed(walk(), chair), room())
    assert found is not None
    assert found.code == "static_change"
    assert check_static(changed(walk()[:3], chair), room()) is None  # too few to know
    swallowed = changed(walk(), chair)
    for look in swallowed:  # in the matte all the time, while the rest of it moves
        look.matte[72:96, 10:40] = 1
    assert check_static(swallowed, room()) is not None


def test_somebody_who_never_leaves_is_in_the_median() -> None:
    stays = [(40.0 + n % 3, 20.0, 80.0, 110.0) for n in range(20)]
    found = check_never_left(stays)
    assert found is not None
    assert found.code == "plate_holds_person"
    assert "--background PLATE" in found.message
    assert check_never_left([(8.0 * n, 20.0, 8.0 * n + 40, 110.0) for n in range(20)]) is None  # walks through
    assert check_never_left([*stays[:8], *[None] * 12]) is None  # away for more than half
    assert check_never_left([None] * 5) is None
    assert check_never_left([(1.0, 2.0, 1.0, 2.0)] * 3) is None


def _frames(path: Path, step: int) -> Iterator[np.ndarray]:
    reader, number = cv2.VideoCapture(str(path)), 0
    while reader.grab():
        if number % step == 0:
            frame = cv2.resize(reader.retrieve()[1], None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
            yield frame[..., ::-1].astype(np.float32) / 255
        number += 1


@pytest.mark.parametrize(
    ("video", "plate", "step"),
    [
        ("pose2sim_balancing/cam01_f000-059.mp4", "cam01_plate.png", 8),
        ("pose2sim_balancing/cam04_f000-059.mp4", "cam04_plate.png", 8),
        ("opencap_walk_a/cam0_f001-074.mp4", "cam0_plate.png", 9),
        ("opencap_squat/cam0_f060-299.mp4", "cam0_plate.png", 30),
    ],
)
def test_real_recordings(video: str, plate: str, step: int) -> None:
    """None of clean footage; shade over a third, a quarter more exposure and a new chair in every one."""
    if not (SHARED_DATA / video).is_file():
        pytest.skip(f"{SHARED_DATA / video} is not there")
    empty = read_picture_srgb((SHARED_DATA / video).parent / plate)
    empty = cv2.resize(empty, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    frames = list(_frames(SHARED_DATA / video, step))
    looks = [Look(number, frame, _changed_person(frame, empty)) for number, frame in enumerate(frames)]
    assert check_light(looks, empty) is None
    assert check_static(looks, empty) is None
    for change in (shade, longer_exposure):
        assert check_light(changed(looks, change), empty) is not None
    assert check_static(changed(looks, chair), empty) is not None


def test_the_median_of_a_real_squat_holds_her() -> None:
    """She never leaves: the median of her clip is no background."""
    video = SHARED_DATA / "opencap_squat" / "cam0_f060-299.mp4"
    if not video.is_file():
        pytest.skip(f"{video} is not there")
    frames = list(_frames(video, 12))
    tracks = find_tracks(frames, np.median(frames, axis=0).astype(np.float32))
    boxes = [None if np.isnan(box).any() else tuple(box) for box in max(tracks, key=lambda t: t.present.sum()).boxes]
    assert check_never_left(boxes) is not None


def _changed_person(frame: np.ndarray, plate: np.ndarray) -> np.ndarray:
    """The largest area that differs: a matte good enough to look around."""
    differs = cv2.blur(np.abs(frame - plate).max(-1), (5, 5)) > 0.08
    closed = cv2.morphologyEx(differs.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed)
    return (labels == 1 + stats[1:, cv2.CC_STAT_AREA].argmax()).astype(np.float32)


def test_a_front_that_may_be_the_other_is_told() -> None:
    found = check_front({0: 0.95, 1: 0.6, 2: 0.55}, {0: 170.0, 1: 170.0, 2: 20.0})
    assert found is not None
    assert (found.code, found.value, found.frames) == ("front", 0.6, (1,))  # seen from the side there is no other front
    assert "hfb models fetch" in found.message
    assert check_front({0: 0.9}, {0: 170.0}) is None
    assert check_front({}, {}) is None


def swing(speed_m_s: float, back: bool, open_s: float = 1 / 30, rows: int = 8) -> SampledMotion:
    """One exposure in which the left wrist moves on, or goes back half way through; all else stands still."""
    u = np.linspace(-1, 1, rows)
    rest = np.zeros((rows, 24, 3))
    rest[:, 1:] = np.random.default_rng(3).uniform(-1, 1, (23, 3))
    # A path x(u) with |dx/dt| as asked at both ends of the exposure: x = v t, or a parabola.
    path = speed_m_s * open_s / 2 * (u**2 / 2 * rows / (rows - 1) if back else u)
    rest[:, 20, 0] += path
    still = motion([0.0], open_s)
    times = np.linspace(0, open_s, rows)
    poses = np.zeros((rows, 72))
    index = np.zeros(rows, int)
    return replace(still, poses=poses, trans=np.zeros((rows, 3)), joints=rest, times_s=times, frame_index=index)


def test_a_limb_that_turns_within_an_exposure() -> None:
    assert check_limits(swing(6.0, back=False)) == []
    assert check_limits(swing(1.0, back=True)) == []
    assert check_limits(swing(3.0, back=True, open_s=0.2)) == []  # there is time to wave
    (found,) = check_limits(swing(3.0, back=True))
    assert (found.code, found.frames) == ("limb_turn", (0,))
    assert found.value == pytest.approx(3.0, rel=0.05)
    assert "the left wrist stops and turns around within one exposure" in found.message


def test_a_limb_that_is_faster_than_anybody() -> None:
    assert check_limits(swing(24.0, back=False, open_s=1 / 500)) == []
    (found,) = [one for one in check_limits(swing(40.0, back=False, open_s=1 / 500)) if one.code == "limb_speed"]
    assert found.value == pytest.approx(40.0)
    assert "the left wrist moves at 40 m/s" in found.message


def test_a_joint_that_bends_faster_than_anybody() -> None:
    def bent(rate_deg_s: float) -> SampledMotion:
        moving = swing(0.0, back=False)
        angle = np.deg2rad(rate_deg_s) * moving.times_s + 0.5
        joints = moving.joints.copy()
        hip, knee, ankle = 2, 5, 8
        joints[:, hip], joints[:, knee] = [0, -0.4, 3], [0, 0, 3]
        joints[:, ankle] = np.stack([0.1 * np.sin(angle), -0.1 * np.cos(angle), np.full(len(angle), 3.0)], 1)
        return replace(moving, joints=joints)

    assert check_limits(bent(2000.0)) == []
    (found,) = check_limits(bent(3000.0))
    assert (found.code, round(found.value)) == ("joint_speed", 3000)
    assert "the right knee bends at 3000 degrees/s" in found.message


@pytest.mark.skipif(not (SHARED_DATA / "cmu_bvh").is_dir(), reason="no recorded motions here")
def test_recorded_motions_are_plausible() -> None:
    """Of windows of 1/15 s of true motions less than 1 % are told, and none for a speed."""
    source, rng, told, count = FolderMotions(SHARED_DATA / "cmu_bvh"), np.random.default_rng(0), [], 0
    shaped = load_body(None).shape(torch.zeros(10))
    for number in range(0, len(source.names()), 6):
        clip = source.load(number)
        starts_s = rng.uniform(0, (len(clip.poses) - 1) / clip.fps - 1 / 15, 15)
        starts_s = np.array([start for start in starts_s if not has_jump(clip, start, start + 1 / 15)])
        times_s = starts_s[:, None] + np.linspace(0, 1 / 15, 8)
        poses, trans = resample(clip, times_s.ravel())
        R = axis_angle_to_matrix(torch.from_numpy(poses).float())
        joints = shaped.joints_of(R, torch.from_numpy(trans).float()).numpy().astype(np.float64)
        index = np.repeat(np.arange(len(starts_s)), 8)
        flat = poses.reshape(-1, 72)
        told += check_limits(SampledMotion(flat, trans, np.zeros(10), joints, times_s.ravel(), index, np.eye(3)))
        count += len(starts_s)
    assert count > 250
    assert {one.code for one in told} <= {"limb_turn"}
    assert sum(len(one.frames) for one in told) < 0.01 * count
