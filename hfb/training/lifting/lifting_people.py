"""People as joints for the lifting network: synthetic ones with errors like a fit's, and fits."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch

from hfb.body.skeleton import JOINT_NAMES, MIRROR, PARENTS
from hfb.evidence.lifting_network import match_spread
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.io.array_files import read_arrays

_STEPS_MM = {
    "hip": 6,
    "knee": 11,
    "ankle": 8,
    "foot": 8,
    "collar": 7,
    "shoulder": 7,
    "elbow": 10,
    "wrist": 16,
    "hand": 15,
    "spine1": 4,
    "spine2": 5,
    "spine3": 6,
    "neck": 7,
    "head": 5,
    "pelvis": 0,
}
"""Error that each joint adds in the image plane of a fit [mm]: measured on 160 frames of held-out motions.

16 mm in the mean; 25 until 2026-11-24.
"""

_INHERITED = 0.6
_TOWARDS_START = 0.15
"""A parent's share in a joint's error; the largest share of the first estimate's error that a fit keeps."""

_MOVED_AT_MOST_M, _FORGETS_M = 0.25, 0.145
_STILL, _GROWS_PER_M = 0.65, 5.2
"""Errors of two frames of a pair: their correlation is exp(-moved / 0.145 m), and their size grows with ``moved``.

``moved`` is the mean path of the joints from one frame to the other, relative to the pelvis. Measured on 791 fitted
pairs of held-out motions: where joints moved 16 mm, 0.94 of the variance is shared and errors are 0.74 of their mean;
at 175 mm 0.29 and 1.57.
"""

_SIZE, _BONE = 0.015, 0.02
"""Errors of a fit's bone lengths, as logarithms: of the whole body, and of each bone (both sides alike).

Measured on 74 fitted pairs of held-out motions: 1.5 %, and 1 to 3 % (a spine bone 6 %).
"""

_ROLL_FITS, _SIZES_FITS = 0.25, 0.08
"""Rotations [rad] and sizes (logarithms) with which fits are augmented."""
_OTHER_CAMERAS, _PERSPECTIVE = 0.35, 0.4
"""Share of the people seen by other cameras, from afar (0) to close by (a unit is 0.4 of the distance)."""
_PITCH_YAW_ROLL = (0.0, 0.2, 0.15)
_ASLANT, _PITCH_YAW_ROLL_ASLANT = 0.25, (0.25, 0.2, 0.3)
"""Rotations of whole people [rad]; a share as seen by cameras that look down or are tilted."""
_LEANING, _LEAN = 0.3, 0.25
"""Share of first estimates tilted as a whole into depth, as of real estimators, and the angle [rad]."""


@dataclass(frozen=True)
class Bank:
    """N people in two frames each, in their windows' units.

    Attributes:
        joints: (N, 2, 24, 3).
        starts: (N, 2, 24, 3) first estimates.
        unit_m: (N, 2) the unit's length.
        perspective: (N, 2) the unit as a tangent.
        lengths: (N, 24) of bones [m].
    """

    joints: torch.Tensor
    starts: torch.Tensor
    unit_m: torch.Tensor
    perspective: torch.Tensor
    lengths: torch.Tensor

    @staticmethod
    def read(paths: list[Path]) -> "Bank":
        """Read files of `lifting_bank`.

        Args:
            paths: at least one.
        """
        files = [read_arrays(path) for path in paths]
        return Bank(*(torch.from_numpy(np.concatenate([file[one.name] for file in files])) for one in fields(Bank)))

    def __len__(self) -> int:
        return len(self.joints)


