"""Choose consistent directions of all limbs in the windows of a clip.

A limb that is reversed during an exposure gives nearly the same image. Overlapping windows must agree in the frame that
they share, and neighbouring frames must be continuous. Dynamic programming takes the directions with the least
contradiction, limb by limb, the torso first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hfb.body.model import ShapedBody
from hfb.fitting.alternatives import LIMB_JOINTS, LIMB_NAMES
from hfb.fitting.clip.windows import WindowFit
from hfb.fitting.reversal import limb_columns, reverse_columns
from hfb.motion.trajectory import Trajectory
from hfb.typing import Array, Bool, Float, Int

_STEP = 0.02
_CLOCK = (-_STEP, 0.0, _STEP, 0.5, 1 - _STEP, 1.0, 1 + _STEP)
_OPENING, _MIDDLE, _CLOSING = 1, 3, 5
_TURN_M = 0.01
"""Cost of reversing a fitted limb, in metres of contradiction."""
_VELOCITY_SHARE = 0.5
"""Weight of a contradiction in velocity [m per exposure] relative to one in place [m]."""


@dataclass(frozen=True)
class Turned:
    """A limb of one frame in one window that was reversed."""

    window: tuple[int, ...]
    frame: int
    limb: str


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Every frame of every window, in the order of the clip; a frame in two windows is two nodes.

    Attributes:
        owner: number of the window.
        place: the frame's place in the window.
        frame: its number in the clip.
        linked: whether a node and the next belong to one segment.
    """

    trajectory: Trajectory
    owner: Int[Array, "N"]
    place: Int[Array, "N"]
    frame: Int[Array, "N"]
    linked: Bool[Array, "n"]


def agree_on_directions(
    fits: Sequence[WindowFit], shaped: ShapedBody, gaps_u: Float[Array, "T"]
) -> tuple[list[WindowFit], tuple[Turned, ...]]:
    """Reverse limbs so that windows agree; returns the windows in the order of the clip, and what was reversed.

    Args:
        fits: fits of one clip, all with one kind, degree and origin of polynomials.
        shaped: the clip's person.
        gaps_u: time from each frame's closing to the next one's opening, in exposures.
    """
    ordered = sorted(fits, key=lambda found: found.frames)
    nodes = _nodes(ordered)
    turned: list[Turned] = []
    trajectory = nodes.trajectory
    for limb, name in enumerate(LIMB_NAMES):
        backwards = torch.zeros(len(nodes.owner), len(LIMB_NAMES), dtype=torch.bool)
        backwards[:, limb] = True
        options = trajectory, reverse_columns(trajectory, limb_columns(backwards))
        joints = np.stack([_joints(one, shaped)[:, :, list(LIMB_JOINTS[limb])] for one in options])
        states = _least_contradiction(joints, nodes, gaps_u)
        turned += [Turned(ordered[nodes.owner[n]].frames, int(nodes.frame[n]), name) for n in np.flatnonzero(states)]
        backwards[:, limb] = torch.from_numpy(states)
        trajectory = reverse_columns(trajectory, limb_columns(backwards))
    return [_with_motion(found, trajectory, nodes, index) for index, found in enumerate(ordered)], tuple(turned)


def _nodes(ordered: Sequence[WindowFit]) -> _Nodes:
    owner = np.concatenate([np.full(len(found.frames), index) for index, found in enumerate(ordered)])
    place = np.concatenate([np.arange(len(found.frames)) for found in ordered])
    frame = np.concatenate([np.array(found.frames) for found in ordered])
    segment = np.concatenate([np.full(len(found.frames), found.segment) for found in ordered])
    motions = [found.trajectory for found in ordered]
    stacked = replace(
        motions[0],
        rotation=torch.cat([motion.rotation for motion in motions]),
        translation=torch.cat([motion.translation for motion in motions]),
    )
    return _Nodes(stacked, owner, place, frame, np.diff(segment) == 0)


def _joints(trajectory: Trajectory, shaped: ShapedBody) -> Float[Array, "N S 24 3"]:
    """Return joints at the instants of `_CLOCK` [m]."""
    with torch.no_grad():
        rotations, translations = trajectory.at(trajectory.rotation.new_tensor(_CLOCK))
        joints = shaped.joints_of(
            rotations.flatten(0, 1).to(shaped.joints), translations.flatten(0, 1).to(shaped.joints)
        )
    return joints.unflatten(0, (-1, len(_CLOCK))).double().numpy()


def _least_contradiction(
    joints: Float[Array, "2 N S j 3"], nodes: _Nodes, gaps_u: Float[Array, "T"]
) -> Bool[Array, "N"]:
    """Return the nodes to reverse, by dynamic programming along the clip; ties stay as fitted."""
    velocity = (joints[:, :, 2::4] - joints[:, :, 0::4]) / (2 * _STEP)  # at the opening and at the closing
    costs, came_from = np.array([0.0, _TURN_M]), []
    for node in range(1, len(nodes.frame)):
        steps = np.zeros((2, 2))
        if nodes.linked[node - 1]:
            same = nodes.frame[node] == nodes.frame[node - 1]
            gap = 0.0 if same else float(gaps_u[nodes.frame[node - 1]])
            for now, before in ((a, b) for a in (0, 1) for b in (0, 1)):
                one, other = joints[before, node - 1], joints[now, node]
                if same:
                    apart = other[[_OPENING, _MIDDLE, _CLOSING]] - one[[_OPENING, _MIDDLE, _CLOSING]]
                    steps[now, before] = np.linalg.norm(apart, axis=-1).mean()
                    continue
                leaving, arriving = velocity[before, node - 1, 1], velocity[now, node, 0]
                met = other[_OPENING] - arriving * gap / 2 - one[_CLOSING] - leaving * gap / 2
                steps[now, before] = np.linalg.norm(met, axis=-1).mean()
                steps[now, before] += _VELOCITY_SHARE * np.linalg.norm(arriving - leaving, axis=-1).mean()
        total = costs[None] + steps
        came_from.append(total.argmin(1))
        costs = total.min(1) + np.array([0.0, _TURN_M])
    states = [int(costs.argmin())]
    for origin in reversed(came_from):
        states.append(int(origin[states[-1]]))
    return np.array(states[::-1], bool)


def _with_motion(found: WindowFit, trajectory: Trajectory, nodes: _Nodes, index: int) -> WindowFit:
    rows = torch.from_numpy(np.flatnonzero(nodes.owner == index))
    motion = replace(found.trajectory, rotation=trajectory.rotation[rows], translation=trajectory.translation[rows])
    return replace(found, trajectory=motion)
