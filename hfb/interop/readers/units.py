"""The unit of a person's joints, by the lengths of the bones."""

import logging

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import BONES
from hfb.errors import InputError
from hfb.typing import Array, Float

_UNITS = {"metres": 1.0, "centimetres": 100.0, "millimetres": 1000.0}
_SMALLEST, _LARGEST = 0.45, 2.2
"""A person's size over the mean one's; inches and feet lie beyond."""
_log = logging.getLogger(__name__)


def in_metres(joints: Float[Array, "R 24 3"]) -> Float[Array, "R 24 3"]:
    """Convert joints to metres; they stay as they are where too few are known for a bone.

    Args:
        joints: SMPL's, in any place; NaN where unknown.

    Raises:
        InputError: neither metres, nor centimetres, nor millimetres.
    """
    rest = load_default_body(torch.float64).joint_template.numpy()
    parents, children = (list(ends) for ends in zip(*BONES, strict=True))
    lengths = np.linalg.norm(joints[:, children] - joints[:, parents], axis=-1)
    ratios = lengths / np.linalg.norm(rest[children] - rest[parents], axis=-1)
    ratios = ratios[np.isfinite(ratios)]
    if not ratios.size:
        return joints
    ratio = float(np.median(ratios))
    for unit, scale in _UNITS.items():
        if _SMALLEST < ratio / scale < _LARGEST:
            if scale != 1:
                _log.warning("the joints are in %s, by the lengths of their bones: taken as such", unit)
            return joints / scale
    raise InputError(f"its bones are {ratio:.3g} times as long as a person's in metres; give the joints in metres")
