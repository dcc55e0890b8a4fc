"""Landmarks that were taken off a known body lead back to it."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.landmark_lift import POINTS, LiftedPoints
from hfb.initialization.landmarks import Landmarks, Region
from hfb.initialization.pose_bank import bank_rotations
from hfb.initialization.registration import attach_landmarks, follow_chain, register
from hfb.motion.static_pose import FirstBody
from hfb.priors.anatomy import AnatomicalPrior

CAMERA = PinholeCamera.from_focal(900.0, 640, 480)
BODY = load_default_body()


def truth(name: str, yaw: float, place: tuple[float, float, float]) -> FirstBody:
    names, poses = bank_rotations()
    upright = axis_angle_to_matrix(torch.tensor([torch.pi, 0, 0])) @ axis_angle_to_matrix(torch.tensor([0, yaw, 0]))
    pose = torch.cat([matrix_to_axis_angle(upright)[None], poses[names.index(name)]])
    return FirstBody(pose, torch.tensor(place), torch.zeros(10), "truth")


def landmarks_of(first: FirstBody) -> tuple[Landmarks, LiftedPoints]:
    """What perfect networks would say."""
    shaped = BODY.shape(first.betas)
    joints, turns = follow_chain(shaped.joints, axis_angle_to_matrix(first.pose), first.translation)
    attached = attach_landmarks(shaped)
    points = attached.positions(joints, turns)
    world = np.zeros((33, 3))
    world[attached.landmarks] = points.numpy()
    seen = np.zeros(33)
    seen[attached.landmarks] = 1.0
    pixels = np.zeros((33, 2))
    pixels[attached.landmarks] = CAMERA.project(points).numpy()
    hips = (world[23] + world[24]) / 2
    # The network measures along its region's ray: here the region is taken at the picture's centre.
    region = Region(CAMERA.cx, CAMERA.cy, 500.0, 0.0)
    middle = points[[POINTS.index("left_hip"), POINTS.index("right_hip")]].mean(0)
    lifted = LiftedPoints(points - middle, torch.full((len(POINTS), 3), 0.02), middle[2])
    return Landmarks(pixels, world - hips, seen, 1.0, region, region), lifted


def joints_of(first: FirstBody) -> torch.Tensor:
    shaped = BODY.shape(first.betas)
    return shaped.joints_of(axis_angle_to_matrix(first.pose)[None], first.translation[None])[0]


@pytest.mark.parametrize(
    ("name", "yaw", "place"),
    [
        ("standing", 0.0, (0.0, 0.2, 4.0)),
        ("stride", 1.4, (0.4, 0.1, 3.0)),
        ("star", 3.1, (-0.5, 0.0, 5.0)),
        ("front kick", -2.0, (0.0, 0.0, 3.5)),
    ],
)
def test_recovers_a_known_body(name: str, yaw: float, place: tuple[float, float, float]) -> None:
    first = truth(name, yaw, place)
    found = register(*landmarks_of(first), CAMERA, BODY)
    error = (joints_of(found) - joints_of(first)).norm(dim=1)
    assert float(error.mean()) < 0.07
    relative = joints_of(found) - joints_of(found)[:1] - joints_of(first) + joints_of(first)[:1]
    assert float(relative.norm(dim=1).mean()) < 0.05
    assert found.source == "mediapipe"


def test_unseen_limbs_stay_natural_and_move_nothing_else() -> None:
    first = truth("stride", 0.7, (0.0, 0.1, 3.5))
    whole, lifted = landmarks_of(first)
    seen, pixels = whole.visibility.copy(), whole.pixels.copy()
    for index in (13, 15, 25, 27, 29, 31):  # the left elbow, wrist and lower leg are wrong and known to be so
        seen[index] = 0.0
        pixels[index] += 150
    points, scale = lifted.points.clone(), lifted.scale.clone()
    for name in ("elbow", "wrist", "knee", "ankle", "heel", "foot_index"):
        points[POINTS.index(f"left_{name}")] += 0.5
        scale[POINTS.index(f"left_{name}")] = 1.0
    lifted = dataclasses.replace(lifted, points=points, scale=scale)
    found = register(dataclasses.replace(whole, visibility=seen, pixels=pixels), lifted, CAMERA, BODY)
    error = (joints_of(found) - joints_of(first)).norm(dim=1)
    others = [0, 1, 2, 3, 5, 6, 8, 9, 12, 15, 16, 17, 19, 21]
    assert float(error[others].mean()) < 0.1
    assert float(AnatomicalPrior()(found.pose[None, 1:])[0]) < 60


def test_deterministic() -> None:
    seen = landmarks_of(truth("throw", 0.3, (0.1, 0.0, 4.0)))
    assert torch.equal(register(*seen, CAMERA, BODY).pose, register(*seen, CAMERA, BODY).pose)


def test_attachments_are_on_the_right_side() -> None:
    shaped = BODY.shape(torch.zeros(10))
    attached = attach_landmarks(shaped)
    identity = torch.eye(3).expand(24, 3, 3)
    points = dict(zip(attached.landmarks.tolist(), attached.positions(shaped.joints, identity), strict=True))
    assert points[7][0] > 0.05 > -0.05 > points[8][0]  # ears
    assert points[0][2] > points[7][2] + 0.05  # the nose is in front of the ears
    assert points[31][2] > points[29][2] + 0.15  # toes and heel
    assert points[31][0] > 0 > points[32][0]


def test_registration_does_not_wait_for_torchs_compiler() -> None:
    """Its import costs every worker of a clip a second and 70 MB."""
    program = (
        "import sys\n"
        "from tests.initialization.test_registration import BODY, CAMERA, landmarks_of, register, truth\n"
        "register(*landmarks_of(truth('standing', 0.0, (0.0, 0.2, 4.0))), CAMERA, BODY, iterations=2)\n"
        "print(sorted({'sympy', 'torch._dynamo'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert done.stdout == "[]\n", done.stderr