@dataclass(frozen=True)
class Fitted:
    """N people in two frames each, as fits find them.

    Attributes:
        told: input of the network.
        truth: (N, 2, 24, 3) joints from the pelvis.
        unit_m: (N, 2) the unit's length.
    """

    told: tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
    truth: torch.Tensor
    unit_m: torch.Tensor

    @staticmethod
    def read(paths: list[Path]) -> "Fitted":
        """Read files of `lifting_fits`.

        Args:
            paths: at least one.
        """
        files = [read_arrays(path) for path in paths]
        file = {name: torch.from_numpy(np.concatenate([one[name] for one in files])) for name in files[0]}
        across, start, truth = (from_pelvis(file[name]) for name in ("fitted", "starts", "joints"))
        told = (across[..., :2], start, file["fitted_lengths"], file["perspective"])
        return Fitted(told, truth, file["unit_m"]).with_starts_match_spread()

    def with_starts_match_spread(self) -> "Fitted":
        """Rescale first estimates to the spread of the observed joints."""
        across, start, *rest = self.told
        large = match_spread(start.flatten(0, 1), across.flatten(0, 1)).unflatten(0, (-1, 2))
        return replace(self, told=(across, large, *rest))

    def some(self, count: int) -> "Fitted":
        """Draw random people in either frame order: mirrored, rotated about the line of sight, and rescaled.

        Args:
            count: how many.
        """
        rows = torch.randint(len(self.truth), (count, 1))
        order = torch.tensor([[0, 1], [1, 0]])[torch.randint(2, (count,))]
        across, start, lengths, perspective = (one[rows, order] for one in self.told)
        truth, mirror = self.truth[rows, order], list(MIRROR)
        mirrored = (torch.rand(count) < 0.5)[:, None, None]
        lengths = torch.where(mirrored, lengths[:, :, mirror], lengths)
        turn = axis_angle_to_matrix(torch.tensor([0.0, 0.0, _ROLL_FITS]) * torch.randn(count, 3)).mT[:, None]
        size = torch.exp(_SIZES_FITS * torch.randn(count))

        def changed(joints: torch.Tensor) -> torch.Tensor:
            axes = joints.shape[-1]
            turned = torch.tensor([-1.0, 1.0, 1.0])[:axes]
            seen = torch.where(mirrored[..., None], joints[:, :, mirror] * turned, joints)
            return seen @ turn[..., :axes, :axes] * size[:, None, None, None]

        told = (changed(across), changed(start), lengths * size[:, None, None], perspective / size[:, None])
        return Fitted(told, changed(truth), self.unit_m[rows, order] / size[:, None]).with_starts_match_spread()

    def beside(self, other: "Fitted") -> "Fitted":
        """Concatenate with others.

        Args:
            other: appended.
        """
        told = tuple(torch.cat(two) for two in zip(self.told, other.told, strict=True))
        return Fitted(told, torch.cat([self.truth, other.truth]), torch.cat([self.unit_m, other.unit_m]))  # type: ignore[arg-type]


def as_fitted(people: Bank, levels: torch.Tensor) -> Fitted:
    """Add errors like a fit's to joints in the image plane and to bones; first estimates get the same size.

    Args:
        people: without errors.
        levels: (N,) scale of the errors; 1 is as measured.
    """
    joints, starts = from_pelvis(people.joints), from_pelvis(people.starts)
    limbs = torch.tensor([{"left": 0, "right": 1}.get(name.partition("_")[0], 2) for name in JOINT_NAMES])
    legs = torch.tensor([name.rpartition("_")[2] in ("hip", "knee", "ankle", "foot") for name in JOINT_NAMES])
    steps = torch.tensor([_STEPS_MM[name.rpartition("_")[2]] for name in JOINT_NAMES]) / 1000
    spread = torch.exp(0.5 * torch.randn(len(joints), 1, 5))[..., torch.where(limbs == 2, 4, limbs + 2 * legs)]
    moved = ((joints[:, 1] - joints[:, 0]).norm(dim=-1).mean(-1) * people.unit_m[:, 0]).clamp_max(_MOVED_AT_MOST_M)
    same = torch.exp(-moved / _FORGETS_M)[:, None, None, None]
    common, own = torch.randn(len(joints), 1, 24, 2), torch.randn(len(joints), 2, 24, 2)
    step = same.sqrt() * common + (1 - same).sqrt() * own
    sizes = levels * (_STILL + _GROWS_PER_M * moved)
    step = step * (sizes[:, None, None] * spread * steps)[..., None]
    off = [step[:, :, 0]]
    for joint in range(1, 24):
        off.append(_INHERITED * off[PARENTS[joint]] + step[:, :, joint])
    kept = _TOWARDS_START * torch.rand(len(joints), 1, 1, 1) * (starts - joints)[..., :2]
    across = joints[..., :2] + torch.stack(off, 2) / people.unit_m[..., None, None] + kept
    sides = torch.tensor([min(joint, other) for joint, other in enumerate(MIRROR)])
    wrong = _SIZE * torch.randn(len(joints), 1) + (_BONE * torch.randn(len(joints), 24))[:, sides]
    lengths = people.lengths * torch.exp(levels[:, None] * wrong)
    told = (across, starts, lengths[:, None] / people.unit_m[..., None], people.perspective)
    return Fitted(told, joints, people.unit_m).with_starts_match_spread()


