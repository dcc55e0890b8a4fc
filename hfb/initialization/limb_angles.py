"""Joint angles from joints in closed form, a close start for registration.

Down the tree, every joint is turned so that its child bones point in their observed directions (Kabsch, the best
rotation between two sets of vectors). A bent elbow or knee determines the twist of its upper limb, too.
"""

import torch

from hfb.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hfb.geometry.procrustes import nearest_rotations
from hfb.typing import Bool, Float, Tensor

_CHILDREN = tuple(tuple(child for child, parent in enumerate(PARENTS) if parent == joint) for joint in range(24))
_PELVIS = [JOINT_NAMES.index(name) for name in ("pelvis", "left_hip", "right_hip", "spine1")]
_SHOULDERS = [JOINT_NAMES.index(name) for name in ("left_shoulder", "right_shoulder")]
# Upper limb, its hinge joint, the hinge's axis in the rest pose, about which it bends by a positive angle.
_HINGES = {
    JOINT_NAMES.index("left_hip"): (JOINT_NAMES.index("left_knee"), (1.0, 0.0, 0.0)),
    JOINT_NAMES.index("right_hip"): (JOINT_NAMES.index("right_knee"), (1.0, 0.0, 0.0)),
    JOINT_NAMES.index("left_shoulder"): (JOINT_NAMES.index("left_elbow"), (0.0, -1.0, 0.0)),
    JOINT_NAMES.index("right_shoulder"): (JOINT_NAMES.index("right_elbow"), (0.0, 1.0, 0.0)),
}
_BENT = 0.25
"""Sine of the angle above which a hinge's axis is determined."""


def rotations_from_joints(
    joints: Float[Tensor, "S 24 3"], rest: Float[Tensor, "24 3"], natural: Float[Tensor, "24 3 3"]
) -> Float[Tensor, "S 24 3 3"]:
    """Return the rotation of every joint in its parent's frame.

    Args:
        joints: [m], NaN where unknown, in the same rows for all instants or not.
        rest: the rest pose's joints [m].
        natural: for joints of which nothing is known.
    """
    known = torch.isfinite(joints).all(-1)
    seen = torch.where(known[..., None], joints, torch.zeros_like(joints))
    local = natural.expand(len(joints), -1, -1, -1).clone()
    world = local.clone()
    for joint in range(JOINT_COUNT):
        above = world[:, PARENTS[joint]] if joint else torch.eye(3, dtype=joints.dtype).expand(len(joints), 3, 3)
        rest_bones, bones, weight = _bones(joint, seen, rest, known, above)
        pinned = weight.sum(1) > 0
        turn = kabsch(rest_bones, bones, weight)
        local[pinned, joint] = turn[pinned]
        world[:, joint] = above @ local[:, joint]
    return local


def kabsch(
    rest: Float[Tensor, "S n 3"], seen: Float[Tensor, "S n 3"], weight: Float[Tensor, "S n"]
) -> Float[Tensor, "S 3 3"]:
    """Return the rotations R that minimise sum w |R rest - seen|^2; the smallest one where several do.

    Args:
        rest: vectors of the rest pose.
        seen: the same vectors, rotated.
        weight: weight of every vector.
    """
    product = (seen * weight[..., None]).transpose(1, 2) @ rest
    # A small identity term resolves the ambiguity: the twist about a single bone is zero.
    scale = product.flatten(1).norm(dim=1).clamp_min(1e-9)
    swing = _shortest(rest, seen, weight)
    return nearest_rotations(product + 1e-4 * scale[:, None, None] * swing)


def _shortest(
    rest: Float[Tensor, "S n 3"], seen: Float[Tensor, "S n 3"], weight: Float[Tensor, "S n"]
) -> Float[Tensor, "S 3 3"]:
    """Return the rotation from the mean rest vector to the mean observed one in their common plane."""
    before, after = (
        torch.nn.functional.normalize((vectors * weight[..., None]).sum(1), dim=-1) for vectors in (rest, seen)
    )
    cosine = (before * after).sum(-1)[:, None, None]
    cross = torch.linalg.cross(before, after)
    zero = torch.zeros_like(cross[:, 0])
    x, y, z = cross.unbind(-1)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    return torch.eye(3, dtype=rest.dtype) + skew + skew @ skew / (1 + cosine).clamp_min(0.05)


def _bones(
    joint: int,
    seen: Float[Tensor, "S 24 3"],
    rest: Float[Tensor, "24 3"],
    known: Bool[Tensor, "S 24"],
    above: Float[Tensor, "S 3 3"],
) -> tuple[Float[Tensor, "S n 3"], Float[Tensor, "S n 3"], Float[Tensor, "S n"]]:
    """Return vectors that start at a joint, at rest and observed, in the parent's frame, with weights."""
    if joint == 0:
        return _trunk(seen, rest, known)
    ends = _CHILDREN[joint]
    if not ends:
        nothing = seen.new_zeros(len(seen), 1, 3)
        return nothing, nothing, nothing[..., 0]
    at_rest = torch.stack([rest[end] - rest[joint] for end in ends])
    now = torch.stack([seen[:, end] - seen[:, joint] for end in ends], 1)
    weight = torch.stack([known[:, end] & known[:, joint] for end in ends], 1).to(seen.dtype)
    if joint in _HINGES:
        hinge, axis = _HINGES[joint]
        (tip,) = _CHILDREN[hinge]
        upper = torch.nn.functional.normalize(seen[:, hinge] - seen[:, joint], dim=-1)
        lower = torch.nn.functional.normalize(seen[:, tip] - seen[:, hinge], dim=-1)
        normal = torch.linalg.cross(upper, lower)
        sine = normal.norm(dim=-1)
        told = (sine > _BENT) & known[:, joint] & known[:, hinge] & known[:, tip]
        length = at_rest.norm(dim=-1).mean()
        at_rest = torch.cat([at_rest, at_rest.new_tensor(axis)[None] * length])
        now = torch.cat([now, (normal / sine.clamp_min(1e-6)[:, None] * length)[:, None]], 1)
        weight = torch.cat([weight, 0.3 * told.to(weight.dtype)[:, None]], 1)
    local = (above.transpose(1, 2)[:, None] @ now[..., None]).squeeze(-1)
    return at_rest.expand(len(seen), -1, -1), local, weight


def _trunk(
    seen: Float[Tensor, "S 24 3"], rest: Float[Tensor, "24 3"], known: Bool[Tensor, "S 24"]
) -> tuple[Float[Tensor, "S n 3"], Float[Tensor, "S n 3"], Float[Tensor, "S n"]]:
    """Return points about their middle, for the root: its own bones, or hips and shoulders where those are unknown."""
    own = known[:, _PELVIS].all(1, keepdim=True)
    members = torch.tensor([*_PELVIS, *_SHOULDERS])
    counts = torch.cat([known[:, _PELVIS], known[:, _SHOULDERS] & ~own], 1)
    weight = counts.to(seen.dtype) * (counts.sum(1, keepdim=True) >= 3)
    total = weight.sum(1, keepdim=True).clamp_min(1)[..., None]
    before, now = rest[members].expand(len(seen), -1, -1), seen[:, members]
    middles = ((points * weight[..., None]).sum(1, keepdim=True) / total for points in (before, now))
    return before - next(middles), now - next(middles), weight
