"""Corrupted motions: what the discriminator learns to detect, and the corrector to repair.

The paper reverses random joints in time, c(u) -> c(1 - u). Here whole limbs are reversed, too, each with even odds:
the ambiguity of a single image. Some columns are made unrealistic in other ways. Motions also get the errors of a fit,
without a label: otherwise a discriminator trained on true motions detects errors that every fit has.
"""

from dataclasses import dataclass

import torch

from hfb.body.skeleton import JOINT_COUNT, MIRROR
from hfb.geometry.rotations import axis_angle_to_quaternion, multiply_quaternions
from hfb.priors.motion_columns import COLUMN_COUNT, LIMBS, reversed_columns
from hfb.typing import Bool, Float, Tensor

_LIMBS_SHARE, _JOINTS_SHARE = 0.55, 0.2
"""Shares of motions whose limbs, or whose single joints, are reversed; the rest is whole or reversed as a whole."""

_UNREALISTIC_SHARE = 0.35
_STRONGEST = 2.0
"""Errors of a fit are drawn at any strength up to this, in units of those below, which were measured on 80 fits."""

_TURN_RAD = 0.17
"""Spread of a joint's rotation at mid-exposure about each axis."""

_LEAST_TURNING, _LEAST_GOING = 0.1, 0.5
"""Smallest shares of the true change of rotations and of the translation that fits find."""

_TURNING_NOISE, _GOING_NOISE_M = 0.15, (0.34, 0.63)
"""Noise of every entry of a rotation's coefficients, and of a translation's linear and quadratic ones.

In units of how fast the body's joints turn: the root mean square over the joints of their linear coefficients.
"""

_STILL = 0.01
"""Smallest rotation speed of a body, in these units."""


@dataclass(frozen=True)
class Corrupted:
    """Corrupted motions, and what was done to them.

    Attributes:
        columns: C as corrupted.
        clean: C before anything was reversed or made unrealistic.
        backwards: columns that run backwards; meaningless where a column is unrealistic.
        unrealistic: columns that were corrupted in another way.
        whole: 1 where the whole body runs backwards, 0 where all of it runs forwards, NaN where its parts disagree.
    """

    columns: Float[Tensor, "T 3 25 4"]
    clean: Float[Tensor, "T 3 25 4"]
    backwards: Bool[Tensor, "T 25"]
    unrealistic: Bool[Tensor, "T 25"]
    whole: Float[Tensor, "T"]


def mirrored_columns(columns: Float[Tensor, "T 3 25 4"]) -> Float[Tensor, "T 3 25 4"]:
    """Mirror motions: left and right are exchanged.

    Args:
        columns: motion in the body's own frame, see `motion_columns`.
    """
    order = [*MIRROR, JOINT_COUNT]
    signs = columns.new_tensor([[1.0, 1.0, -1.0, -1.0]] * JOINT_COUNT + [[-1.0, 1.0, 1.0, 1.0]])
    return columns[:, :, order] * signs


def corrupt(columns: Float[Tensor, "T 3 25 4"], generator: torch.Generator) -> Corrupted:
    """Corrupt a batch of true motions.

    Args:
        columns: motion in the body's own frame, see `motion_columns`.
        generator: draws the corruption.
    """
    clean = with_errors_of_a_fit(columns, generator)
    backwards, whole = draw_reversals(len(columns), generator)
    broken, unrealistic = _unrealistic(clean, generator)
    whole = torch.where(unrealistic.any(1), torch.nan, whole)
    return Corrupted(reversed_columns(broken, backwards), clean, backwards, unrealistic, whole)


