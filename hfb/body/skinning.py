"""Joints along their chains and linear blend skinning in readable torch.

The compiled operators are tested against these functions, which also run where tensors are not in the CPU's memory.
"""

from functools import lru_cache

import torch

from hfb.body.skeleton import ANCESTORS_BY_DOUBLING, JOINT_COUNT, PARENT_OR_SELF
from hfb.kernels.body.body_vector import FEATURES
from hfb.kernels.dispatch import constant
from hfb.typing import Float, Int, Shaped, Tensor


@lru_cache
def chosen(rows: tuple[int, ...], count: int) -> tuple[tuple[float, ...], ...]:
    """Return the matrix that selects rows of `count`: on a GPU the gradient of an index has no fixed summation order.

    Args:
        rows: numbers of the selected rows.
        count: number of rows.
    """
    return tuple(tuple(float(row == column) for column in range(count)) for row in rows)


def place_joints(
    rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"], rest_joints: Float[Tensor, "24 3"]
) -> tuple[Float[Tensor, "S 24 3 4"], Float[Tensor, "S 24 3"]]:
    """Return transforms of the rest body to the world, and the joints: products along the chains (SMPL's eq. 4).

    Args:
        rotations: rotations of each joint in its parent's frame; the root's maps the rest body into the target frame.
        translations: added to everything [m]; the root turns about its own joint, as in SMPL.
        rest_joints: rest joints of the person [m].
    """
    count = rotations.shape[0]
    parents = constant(chosen(PARENT_OR_SELF, JOINT_COUNT), rest_joints.dtype, rest_joints.device)
    bones = torch.cat([rest_joints[:1], (rest_joints - parents @ rest_joints)[1:]])
    offsets = bones.expand(count, -1, -1)
    offsets = torch.cat([offsets[:, :1] + translations[:, None], offsets[:, 1:]], 1)
    upper = torch.cat([rotations, offsets[..., None]], -1)
    bottom = constant((0.0, 0.0, 0.0, 1.0), upper.dtype, upper.device).expand(count, JOINT_COUNT, 1, 4)
    above_root = torch.eye(4, dtype=upper.dtype, device=upper.device).expand(count, 1, 4, 4)
    transforms = torch.cat([torch.cat([upper, bottom], -2), above_root], 1)
    for ancestors in ANCESTORS_BY_DOUBLING:
        above = constant(chosen(ancestors, JOINT_COUNT + 1), upper.dtype, upper.device)
        of_ancestors = torch.einsum("ij,sjrc->sirc", above, transforms)
        # small matrices: a device's matrix products are made for large ones
        transforms = (of_ancestors[..., :, :, None] * transforms[..., None, :, :]).sum(-2)
    T_world_joint = transforms[:, :JOINT_COUNT]
    joints = T_world_joint[:, :, :3, 3]
    # Rest vertices are given about the origin, not about the joint: subtract the rotated rest joint.
    offset = joints - (T_world_joint[:, :, :3, :3] * rest_joints[:, None]).sum(-1)
    return torch.cat([T_world_joint[:, :, :3, :3], offset[..., None]], -1), joints


def blend(feature: Float[Tensor, "S n"], directions: Float[Tensor, "V 3 n"]) -> Float[Tensor, "S V 3"]:
    """Return pose blend shapes (SMPL's eq. 9) [m].

    Args:
        feature: difference of each pose's rotation matrices from the rest pose's.
        directions: displacement of each vertex by each feature [m].
    """
    return (feature @ directions.flatten(0, 1).T).unflatten(1, (-1, 3))


def padded(directions: Float[Tensor, "V 3 n"]) -> tuple[Float[Tensor, "V 3 208"], Float[Tensor, "V 3"]]:
    """Return (numbers, steps) of pose blend shapes without rounding.

    Steps are one; zeros fill up to the number of features that the kernels expect.

    Args:
        directions: displacement of each vertex by each feature [m].
    """
    rows = torch.nn.functional.pad(directions, (0, FEATURES - directions.shape[-1]))
    return rows, rows.new_ones(rows.shape[:-1])


def rounded(directions: Float[Tensor, "V 3 n"]) -> tuple[Shaped[Tensor, "V 3 208"], Float[Tensor, "V 3"]]:
    """Return `padded` in whole numbers of 16 bits: 32,767 of its row's steps where a row is largest.

    Half a step, the largest error, is 1.5e-5 of its row's largest: below a micrometre for displacements of 5 cm.
    float64, which is for exact comparisons, is not rounded.

    Args:
        directions: displacement of each vertex by each feature [m].
    """
    rows, ones = padded(directions)
    if directions.dtype == torch.float64:
        return rows, ones
    most = torch.iinfo(torch.int16).max
    steps = (rows.abs().amax(-1) / most).clamp_min(torch.finfo(rows.dtype).tiny)
    return (rows / steps[..., None]).round().clamp(-most, most).to(torch.int16), steps


def skin(
    T_world_rest: Float[Tensor, "S 24 3 4"],
    rest: Float[Tensor, "V 3"],
    offsets: Float[Tensor, "S V 3"] | None,
    weights: Float[Tensor, "V 24"],
) -> Float[Tensor, "S V 3"]:
    """Apply linear blend skinning (SMPL's eq. 2) to the rest vertices and their pose offsets [m].

    Args:
        T_world_rest: transform of each joint.
        rest: rest vertices [m].
        offsets: pose blend shapes [m].
        weights: skinning weights of each vertex.
    """
    blended = torch.einsum("vj,sjrc->svrc", weights, T_world_rest)
    points = rest.expand(T_world_rest.shape[0], -1, -1) if offsets is None else rest + offsets
    return (blended[..., :3] * points[..., None, :]).sum(-1) + blended[..., 3]


def sparse_weights(weights: Float[Tensor, "V 24"]) -> tuple[Int[Tensor, "V1"], Int[Tensor, "n"], Float[Tensor, "n"]]:
    """Return (starts, joints, weights): vertex v has the joints joints[starts[v]:starts[v + 1]] with these weights.

    Args:
        weights: skinning weights of each vertex.
    """
    vertices, joints = weights.nonzero(as_tuple=True)
    starts = torch.zeros(len(weights) + 1, dtype=torch.int64)
    starts[1:] = torch.bincount(vertices, minlength=len(weights)).cumsum(0)
    return starts.to(torch.int32), joints.to(torch.int32), weights[vertices, joints].contiguous()
