"""The landmark lift keeps the symmetries of a camera, learns flat landmarks' depth, and is the one on record."""

import dataclasses
import hashlib
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.flows.cli.cli import main
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.landmark_lift import POINTS, lift_landmarks, shipped_landmark_lift
from hfb.initialization.landmarks import LANDMARK, LANDMARKS, Landmarks, Region
from hfb.initialization.pose_bank import bank_rotations
from hfb.initialization.registration import attach_landmarks, follow_chain
from hfb.motion.motion_file import write_arrays
from hfb.training.landmarks.landmark_training import Lessons

CAMERA = PinholeCamera(900.0, 900.0, 320.0, 240.0, 640, 480)


def swapped(name: str) -> str:
    return name.replace("left", "-").replace("right", "left").replace("-", "right")


def person() -> Landmarks:
    """Landmarks of nobody in particular, with the region about the optical axis."""
    rng = np.random.default_rng(4)
    world = rng.normal(0, 0.3, (33, 3))
    world[[LANDMARK["left_shoulder"], LANDMARK["right_shoulder"]], 1] -= 0.6
    pixels = 220 * world[:, :2] + rng.normal(0, 4, (33, 2)) + (CAMERA.cx, CAMERA.cy)
    region = Region(CAMERA.cx, CAMERA.cy, 300.0, 0.0)
    return Landmarks(pixels, world, rng.uniform(0.3, 1, 33), 1.0, region, region)


def test_a_mirrored_person_is_lifted_to_the_mirror_image() -> None:
    seen = person()
    order = [LANDMARK[swapped(name)] for name in LANDMARKS]
    mirrored = dataclasses.replace(
        seen,
        pixels=seen.pixels[order] * (-1, 1) + (2 * CAMERA.cx, 0),
        world=seen.world[order] * (-1, 1, 1),
        visibility=seen.visibility[order],
    )
    points = lift_landmarks(seen, CAMERA).points
    others = lift_landmarks(mirrored, CAMERA).points[[POINTS.index(swapped(name)) for name in POINTS]]
    torch.testing.assert_close(others * torch.tensor([-1.0, 1.0, 1.0]), points, atol=1e-5, rtol=0)


@pytest.mark.parametrize("angle", [0.4, -2.0])
def test_a_camera_that_rolls_turns_the_points(angle: float) -> None:
    seen = person()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    centre = np.array([CAMERA.cx, CAMERA.cy])
    world = np.concatenate([seen.world[:, :2] @ turn.T, seen.world[:, 2:]], 1)
    rolled = dataclasses.replace(seen, pixels=(seen.pixels - centre) @ turn.T + centre, world=world)
    points, turned = (lift_landmarks(one, CAMERA).points.double().numpy() for one in (seen, rolled))
    np.testing.assert_allclose(turned[:, :2], points[:, :2] @ turn.T, atol=1e-5)
    np.testing.assert_allclose(turned[:, 2], points[:, 2], atol=1e-5)


def test_the_size_of_the_image_does_not_matter() -> None:
    seen = person()
    region = Region(2 * CAMERA.cx, 2 * CAMERA.cy, 600.0, 0.0)
    larger = dataclasses.replace(seen, pixels=2 * seen.pixels, region=region)
    camera = PinholeCamera(1800.0, 1800.0, 640.0, 480.0, 1280, 960)
    torch.testing.assert_close(
        lift_landmarks(larger, camera).points, lift_landmarks(seen, CAMERA).points, atol=1e-5, rtol=0
    )


def flat_bank(path: Path, count: int) -> None:
    """Write what a landmark network that halves every depth would say of people of the pose bank."""
    body = load_default_body()
    shaped = body.shape(torch.zeros(10))
    attached, poses, rng = attach_landmarks(shaped), bank_rotations()[1], np.random.default_rng(7)
    rows: dict[str, list[np.ndarray]] = {"rays": [], "world": [], "visibility": [], "truth": []}
    for _ in range(count):
        turn = torch.tensor([[np.pi, 0, 0], [0, rng.uniform(-np.pi, np.pi), 0]], dtype=torch.float32)
        upright = axis_angle_to_matrix(turn)
        root = matrix_to_axis_angle(upright[0] @ upright[1])[None]
        pose = torch.cat([root, poses[rng.integers(len(poses))]])
        place = torch.tensor([rng.uniform(-0.5, 0.5), rng.uniform(-0.3, 0.3), rng.uniform(3, 5)]).float()
        points = attached.positions(*follow_chain(shaped.joints, axis_angle_to_matrix(pose), place)).numpy()
        rays, world = np.zeros((33, 2)), np.zeros((33, 3))
        rays[attached.landmarks], world[attached.landmarks] = points[:, :2] / points[:, 2:], points
        world = (world - points[:2].mean(0)) * (1, 1, 0.5)
        for name, values in (("rays", rays), ("world", world), ("visibility", np.ones(33)), ("truth", points)):
            rows[name].append(values)
    write_arrays(path, {name: np.stack(values).astype(np.float32) for name, values in rows.items()})


def test_training_learns_the_depth_of_flat_landmarks(tmp_path: Path) -> None:
    flat_bank(tmp_path / "bank.npz", 300)
    lessons = Lessons.read([tmp_path / "bank.npz"])
    assert len(lessons.truth) > 250
    words = ("--bank", tmp_path / "bank.npz", "--out", tmp_path / "out", "--iterations", 300, "--batch", 64)
    assert main(["train", "landmarks", *map(str, words)]) == 0
    about = json.loads((tmp_path / "out" / "landmark_lift.json").read_text())
    assert about["held_out"]["people"] == -(-len(lessons.truth) // 10)
    assert about["held_out"]["lifted"]["depth"] < 0.5 * about["held_out"]["landmarks"]["depth"]
    assert about["held_out"]["lifted"]["across"] < 20


def test_the_record_is_of_these_weights() -> None:
    folder = resources.files("hfb.initialization") / "data"
    about = json.loads((folder / "landmark_lift.json").read_text())
    assert hashlib.sha256((folder / "landmark_lift.safetensors").read_bytes()).hexdigest() == about["sha256"]
    assert sum(one.numel() for one in shipped_landmark_lift().parameters()) == about["parameters"]
