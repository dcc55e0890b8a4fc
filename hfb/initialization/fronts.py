"""Which way a person faces: bodies mirrored in depth, how sure a front is, and frames that agree on one.

A silhouette shows no front, and pose networks mistake it on blurred images. Where the joint network doubts a front, the
mirror image is laid onto the matte too, and both are fitted (`hfb.fitting.front_choice`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.body.skeleton import MIRROR
from hfb.evidence.joint_evidence import predict_joint_evidence
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.silhouette_fit import SilhouetteStage, Stay, refine
from hfb.motion.static_pose import FirstBody, OtherFront
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.observation import Observation
from hfb.typing import Float, Tensor

_TORSO = (1, 2, 16, 17)
"""Hips and shoulders: where the front is. Arms and legs move, and a search confuses them, whatever the front."""
_DOUBT_M = 0.2
"""What one unit of `front_doubts` weighs, in metres that hips and shoulders move: front and back are 0.3 m apart."""
SURE_DOUBT = 0.6
"""`front_doubts`, per frame, from which on the front of a start was never wrong."""
_LAY_ON = (SilhouetteStage(64, 40, 0.02, shape=False), SilhouetteStage(128, 30, 0.015))
_STAY = Stay(pose=0.01, root=0.05, place=0.5)


def front_doubts(observation: Observation, first_bodies: Sequence[FirstBody], body: Body) -> Float[Tensor, "T"]:
    """Return how much surer the joint network is of each body than of its mirror image in depth.

    Args:
        observation: of the bodies' frames.
        first_bodies: one per frame.
        body: the body model.

    Returns:
        the difference of the mean logarithms of the network's own error scales; positive where "as found" is likelier.
    """
    turned = [mirrored_in_depth(first) for first in first_bodies]
    found, mirrored = (
        predict_joint_evidence(observation, bodies, body).scale.log().mean((1, 2)) for bodies in (first_bodies, turned)
    )
    return mirrored - found


def find_other_front(
    observation: Observation,
    first_bodies: Sequence[FirstBody],
    body: Body,
    sure: float = SURE_DOUBT,
    enabled: bool = True,
) -> OtherFront | None:
    """Return the bodies that face the other way, laid onto the mattes; None where the front is sure.

    Simulated starts err, but never by their front.

    Args:
        observation: of all frames.
        first_bodies: one per frame, agreed on one front.
        body: the body model.
        sure: mean of `front_doubts` from which on the front is not in doubt.
        enabled: `both_fronts` of the fit's options; None is returned without it.

    Raises:
        InputError: a matte is empty.
    """
    if not enabled or all(first.source == "simulated" for first in first_bodies):
        return None
    doubt = float(front_doubts(observation, first_bodies, body).mean())
    if doubt >= sure:
        return None
    turned = (lay_on_mirrored(first, observation, frame, body) for frame, first in enumerate(first_bodies))
    return OtherFront(tuple(turned), doubt)


def lay_on_mirrored(first: FirstBody, observation: Observation, frame: int, body: Body) -> FirstBody:
    """Return a body's mirror image in depth, laid onto the matte of its frame.

    Args:
        first: the body as found.
        observation: holds the frame.
        frame: its number.
        body: the body model.

    Raises:
        InputError: the matte is empty.
    """
    matte, drawing = observation.mattes[frame].numpy(), make_rasterizer("coverage")
    return refine(mirrored_in_depth(first), matte, observation.camera, body, drawing, _LAY_ON, _STAY)


def agree_on_front(found: Mapping[int, FirstBody], doubts: Mapping[int, float]) -> dict[int, FirstBody]:
    """Mirror those key frames' bodies in depth that would make the person turn around and back.

    Of all combinations, dynamic programming takes the one with the least movement of hips and shoulders (about the
    pelvis, from key frame to key frame) and the fewest contradictions to the joint network.

    Args:
        found: bodies of the key frames, by frame number.
        doubts: `front_doubts` of every body.
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


def _torso(first: FirstBody) -> Float[Tensor, "4 3"]:
    """Hips and shoulders about the pelvis [m]."""
    body = load_default_body()  # lengths hardly matter here, and every body model has these joints
    shaped = body.shape(torch.zeros(body.shape_count))
    joints = shaped.joints_of(axis_angle_to_matrix(first.pose.float())[None], torch.zeros(1, 3))[0]
    return joints[list(_TORSO)] - joints[0]
