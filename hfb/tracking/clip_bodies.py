"""First bodies of a whole clip: a full search in some frames, their neighbours laid onto the mattes in between.

A search sees one frame and cannot tell front from back in a silhouette; a clip can: people do not turn around between
two frames. What a frame does not show at all is taken from its neighbours, and marked.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.body.skeleton import MIRROR
from hfb.evidence.joint_evidence import predict_joint_evidence
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quaternion,
    in_hemisphere_of,
    matrix_to_axis_angle,
    normalize_quaternion,
    quaternion_to_axis_angle,
)
from hfb.initialization.silhouette_fit import SilhouetteStage, Stay, matte_level, overlap, refine, refine_swept
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.observation import Observation
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Bool, Float, Tensor

_LAY_ON = (SilhouetteStage(64, 25, 0.02, shape=False),)
_STAY = Stay(pose=0.02, root=0.1, place=0.5)
_COMPARE_PX = 64
_STILL_ENOUGH, _CLEARLY_MOVING = 0.5, 0.1  # soft IoU with the matte of a body at rest; what a path must gain over it
_TORSO = (1, 2, 16, 17)
"""Hips and shoulders: where the front is. Arms and legs move, and a search confuses them, whatever the front."""
_DOUBT_M = 0.2
"""What one unit of `front_doubt` weighs, in metres that hips and shoulders move: front and back are 0.3 m apart."""


@dataclass(frozen=True)
class ClipBodies:
    """One body per frame of a clip, as far as there is one.

    Attributes:
        bodies: None where the person is absent.
        filled: frames whose body comes from their neighbours because none was found in them.
    """

    bodies: tuple[FirstBody | None, ...]
    filled: Bool[Array, "T"]

    @property
    def usable(self) -> Bool[Array, "T"]:
        """Frames with a body."""
        return np.array([body is not None for body in self.bodies], bool)


def key_frames(present: Bool[Array, "T"], every: int) -> tuple[int, ...]:
    """Return frames whose body is searched for from scratch: the first and last of every run, and some between.

    Args:
        present: frames in which the person is seen.
        every: at most so many frames from one to the next.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], present, [False]]).astype(np.int8)))
    chosen: list[int] = []
    for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        steps = max(1, -(-(stop - 1 - first) // every))
        chosen += sorted({first + round(step * (stop - 1 - first) / steps) for step in range(steps + 1)})
    return tuple(chosen)


def front_doubt(observation: Observation, first: FirstBody, body: Body) -> float:
    """Return how much more certain the joint network is of a body as found than of its mirror image in depth.

    Args:
        observation: of the body's frame alone.
        first: a body found in one frame.
        body: model of the first bodies.

    Returns:
        the difference of the mean logarithms of the network's own error scales; positive where "as found" is likelier.
    """
    found, mirrored = (
        float(predict_joint_evidence(observation, [one], body).scale.log().mean())
        for one in (first, mirrored_in_depth(first))
    )
    return mirrored - found


def agree_on_front(found: Mapping[int, FirstBody], doubts: Mapping[int, float]) -> dict[int, FirstBody]:
    """Mirror those key frames' bodies in depth that would make the person turn around and back.

    Of all combinations, dynamic programming takes the one with the least movement of hips and shoulders (about the
    pelvis, from key frame to key frame) and the fewest contradictions to the joint network.

    Args:
        found: bodies of the key frames, by frame number.
        doubts: `front_doubt` of every body.
    """
    frames = sorted(found)
    if not frames:
        return {}
    options = [(found[frame], mirrored_in_depth(found[frame])) for frame in frames]
    joints = [[_torso(one) for one in pair] for pair in options]
    extra = [_DOUBT_M * np.array([max(-doubts[frame], 0.0), max(doubts[frame], 0.0)]) for frame in frames]
    costs, came_from = extra[0], []
    for index in range(1, len(frames)):
        steps = np.array(
            [
                [float((joints[index][now] - joints[index - 1][before]).norm(dim=-1).mean()) for before in (0, 1)]
                for now in (0, 1)
            ]
        )
        total = costs[None] + steps
        came_from.append(total.argmin(1))
        costs = total.min(1) + extra[index]
    state = int(costs.argmin())
    states = [state]
    for origin in reversed(came_from):
        state = int(origin[state])
        states.append(state)
    return {frame: pair[state] for frame, pair, state in zip(frames, options, reversed(states), strict=True)}


def mirrored_in_depth(first: FirstBody) -> FirstBody:
    """Mirror a body in the plane of the pelvis, left and right exchanged: from far away it looks the same.

    Args:
        first: a body found in one frame.
    """
    S = torch.diag(first.pose.new_tensor([-1.0, 1.0, 1.0]))
    M = torch.diag(first.pose.new_tensor([1.0, 1.0, -1.0]))
    local = axis_angle_to_matrix(first.pose)[list(MIRROR)]
    turned = S @ local @ S
    turned = torch.cat([(M @ local[0] @ S)[None], turned[1:]])
    return replace(first, pose=matrix_to_axis_angle(turned))


def between(frame: int, known: Mapping[int, FirstBody]) -> FirstBody:
    """Interpolate the body at a frame's time between its known neighbours; the nearest one beyond the ends.

    Args:
        frame: number of the frame.
        known: bodies by frame number, at least one.

    Raises:
        ValueError: none is known.
    """
    if not known:
        raise ValueError("no body is known that could stand in for a missing one")
    before = max((one for one in known if one <= frame), default=None)
    after = min((one for one in known if one >= frame), default=None)
    if before is None or after is None or before == after:
        nearest = before if before is not None else after
        assert nearest is not None
        return replace(known[nearest], source="between" if nearest != frame else known[nearest].source)
    share = (frame - before) / (after - before)
    left, right = known[before], known[after]
    one, other = axis_angle_to_quaternion(left.pose), axis_angle_to_quaternion(right.pose)
    pose = normalize_quaternion((1 - share) * one + share * in_hemisphere_of(other, one))
    return FirstBody(
        pose=quaternion_to_axis_angle(pose),
        translation=(1 - share) * left.translation + share * right.translation,
        betas=(1 - share) * left.betas + share * right.betas,
        source="between",
    )


def body_between(
    frame: int,
    known: Mapping[int, FirstBody],
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer | None = None,
) -> FirstBody:
    """Estimate the body of a frame without a search: its neighbours' (`between`), fitted to the frame's matte.

    Args:
        frame: number of the frame.
        known: bodies by frame number, at least one.
        matte: alpha of the frame.
        camera: of the frame.
        body: model of the first bodies.
        rasterizer: draws silhouettes; the compiled one with exact coverage by default.

    Raises:
        InputError: the matte is empty.
        ValueError: no body is known.
    """
    drawing = rasterizer or make_rasterizer("coverage")
    start = between(frame, known)
    closer = refine(start, matte, camera, body, drawing, list(_LAY_ON), _STAY)
    level = matte_level(matte, camera, _COMPARE_PX)
    best = max((closer, start), key=lambda one: overlap(one, level, body, drawing))
    shared = overlap(best, level, body, drawing)
    before = max((k for k in known if k < frame), default=None)
    after = min((k for k in known if k > frame), default=None)
    if shared >= _STILL_ENOUGH or before is None or after is None:
        return best
    # Somebody who crosses their own width in a frame: laid on along the way from neighbour to neighbour.
    path = (known[after].translation - known[before].translation) / (after - before)
    moving, path = refine_swept(start, path, matte, camera, body, drawing, list(_LAY_ON), _STAY)
    return moving if overlap(moving, level, body, drawing, path) > shared + _CLEARLY_MOVING else best


def fill_missed(found: Mapping[int, FirstBody], present: Bool[Array, "T"], longest_fill: int) -> ClipBodies:
    """Return one body per frame: missed ones from their neighbours in time, and marked.

    Args:
        found: bodies by frame.
        present: frames in which the person is seen: others never get a body.
        longest_fill: of more missed frames in a row none is filled: the clip falls into segments there.
    """
    bodies: list[FirstBody | None] = [found.get(frame) for frame in range(len(present))]
    filled = np.zeros(len(present), bool)
    missed = np.array([here and frame not in found for frame, here in enumerate(present.tolist())], bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missed, [False]]).astype(np.int8)))
    for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        near = {frame: found[frame] for frame in (first - 1, stop) if frame in found}
        if stop - first > longest_fill or not near:
            continue
        for frame in range(first, stop):
            bodies[frame] = between(frame, near)
            filled[frame] = True
    return ClipBodies(tuple(bodies), filled)


def _torso(first: FirstBody) -> Float[Tensor, "4 3"]:
    """Hips and shoulders about the pelvis [m]."""
    body = load_default_body()  # lengths hardly matter here, and every body model has these joints
    shaped = body.shape(torch.zeros(body.shape_count))
    joints = shaped.joints_of(axis_angle_to_matrix(first.pose.float())[None], torch.zeros(1, 3))[0]
    return joints[list(_TORSO)] - joints[0]
