"""A model of pose networks' errors: rotated bones, alike along a limb, larger in depth than across the view."""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENT_OR_SELF, PARENTS
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.priors.anatomy import AnatomicalPrior
from hfb.typing import Array, Float, Tensor

_ACROSS_VIEW = 0.2
"""Turns that move a bone across the view, which an image shows, relative to those into depth, which it hides."""
_SHARED_BY_LIMB, _SHARED_BY_TORSO = 0.5, 0.7
_SHARED_BY_FRAMES = 0.6
_PROBE_RAD = 0.35
_LEVELS = ((1, 2, 3, 13, 14), (4, 5, 6, 16, 17), (7, 8, 9, 18, 19), (10, 11, 12, 20, 21), (15, 22, 23))
"""Joints below the root, parents before children."""
_ALLOWED_EXCESS = 2.0
"""Largest limit penalty of a joint: eight degrees beyond the range of motion, or the person's own excess."""

# Standard deviation of a joint's own turn, relative to the shoulder's.
_SIZES = {
    "pelvis": 0.35,
    "spine1": 0.3,
    "spine2": 0.25,
    "spine3": 0.25,
    "neck": 0.4,
    "head": 0.5,
    "hip": 0.7,
    "knee": 0.9,
    "ankle": 0.7,
    "foot": 0.3,
    "collar": 0.3,
    "shoulder": 1.0,
    "elbow": 1.1,
    "wrist": 0.8,
    "hand": 0.2,
}
_LIMBS = {
    **dict.fromkeys(("hip", "knee", "ankle", "foot"), "leg"),
    **dict.fromkeys(("collar", "shoulder", "elbow", "wrist", "hand"), "arm"),
}


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """One draw of turns of every bone in camera axes [rad], by which `amplitude` scales."""

    poses: Float[Tensor, "T 24 3"]
    turns: Float[Tensor, "T 24 3"]

    def poses_at(self, amplitudes: Float[Tensor, "A"]) -> Float[Tensor, "A T 24 3"]:
        """Return the erroneous poses at rising amplitudes; a joint at the end of its range of motion turns no further.

        Args:
            amplitudes: sizes of the error, rising.
        """
        turned = _turned(self.poses, amplitudes[:, None, None, None] * self.turns)
        allowed = _excess_of_joints(self.poses).clamp_min(_ALLOWED_EXCESS)
        within = _excess_of_joints(turned.flatten(0, 1)).unflatten(0, turned.shape[:2]) <= allowed
        # Row 0 of the table is the true pose: a joint that is never within stays there.
        steps = torch.arange(1, len(amplitudes) + 1)[:, None, None]
        index = torch.where(within.cummin(0).values, steps, 0).cummax(0).values
        table = torch.cat([self.poses[None], turned])
        limited = turned.clone()
        limited[:, :, 1:] = table[:, :, 1:].gather(0, index[..., None].expand(-1, -1, -1, 3))
        return limited


def draw_pose_errors(poses: Float[Tensor, "T 24 3"], rng: np.random.Generator) -> PoseErrors:
    """Draw the errors of one network on the frames of one clip.

    Args:
        poses: the true ones, whose root turns the body into the camera's frame.
        rng: draws the errors.
    """
    return pose_errors(poses, draw_turns(len(poses), rng))


def draw_turns(frames: int, rng: np.random.Generator) -> Float[Array, "T 24 3"]:
    """Draw how far a network turns each bone in the frames of one clip, in camera axes, unit size for the shoulder.

    A share of each bone's turn is common to its limb or the torso, a share of everything to all frames (the same
    person, clothes and network).

    Args:
        frames: number of frames.
        rng: draws the errors.
    """
    common = _draw_turns(rng)
    turns = [
        np.sqrt(_SHARED_BY_FRAMES) * common + np.sqrt(1 - _SHARED_BY_FRAMES) * _draw_turns(rng) for _ in range(frames)
    ]
    return np.stack(turns)


