"""Feet that do not sink: a term for a fit whose floor is known beforehand, beside eq. (11).

With d = max(0, -h) of a height h above the floor it is the mean over frames and sub-frames of d^2 / (1 + (d / 0.3)^2)
[m], summed over toes and ankles: a floor that is far off does not pull. Not in the paper. A floor that is estimated
follows from the fit, and does not enter it.
"""

import torch

from hfb.config import FitConfig
from hfb.geometry.placement import Placement, z_up
from hfb.geometry.world import World
from hfb.motion.footing import FEET_AND_ANKLES, SOLES_M
from hfb.objective.own_term import OwnTerm
from hfb.typing import Float, Tensor

_WEIGHT, _REACH_M = 50.0, 0.3


def floor_terms(world: World | None, config: FitConfig) -> tuple[OwnTerm, ...]:
    """Return the term of a stated floor; none without one, or where fits are batches on a device.

    Args:
        world: None where nothing is known of it.
        config: options of the fit.
    """
    if world is None or world.floor is None or config.rasterizer in ("cuda", "warp"):
        return ()
    placed = z_up(world)
    return (OwnTerm("sunk_soles", lambda inputs: sunk_soles(inputs.joints, placed), _WEIGHT),)


def sunk_soles(joints: Float[Tensor, "T S 24 3"], placed: Placement) -> Float[Tensor, ""]:
    """Return the mean squared depth of soles below the floor, which saturates [m^2].

    Args:
        joints: camera coordinates [m].
        placed: from camera coordinates to a world whose floor is at height 0.
    """
    up, offset = joints.new_tensor(placed.R[2]), float(placed.t[2])
    depths = joints.new_tensor(SOLES_M) - joints[..., FEET_AND_ANKLES, :] @ up - offset
    sunk = torch.relu(depths).square()
    return (sunk / (1 + sunk / _REACH_M**2)).sum(-1).mean()