def augmented(bank: Bank, count: int) -> Bank:
    """Draw random people: mirrored, rotated about the line of sight and the vertical, seen by other cameras.

    A share of the first estimates is made nearly right.

    Args:
        bank: to draw from.
        count: how many.
    """
    rows = torch.randint(len(bank), (count, 1))
    order = torch.tensor([[0, 1], [1, 0]])[torch.randint(2, (count,))]
    joints, starts = from_pelvis(bank.joints[rows, order]), from_pelvis(bank.starts[rows, order])
    mirrored = (torch.rand(count) < 0.5)[:, None, None, None]
    turned = torch.tensor([-1.0, 1.0, 1.0])
    joints, starts = (torch.where(mirrored, one[:, :, list(MIRROR)] * turned, one) for one in (joints, starts))
    share = torch.where(torch.rand(count) < 0.3, torch.rand(count), torch.zeros(count))[:, None, None, None]
    starts = torch.lerp(starts, joints, share)
    sizes = torch.tensor([_PITCH_YAW_ROLL, _PITCH_YAW_ROLL_ASLANT])[(torch.rand(count) < _ASLANT).long()]
    turn = axis_angle_to_matrix(sizes * torch.randn(count, 3)).mT[:, None]
    tilt = torch.tensor([_LEAN, _LEAN, 0.0]) * torch.randn(count, 3) * (torch.rand(count, 1) < _LEANING)
    leaning = axis_angle_to_matrix(tilt).mT[:, None]
    seen = bank.perspective[rows, order]
    other = torch.where(torch.rand(count, 1) < _OTHER_CAMERAS, _PERSPECTIVE * torch.rand(count, 1), seen)
    joints, starts = (
        _by_a_camera(_from_afar(one, seen) @ turned, other)
        for one, turned in ((joints, turn), (starts, turn @ leaning))
    )
    return Bank(joints, starts, bank.unit_m[rows, order], other, bank.lengths[rows[:, 0]])


def _from_afar(joints: torch.Tensor, perspective: torch.Tensor) -> torch.Tensor:
    """Remove the perspective of joints (N, 2, 24, 3) from the pelvis, except for the part due to the view's axis."""
    return torch.cat([joints[..., :2] * (1 + perspective[..., None, None] * joints[..., 2:]), joints[..., 2:]], -1)


def _by_a_camera(joints: torch.Tensor, perspective: torch.Tensor) -> torch.Tensor:
    """Apply perspective: the inverse of `_from_afar`."""
    nearer = (1 + perspective[..., None, None] * joints[..., 2:]).clamp_min(0.2)
    return torch.cat([joints[..., :2] / nearer, joints[..., 2:]], -1)


def from_pelvis(joints: torch.Tensor) -> torch.Tensor:
    """Return joints relative to the pelvis.

    Args:
        joints: (..., 24, 3).
    """
    return joints - joints[..., :1, :]
