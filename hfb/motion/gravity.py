"""Which way is up, from a person who walks.

Feet that stand still lie in the floor; the trunk is about upright. The direction u makes the sum of
(u . (p - mean p))^2 / sigma_p^2 over contacts p plus sin(angle of u and trunk)^2 / sigma_t^2 smallest, which is an
eigenvector; the other eigenvalues are the inverse variances of u along both other axes. Footprints on a line leave the
axis across it to the trunk alone, which is not good enough.
"""

import math

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.geometry.placement import world_of_up
from hfb.geometry.world import World
from hfb.motion.footing import FEET, standing_feet
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool, Float

_PELVIS, _NECK = JOINT_NAMES.index("pelvis"), JOINT_NAMES.index("neck")
_CONTACT_M, _TRUNK_RAD = 0.04, math.radians(8)
_LEAST_CONTACTS = 3
_PRINT_M = 0.2  # footprints of one foot are further apart
_SURE_RAD, _ACROSS_RAD, _AGREE_RAD = math.radians(2), math.radians(6.5), math.radians(15)


def find_world(motion: SampledMotion, told: World | None) -> World | None:
    """Return the world that is told; where nothing tells which way is up, that of a walk, with the floor asked for.

    Args:
        motion: camera coordinates.
        told: the clip's.
    """
    if told is not None and (told.source != "level" or told.floor is not None):
        return told
    walked = world_of_walk(motion)
    return walked.model_copy(update={"floor_source": told.floor_source}) if walked and told else walked or told


def world_of_walk(motion: SampledMotion) -> World | None:
    """Return the world of a person who walks; None where feet and trunk do not tell it to a few degrees.

    Args:
        motion: camera coordinates.
    """
    trunks = motion.joints[:, _NECK] - motion.joints[:, _PELVIS]
    trunk = (trunks / np.linalg.norm(trunks, axis=-1, keepdims=True)).mean(0)
    trunk /= np.linalg.norm(trunk)
    contacts = _contacts(motion, standing_feet(motion, trunk))
    if len(contacts) < _LEAST_CONTACTS:
        return None
    apart = contacts - contacts.mean(0)
    spread = apart.T @ apart
    values, vectors = np.linalg.eigh(spread / _CONTACT_M**2 + (np.eye(3) - np.outer(trunk, trunk)) / _TRUNK_RAD**2)
    across, along = 1 / np.sqrt(values[1:] - values[0])
    if along > _SURE_RAD or across > _ACROSS_RAD:
        return None
    up = vectors[:, 0] * np.sign(vectors[:, 0] @ trunk)
    off = math.sqrt(float(up @ spread @ up) / (len(contacts) - 2))
    if off > 2 * _CONTACT_M or up @ trunk < math.cos(_AGREE_RAD):
        return None
    return world_of_up(up, by_person=True)


def _contacts(motion: SampledMotion, standing: Bool[Array, "R 2"]) -> Float[Array, "C 3"]:
    """Return the mean place of a foot at each of its footprints."""
    places = []
    for foot, down in zip(FEET, standing.T, strict=True):
        steps = motion.joints[down, foot]
        new = np.flatnonzero(np.linalg.norm(np.diff(steps, axis=0), axis=-1) > _PRINT_M) + 1
        places += [part.mean(0) for part in np.split(steps, new) if len(part)]
    return np.array(places).reshape(-1, 3)
