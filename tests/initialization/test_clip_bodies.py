"""First bodies of a clip: which frames are searched, one front for all, neighbours for the missed ones."""

from math import pi

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.fronts import agree_on_front, mirrored_in_depth
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.tracking.clip_bodies import between, body_between, fill_missed, key_frames

BODY = load_default_body()
CAMERA = PinholeCamera.from_focal(400.0, 96, 96)


def body_at(turn: float, left: float = 0.0, arm: float = -1.2) -> FirstBody:
    """Upright, turned about the vertical, arms down."""
    pose = torch.zeros(24, 3)
    upright = axis_angle_to_matrix(torch.tensor([pi, 0.0, 0.0]))
    turned = upright @ axis_angle_to_matrix(torch.tensor([0.0, turn, 0.0]))
    pose[0] = matrix_to_axis_angle(turned)
    pose[16, 2], pose[17, 2] = arm, -arm
    return FirstBody(pose, torch.tensor([left, 0.0, 6.0]), torch.zeros(10), "matte")


def same_pose(one: FirstBody, other: FirstBody) -> bool:
    """As rotations: at half a turn two vectors are one rotation."""
    return torch.allclose(axis_angle_to_matrix(one.pose), axis_angle_to_matrix(other.pose), atol=1e-5)


def joints(first: FirstBody) -> np.ndarray:
    shaped = BODY.shape(first.betas)
    return shaped.joints_of(axis_angle_to_matrix(first.pose)[None], first.translation[None])[0].numpy()


@pytest.mark.parametrize(
    ("present", "every", "expected"),
    [
        ([1] * 9, 4, (0, 4, 8)),
        ([1] * 10, 4, (0, 3, 6, 9)),
        ([0, 1, 1, 1, 0, 1, 0], 4, (1, 3, 5)),
        ([1], 4, (0,)),
        ([0, 0], 4, ()),
    ],
)
def test_key_frames(present: list[int], every: int, expected: tuple[int, ...]) -> None:
    chosen = key_frames(np.array(present, bool), every)
    assert chosen == expected


def test_a_mirror_image_looks_the_same_and_faces_away() -> None:
    first = body_at(0.4, arm=-0.7)
    mirrored = mirrored_in_depth(first)
    here, there = joints(first), joints(mirrored)
    swap = [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22]
    expected = here[swap] - here[0]
    expected[:, 2] *= -1
    assert np.allclose(there - there[0], expected, atol=2e-3)  # the embedded body is nearly symmetric
    assert same_pose(mirrored_in_depth(mirrored), first)


def test_one_front_for_all() -> None:
    true = {frame: body_at(0.3 + 0.05 * frame) for frame in range(0, 20, 4)}
    found = {frame: mirrored_in_depth(one) if frame in (4, 12) else one for frame, one in true.items()}
    agreed = agree_on_front(found, dict.fromkeys(found, 0.0))
    for frame, one in true.items():
        assert same_pose(agreed[frame], one)
    sure = agree_on_front(found, {frame: 1.0 if frame == 4 else 0.0 for frame in found})
    assert same_pose(sure[4], found[4])
    assert same_pose(sure[8], mirrored_in_depth(true[8]))
    assert agree_on_front({}, {}) == {}


def test_between_neighbours() -> None:
    known = {2: body_at(0.0, 0.0), 6: body_at(0.4, 1.0)}
    middle = between(4, known)
    assert middle.source == "between"
    assert torch.allclose(middle.translation[0], torch.tensor(0.5))
    assert torch.allclose(middle.pose, body_at(0.2).pose, atol=1e-4)
    assert torch.equal(between(0, known).pose, known[2].pose)
    assert torch.equal(between(9, known).translation, known[6].translation)
    with pytest.raises(ValueError, match="no body is known"):
        between(1, {})


def test_a_body_is_laid_onto_its_matte() -> None:
    true, shaped = body_at(0.1, 0.1), BODY.shape(torch.zeros(10))
    posed = shaped.pose(axis_angle_to_matrix(true.pose)[None], true.translation[None])
    matte = make_rasterizer("coverage").silhouette_mean(posed.vertices, CAMERA, BODY.mesh).numpy()
    known = {0: body_at(0.1, 0.0), 2: body_at(0.1, 0.1)}
    start, laid = between(1, known), body_between(1, known, matte, CAMERA, BODY)
    before, after = (float((one.translation - true.translation)[:2].norm()) for one in (start, laid))
    assert after < 0.5 * before


def test_missed_frames_are_filled_and_marked() -> None:
    found = {0: body_at(0.0), 1: body_at(0.1), 4: body_at(0.4), 10: body_at(1.0)}
    present = np.array([1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1], bool)
    bodies = fill_missed(found, present, 2)
    assert bodies.filled.tolist() == [False, False, True, True] + [False] * 7
    assert bodies.usable.tolist() == [True] * 5 + [False] * 5 + [True]
    longer = fill_missed(found, present, 4)
    assert longer.usable.tolist() == [True] * 5 + [False] + [True] * 5
    assert torch.allclose(longer.bodies[9].pose, found[10].pose, atol=1e-4)
