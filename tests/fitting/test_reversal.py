"""Running columns of C backwards in time: exact, its own inverse, and nobody else's business."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hfb.fitting.reversal import limb_columns, reverse_columns
from hfb.motion.trajectory import Trajectory, trajectory_at_rest
from hfb.priors.motion_columns import LIMBS

U = torch.linspace(0, 1, 7, dtype=torch.float64)


def moving(kind: str, origin: float, degree: int = 3, frames: int = 2, seed: int = 0) -> Trajectory:
    generator = torch.Generator().manual_seed(seed)
    poses = torch.randn(frames, 24, 3, generator=generator, dtype=torch.float64)
    rest = trajectory_at_rest(poses, poses[:, 0] + 3, degree, kind, origin)
    rotation = rest.rotation + 0.2 * torch.randn(rest.rotation.shape, generator=generator, dtype=torch.float64)
    translation = rest.translation + 0.2 * torch.randn(rest.translation.shape, generator=generator, dtype=torch.float64)
    return rest.with_coefficients(rotation, translation)


@pytest.mark.parametrize("kind", ["quaternion", "axis-angle"])
@given(origin=st.sampled_from([0.0, 0.3, 0.5, 1.0]), degree=st.integers(1, 4))
def test_all_columns_reversed_is_the_motion_at_one_minus_u(kind: str, origin: float, degree: int) -> None:
    motion = moving(kind, origin, degree)
    turned = reverse_columns(motion, torch.ones(2, 25, dtype=torch.bool))
    for there, back in zip(motion.at(1 - U), turned.at(U), strict=True):
        torch.testing.assert_close(back, there, rtol=0, atol=1e-10)


def test_twice_is_once_around() -> None:
    motion, columns = moving("quaternion", 0.2), torch.rand(2, 25, generator=torch.Generator().manual_seed(1)) < 0.5
    again = reverse_columns(reverse_columns(motion, columns), columns)
    torch.testing.assert_close(again.rotation, motion.rotation)
    torch.testing.assert_close(again.translation, motion.translation)


def test_other_columns_and_other_frames_stay_as_they_are() -> None:
    motion, limbs = moving("quaternion", 0.5), torch.zeros(2, 5, dtype=torch.bool)
    limbs[1, list(LIMBS).index("left arm")] = True
    turned = reverse_columns(motion, limb_columns(limbs))
    arm = list(LIMBS["left arm"])
    others = [joint for joint in range(24) if joint not in arm]
    assert torch.equal(turned.translation, motion.translation)
    assert torch.equal(turned.rotation[0], motion.rotation[0])
    assert torch.equal(turned.rotation[1][:, others], motion.rotation[1][:, others])
    there, back = motion.at(1 - U)[0], turned.at(U)[0]
    torch.testing.assert_close(back[1][:, arm], there[1][:, arm])
    assert (turned.at(U)[0][1][:, arm] - motion.at(U)[0][1][:, arm]).abs().max() > 0.01


def test_every_column_belongs_to_one_limb() -> None:
    counts = sum(limb_columns(torch.eye(5, dtype=torch.bool)[limb][None])[0].long() for limb in range(5))
    assert torch.equal(counts, torch.ones(25, dtype=torch.long))
