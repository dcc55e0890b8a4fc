"""Depth from joints across the view and an erring first guess."""

import hashlib
import json
from importlib import resources

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import MIRROR, PARENT_OR_SELF
from hfb.datasets.motions.sources import open_motions
from hfb.datasets.network_errors import draw_pose_errors
from hfb.evidence.joint_evidence import JointEvidence
from hfb.evidence.joint_network import Window
from hfb.evidence.lifting_network import lift_depth, shipped_lifting_network
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix

CAMERA = PinholeCamera.from_focal(200.0, 120, 160)
ACROSS = torch.tensor([-1.0, 1.0, 1.0])


FAR = torch.zeros(60)
"""No perspective."""


def people(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Joints of generated gestures in units of 1.2 m, y down, seen from the front; guesses that err; bones' lengths."""
    source = open_motions(None, 3)
    poses = np.concatenate([source.load(number).poses[::9] for number in range(6)])[:count]
    poses = torch.from_numpy(poses).float()
    poses[:, 0] = torch.tensor([torch.pi, 0.0, 0.0])
    erring = draw_pose_errors(poses, np.random.default_rng(1)).poses_at(torch.tensor([0.5, 1.0]))[-1]
    body = load_default_body().shape(torch.zeros(10))
    seen, guessed = (
        body.joints_of(axis_angle_to_matrix(one), torch.zeros(len(one), 3)) / 1.2 for one in (poses, erring)
    )
    return seen - seen[:, :1], guessed - guessed[:, :1], bones(seen)


def bones(joints: torch.Tensor) -> torch.Tensor:
    """Their lengths (N, 24)."""
    return (joints - joints[:, list(PARENT_OR_SELF)]).norm(dim=-1)


def test_depth_is_nearer_than_the_guess_and_nearest_with_a_neighbour() -> None:
    truth, start, lengths = people(60)
    noise = 0.01 * torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))
    seen = truth + noise
    guessed = (start - truth)[..., 2].abs().mean()
    told = seen, start, lengths, FAR
    alone = torch.cat([lift_depth(*(one[frame : frame + 1] for one in told)) for frame in range(60)])
    pairs = torch.cat([lift_depth(*(one[frame : frame + 2] for one in told)) for frame in range(0, 60, 2)])
    off_alone, off_pairs = ((told - truth[..., 2]).abs().mean() for told in (alone, pairs))
    assert off_alone < 0.6 * guessed
    assert off_pairs < 0.97 * off_alone


def test_bones_of_the_right_length_tell_more() -> None:
    truth, start, lengths = people(60)

    def off(factor: float) -> torch.Tensor:
        return (lift_depth(truth, start, factor * lengths, FAR) - truth[..., 2]).abs().mean()

    assert off(1.0) < 0.9 * min(off(0.9), off(1.1))


def test_time_has_no_arrow_and_a_frame_alone_is_its_own_neighbour() -> None:
    given = *people(5), FAR[:5]
    told = lift_depth(*given)
    torch.testing.assert_close(lift_depth(*(one.flip(0) for one in given)).flip(0), told)
    alone = lift_depth(*(one[:1] for one in given))
    torch.testing.assert_close(lift_depth(*(one[[0, 0]] for one in given)), alone.expand(2, -1))


def test_it_knows_neither_place_nor_size_nor_side() -> None:
    joints, start, lengths = people(8)
    rest = lengths, torch.full((8,), 0.2)
    told = lift_depth(joints, start, *rest)
    moved = joints + torch.tensor([0.3, -0.2, 5.0])
    torch.testing.assert_close(lift_depth(moved, 1.4 * start + 1, *rest), told, atol=1e-5, rtol=0)
    mirror = list(MIRROR)
    turned = lift_depth(joints[:, mirror] * ACROSS, start[:, mirror] * ACROSS, lengths[:, mirror], rest[1])
    torch.testing.assert_close(turned[:, mirror], told, atol=1e-5, rtol=0)
    its_own_depth = torch.tensor([1.0, 1.0, 7.0])  # is not read
    torch.testing.assert_close(lift_depth(joints * its_own_depth, start, *rest), told)


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_claims_depth_is_shared(share: float) -> None:
    joints, start, _ = people(2)
    middle, ones = torch.randn(2, 24, 3), torch.ones(2)
    windows = tuple(Window(20.0, 10.0, 90.0, CAMERA) for _ in range(2))
    evidence = JointEvidence(
        windows, middle, torch.ones_like(middle), torch.zeros_like(middle), ones, start, torch.tensor(0.5), ones[0]
    )
    metres = joints * torch.tensor([1.0, 1.0, 0.5]) + torch.tensor([0.0, 0.0, 4.0])
    told = evidence.lift(metres, share)
    across = torch.stack([window.to_units(one) for window, one in zip(windows, metres, strict=True)])
    perspective = windows[0].units_to_tangents()
    lengths = bones(metres) / (metres[:, :1, 2] * perspective)
    expected = (1 - share) * middle[..., 2] + share * lift_depth(across, start, lengths, torch.full((2,), perspective))
    torch.testing.assert_close(told.middle[..., 2], expected)
    assert torch.equal(told.middle[..., :2], middle[..., :2])
    assert torch.equal(told.scale, evidence.scale)


def test_the_record_is_of_these_weights() -> None:
    folder = resources.files("hfb.evidence") / "data"
    about = json.loads((folder / "lifting.json").read_text())
    assert hashlib.sha256((folder / "lifting.safetensors").read_bytes()).hexdigest() == about["sha256"]
    assert sum(one.numel() for one in shipped_lifting_network().parameters()) == about["parameters"]
