"""Features of a fit that predict the errors of its joints; input of `hfb.fitting.confidence`."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT, PARENTS
from hfb.fitting.alternatives import Alternatives
from hfb.fitting.variables import Variables
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.motion.clock import subframe_clock
from hfb.motion.sampled import SampledMotion
from hfb.motion.static_pose import FirstBody
from hfb.objective.objective import Objective
from hfb.rendering.texels import texel_faces, visible_texels
from hfb.typing import Array, Float, Tensor

_FLOOR_M = 0.02
"""Constant added to lengths before the logarithm: smaller differences carry no information."""

_SKIN_TEXELS = 64


def joint_features(
    motion: SampledMotion,
    alternatives: Alternatives | None,
    found: Variables,
    *,
    first_bodies: Sequence[FirstBody],
    coarse: Objective,
    height_told: bool,
) -> dict[str, Float[Array, "R 24"]]:
    """Compute the features; lengths as log(metres + 0.02).

    - ``reach``: way along the skeleton from the pelvis: errors of rotations add up along it.
    - ``motion``: way of the joint about the pelvis during its exposure.
    - ``spread``: root mean square distance of the directions' alternatives, by probability.
    - ``moved``: distance from the first body's joint, about the pelvis, at mid-exposure.
    - ``edge``: |2u - 1|, 0 in the middle of the exposure and 1 at its ends.
    - ``depth``: how far in depth the joint lies from the pelvis: what one view sees worst.
    - ``hidden``: share of the joint's skin that the camera does not see in any sub-frame of the exposure.
    - ``misfit``: log(1 - soft IoU of the re-blurred silhouette and the matte + 0.02).
    - ``unusual``: log of the pose prior's value + 1.
    - ``network``: the joint network's expected error, where the fit used the network.
    - ``told``: 1 where the person's height was given, else 0.

    Args:
        motion: the result.
        alternatives: other directions; None where none were searched, and `spread` is then not among the features.
        found: its polynomials, shape and texture.
        first_bodies: one static body per frame.
        coarse: the objective at a small image size, with the initial mattes: refined ones share the fit's errors.
        height_told: the height was given.
    """
    frames = range(int(motion.frame_index.max()) + 1)
    centred = motion.joints - motion.joints[:, :1]
    table: dict[str, Array] = {"depth": _log_m(np.abs(centred[..., 2]))}
    if alternatives is not None:
        table["spread"] = _log_m(alternatives.spread_m())
    steps = [np.linalg.norm(np.diff(centred[motion.rows_of(frame)], axis=0), axis=-1).sum(0) for frame in frames]
    table["motion"] = _log_m(np.stack(steps))[motion.frame_index]
    firsts = _first_joints(first_bodies, coarse.body)
    middles = np.stack([centred[motion.rows_of(frame)].mean(0) for frame in frames])
    table["moved"] = _log_m(np.linalg.norm(middles - firsts, axis=-1))[motion.frame_index]
    with torch.no_grad():
        shaped = coarse.body.shape(found.betas)
        clock = subframe_clock(coarse.subframes, found.betas.dtype)
        rotations, translations = found.trajectory.at(clock)
        vertices = [shaped.pose(*one).vertices for one in zip(rotations, translations, strict=True)]
        unusual = coarse.pose_prior(matrix_to_axis_angle(rotations[:, :, 1:]).flatten(0, 1)).clamp_min(0)
    seen = np.stack([_seen_skin(one, coarse) for one in vertices])
    table["hidden"] = 1 - seen[motion.frame_index]
    misfit = np.array([_misfit(one, coarse, frame) for frame, one in enumerate(vertices)])
    if coarse.evidence is not None:
        told = coarse.evidence.spread_m(found.joints_at_middle(coarse.body)).double().numpy()
        table["network"] = _log_m(told)[motion.frame_index]
    edge = np.abs(2 * clock.double().numpy() - 1)
    return {
        "reach": _rows(_log_m(_reach_m(shaped.joints))[None], motion),
        **table,
        "edge": _rows(np.tile(edge, len(frames))[:, None], motion),
        "misfit": _rows(np.log(misfit + 0.02)[motion.frame_index][:, None], motion),
        "told": _rows(np.full((1, 1), float(height_told)), motion),
        "unusual": _rows(np.log1p(unusual.double().numpy())[:, None], motion),
    }


def _rows(values: Array, motion: SampledMotion) -> Float[Array, "R 24"]:
    return np.array(np.broadcast_to(values, (len(motion.poses), JOINT_COUNT)), np.float64)


def _log_m(lengths_m: Array) -> Array:
    return np.log(lengths_m + _FLOOR_M)


def _reach_m(rest: Float[Tensor, "24 3"]) -> Float[Array, "24"]:
    """Return the distance along the bones from the pelvis to every joint of the rest pose [m]."""
    joints, reach = rest.double().numpy(), np.zeros(JOINT_COUNT)
    for joint in range(1, JOINT_COUNT):
        parent = PARENTS[joint]
        reach[joint] = reach[parent] + np.linalg.norm(joints[joint] - joints[parent])
    return reach


def _first_joints(first_bodies: Sequence[FirstBody], body: Body) -> Float[Array, "T 24 3"]:
    """Return joints of the first bodies about their pelvis [m]."""
    dtype, out = body.template.dtype, []
    for first in first_bodies:
        shaped = body.shape(first.betas.to(dtype))
        joints = shaped.joints_of(axis_angle_to_matrix(first.pose.to(dtype))[None], first.translation.to(dtype)[None])
        out.append((joints - joints[:, :1])[0].double().numpy())
    return np.stack(out)


def _seen_skin(vertices: Float[Tensor, "S V 3"], coarse: Objective) -> Float[Array, "24"]:
    """Share of each joint's skin that some sub-frame shows; a half for a joint that moves no skin most."""
    texels, mesh = _texel_joints(coarse.body), coarse.body.mesh
    visible = visible_texels(vertices, coarse.observation.camera, mesh, _SKIN_TEXELS).numpy()
    has = np.bincount(texels[texels >= 0], minlength=JOINT_COUNT)
    shown = np.bincount(texels[(texels >= 0) & visible], minlength=JOINT_COUNT)
    return np.where(has > 0, shown / np.maximum(has, 1), 0.5)


@lru_cache(maxsize=4)
def _texel_joints(body: Body) -> Array:
    """Return, for every texel of a small texture, the joint that moves its skin most; -1 between the charts."""
    faces = texel_faces(body.mesh, _SKIN_TEXELS).numpy()
    weights = body.skinning_weights.numpy()[body.mesh.faces.long().numpy()].sum(1)
    return np.where(faces >= 0, weights.argmax(1)[np.maximum(faces, 0)], -1)


def _misfit(vertices: Float[Tensor, "S V 3"], coarse: Objective, frame: int) -> float:
    seen = coarse.observation
    with torch.no_grad():
        alpha = coarse.rasterizer.silhouette_mean(vertices, seen.camera, coarse.body.mesh)
    matte = seen.mattes[frame]
    both, either = torch.minimum(alpha, matte).sum(), torch.maximum(alpha, matte).sum()
    return float(1 - both / either.clamp_min(1e-6))