def draw_reversals(count: int, generator: torch.Generator) -> tuple[Bool[Tensor, "T 25"], Float[Tensor, "T"]]:
    """Draw which columns run backwards, and whether all of them do (see `Corrupted`).

    Args:
        count: number of motions.
        generator: draws the corruption.
    """
    limbs = torch.zeros(count, COLUMN_COUNT, dtype=torch.bool)
    for members in LIMBS.values():
        limbs[:, list(members)] = torch.rand(count, 1, generator=generator) < 0.5
    joints = torch.rand(count, COLUMN_COUNT, generator=generator) < torch.rand(count, 1, generator=generator) / 2
    joints ^= torch.rand(count, 1, generator=generator) < 0.5
    all_of_it = (torch.rand(count, 1, generator=generator) < 0.5).expand(-1, COLUMN_COUNT)
    kind = torch.rand(count, 1, generator=generator)
    rest = torch.where(kind < _LIMBS_SHARE + _JOINTS_SHARE, joints, all_of_it)
    backwards = torch.where(kind < _LIMBS_SHARE, limbs, rest)
    agree = (backwards == backwards[:, :1]).all(1)
    return backwards, torch.where(agree, backwards[:, 0].float(), torch.nan)


def with_errors_of_a_fit(columns: Float[Tensor, "T 3 25 4"], generator: torch.Generator) -> Float[Tensor, "T 3 25 4"]:
    """Add the errors of a fit to one blurred image: rotated poses, and weaker and noisy motions.

    Args:
        columns: motion in the body's own frame, see `motion_columns`.
        generator: draws the corruption.
    """
    count = len(columns)
    turn, noise = _normals(columns, generator, count, JOINT_COUNT, 3), _normals(columns, generator, count, 2, 25, 4)
    strength, turning, going = torch.rand(3, count, 1, 1, generator=generator).to(columns)
    strength = _STRONGEST * strength
    turn[:, 0] = 0  # the root's own middle is the frame itself
    rotations = _turned(columns[:, :, :JOINT_COUNT], turn * strength * _TURN_RAD)
    changes = rotations[:, 1:] * (_LEAST_TURNING + (1 - _LEAST_TURNING) * turning)[..., None]
    ways = columns[:, 1:, JOINT_COUNT:] * (_LEAST_GOING + (1 - _LEAST_GOING) * going)[..., None]
    speed = columns[:, 1, :JOINT_COUNT].square().sum(-1).mean(-1).sqrt()[:, None, None, None]
    noise *= strength[..., None] * (speed + _STILL)
    noise[:, :, :JOINT_COUNT] *= _TURNING_NOISE
    noise[:, :, JOINT_COUNT] *= noise.new_tensor(_GOING_NOISE_M)[:, None]
    noise[:, :, JOINT_COUNT, 3] = 0
    middles = torch.cat([rotations[:, :1], columns[:, :1, JOINT_COUNT:]], 2)
    return torch.cat([middles, torch.cat([changes, ways], 2) + noise], 1)


def _unrealistic(columns: Tensor, generator: torch.Generator) -> tuple[Tensor, Bool[Tensor, "T 25"]]:
    """Scale some columns, exchange them with another motion's, or replace them by noise."""
    count = len(columns)
    which = torch.rand(count, COLUMN_COUNT, generator=generator) < 0.15 * torch.rand(count, 1, generator=generator)
    which &= torch.rand(count, 1, generator=generator) < _UNREALISTIC_SHARE
    which[:, 0] = False  # the root's own middle is the frame itself
    factor = 2 + 3 * torch.rand(count, 1, COLUMN_COUNT, 1, generator=generator)
    scaled = torch.cat([columns[:, :1], columns[:, 1:] * factor.to(columns)], 1)
    exchanged = columns[torch.randperm(count, generator=generator)]
    turned = _turned(columns[:, :, :JOINT_COUNT], 0.9 * _normals(columns, generator, count, JOINT_COUNT, 3))
    noise = torch.cat([turned, columns[:, :, JOINT_COUNT:] + 0.3 * _normals(columns, generator, count, 3, 1, 4)], 2)
    noise[:, :, JOINT_COUNT, 3] = 0
    kind = torch.rand(count, 1, COLUMN_COUNT, 1, generator=generator)
    wrong = torch.where(kind < 1 / 3, scaled, torch.where(kind < 2 / 3, exchanged, noise))
    return torch.where(which[:, None, :, None], wrong, columns), which


def _turned(rotations: Tensor, by: Tensor) -> Tensor:
    """Rotate quaternion polynomials by rotation vectors [rad] in the parent's frame."""
    return multiply_quaternions(axis_angle_to_quaternion(by)[:, None].expand_as(rotations), rotations)


def _normals(like: Tensor, generator: torch.Generator, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=generator).to(like)