def pose_errors(poses: Float[Tensor, "T 24 3"], turns: Float[Array, "T 24 3"]) -> PoseErrors:
    """Convert drawn turns to errors of these poses, of one clip or of many.

    Turns that move the bone across the view are damped, the more the bone points at the camera, where no turn is
    hidden. The root's turn is small, since networks see the torso best.

    Args:
        poses: the true ones, whose root turns the body into the camera's frame.
        turns: by `draw_turns`.
    """
    drawn = torch.from_numpy(turns).to(poses)
    hidden = torch.linalg.cross(_directions(poses), drawn.new_tensor([0.0, 0.0, 1.0]).expand_as(drawn))
    into_depth = (hidden * drawn).sum(-1, keepdim=True) * hidden
    seen = _ACROSS_VIEW * drawn + (1 - _ACROSS_VIEW) * into_depth
    return PoseErrors(poses, _into_range(poses, seen))


def _draw_turns(rng: np.random.Generator) -> Float[Array, "24 3"]:
    """Return turns of all joints in camera axes, unit size for the shoulder."""
    own = rng.standard_normal((JOINT_COUNT, 3))
    shared = {name: rng.standard_normal(3) for name in ("torso", "left_leg", "right_leg", "left_arm", "right_arm")}
    turns = np.empty((JOINT_COUNT, 3))
    for joint, name in enumerate(JOINT_NAMES):
        side, _, part = name.rpartition("_")
        limb = f"{side}_{_LIMBS[part]}" if side else "torso"
        share = _SHARED_BY_LIMB if side else _SHARED_BY_TORSO
        turns[joint] = _SIZES[part] * (np.sqrt(share) * shared[limb] + np.sqrt(1 - share) * own[joint])
    return turns


def _turned(poses: Float[Tensor, "T 24 3"], turns: Float[Tensor, "A T 24 3"]) -> Float[Tensor, "A T 24 3"]:
    """Return axis-angles of every joint after turning each bone in camera axes."""
    rotations = axis_angle_to_matrix(turns) @ _global_rotations(poses)
    parents = rotations[:, :, list(PARENT_OR_SELF)].clone()
    parents[:, :, 0] = torch.eye(3)
    return matrix_to_axis_angle(parents.transpose(-1, -2) @ rotations)


def _global_rotations(poses: Float[Tensor, "T 24 3"]) -> Float[Tensor, "T 24 3 3"]:
    local = axis_angle_to_matrix(poses)
    chain = [local[:, 0]]
    for joint in range(1, JOINT_COUNT):
        chain.append(chain[PARENTS[joint]] @ local[:, joint])
    return torch.stack(chain, 1)


def _directions(poses: Float[Tensor, "T 24 3"]) -> Float[Tensor, "T 24 3"]:
    """Return unit vectors in camera axes along the bone that each joint turns."""
    rest = poses.new_zeros(JOINT_COUNT, 3)
    for joint, name in enumerate(JOINT_NAMES):
        part = name.rpartition("_")[2]
        if _LIMBS.get(part) == "arm":
            rest[joint, 0] = 1.0
        elif part in ("ankle", "foot"):
            rest[joint, 2] = 1.0
        else:
            rest[joint, 1] = 1.0
    return (_global_rotations(poses) @ rest[:, :, None]).squeeze(-1)


def _excess_of_joints(poses: Float[Tensor, "N 24 3"]) -> Float[Tensor, "N 23"]:
    """Return the anatomical limits' penalty of every single joint below the root; the rest pose breaks no limit."""
    alone = torch.diag_embed(poses[:, 1:].transpose(-1, -2)).permute(0, 2, 3, 1)
    return AnatomicalPrior().limit_penalty(alone.flatten(0, 1)).unflatten(0, (-1, JOINT_COUNT - 1))


def _into_range(poses: Float[Tensor, "T 24 3"], turns: Float[Tensor, "T 24 3"]) -> Float[Tensor, "T 24 3"]:
    """Reverse turns that would break a joint limit, where the reverse breaks it less: a straight knee bends.

    Joints are processed down the chains, since a joint's range is relative to its parent.
    """
    turns = _PROBE_RAD * turns
    for level in _LEVELS:
        reverse = turns.clone()
        reverse[:, level] *= -1
        forth, back = (_excess_of_joints(_turned(poses, each[None])[0]) for each in (turns, reverse))
        flip = (forth > _ALLOWED_EXCESS) & (back < forth)
        for joint in level:
            turns[:, joint] *= torch.where(flip[:, joint - 1], -1.0, 1.0)[:, None]
    return turns / _PROBE_RAD
