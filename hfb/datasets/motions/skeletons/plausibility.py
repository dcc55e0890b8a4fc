"""Impossible joints of a retargeted motion, a sign of misread axes or a broken recording."""

import numpy as np
import torch

from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.geometry.quaternions import from_axis_angle, multiply
from hfb.priors.anatomy import AnatomicalPrior
from hfb.typing import Array, Bool, Float

_IMPOSSIBLE = np.deg2rad(45)
"""Excess of the usual range of motion; fights and acrobatics stay below in most of their frames."""
_AROUND = np.cos(np.deg2rad(100) / 2)
"""Nobody's head is turned farther against the chest."""
_MOSTLY = 0.5
_ENDS = ("neck", "head", "left_ankle", "right_ankle", "left_foot", "right_foot", "left_wrist", "right_wrist")
"""No other joint hangs from how these are turned, so that they may be left at rest."""
_LOOKED_AT = 2000


def impossible_joints(poses: Float[Array, "F 24 3"]) -> Bool[Array, "24"]:
    """Return the joints that are far beyond a person's range of motion in most frames; the root never is.

    Args:
        poses: axis-angle [rad].
    """
    some = poses[:: -(-len(poses) // _LOOKED_AT)]
    beyond = AnatomicalPrior().beyond_limits(torch.from_numpy(some[:, 1:]).double()).numpy() > _IMPOSSIBLE
    found = np.concatenate([[False], beyond.mean(0) > _MOSTLY])
    neck, head = JOINT_NAMES.index("neck"), JOINT_NAMES.index("head")
    nod = multiply(from_axis_angle(some[:, neck]), from_axis_angle(some[:, head]))  # shared by both
    found[[neck, head]] |= bool((np.abs(nod[:, 0]) < _AROUND).mean() > _MOSTLY)
    return found


def without_impossible_ends(poses: Float[Array, "F 24 3"]) -> tuple[Float[Array, "F 24 3"], tuple[str, ...]]:
    """Return the motion with impossible heads, hands and feet left at rest, and the names of these.

    Args:
        poses: axis-angle [rad].

    Raises:
        InputError: a limb or the trunk is impossible, so that its joints are in wrong places.
    """
    names = tuple(JOINT_NAMES[joint] for joint in np.flatnonzero(impossible_joints(poses)))
    broken = [name for name in names if name not in _ENDS]
    if broken:
        raise InputError(
            f"in most of its frames {', '.join(broken)} {'are' if len(broken) > 1 else 'is'} turned as no person can; "
            "check that left and right are named so and that all of it was exported, or leave the file out"
        )
    kept = poses.copy()
    kept[:, [JOINT_NAMES.index(name) for name in names]] = 0.0
    return kept, names
