"""Forward kinematics of the SMPL skeleton in numpy: rotations from and to the world's frame, joint positions."""

from functools import lru_cache

import numpy as np

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_COUNT, PARENTS
from hfb.geometry.quaternions import conjugate, multiply, rotate
from hfb.typing import Array, Float


@lru_cache(maxsize=1)
def rest_joints() -> Float[Array, "24 3"]:
    """Return the joints of the embedded body at rest [m], whose proportions retargeted motions get."""
    return load_default_body().joint_template.double().numpy()


def to_world(local: Float[Array, "F 24 4"]) -> Float[Array, "F 24 4"]:
    """Convert rotations in the parent joint's frame to rotations in the world's.

    Args:
        local: rotations in the parent joint's frame (w, x, y, z).
    """
    world = local.copy()
    for joint in range(1, JOINT_COUNT):
        world[:, joint] = multiply(world[:, PARENTS[joint]], local[:, joint])
    return world


def to_local(world: Float[Array, "F 24 4"]) -> Float[Array, "F 24 4"]:
    """Invert `to_world`.

    Args:
        world: rotations in the world's frame (w, x, y, z).
    """
    above = conjugate(world[:, PARENTS[1:]])
    return np.concatenate([world[:, :1], multiply(above, world[:, 1:])], 1)


def joint_positions(
    world: Float[Array, "F 24 4"], translations: Float[Array, "F 3"], rest: Float[Array, "24 3"]
) -> Float[Array, "F 24 3"]:
    """Return joints [m] of a person with these rest joints; the root's is at its rest position plus the translation.

    Args:
        world: rotations in the world's frame (w, x, y, z).
        translations: translations of the root [m].
        rest: rest joints [m].
    """
    places = [rest[0] + translations]
    for joint in range(1, JOINT_COUNT):
        parent = PARENTS[joint]
        places.append(places[parent] + rotate(world[:, parent], rest[joint] - rest[parent]))
    return np.stack(places, 1)
