"""Fit joints as weighted means of vertices, so that they follow the shape."""

import numpy as np

from hfb.training.body.straight_people import MIRROR

PER_OCTANT, RIDGE = 8, 1e-4


def joint_regressor(skin: np.ndarray, skeleton: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """Return (24, V) symmetric weights, rows sum to 1, that reproduce joints and their dependence on betas.

    Ridge regression towards equal weights over vertices all around each joint.

    Args:
        skin: (1 + K, V, 3) the template, then the shape directions [m].
        skeleton: (1 + K, 24, 3) the same of the joints.
        mirror: (V,) index of each vertex's mirror image.
    """
    regressor = np.zeros((skeleton.shape[1], skin.shape[1]))
    for joint, place in enumerate(skeleton[0]):
        if MIRROR[joint] < joint:
            regressor[joint] = regressor[MIRROR[joint]][mirror]
            continue
        near = _around(skin[0], place)
        if MIRROR[joint] == joint:
            near = np.unique(np.concatenate([near, mirror[near]]))
        design = skin[:, near].transpose(0, 2, 1).reshape(-1, len(near))
        target = skeleton[:, joint].reshape(-1)
        # w = 1/m + N z keeps the sum at 1.
        m = len(near)
        null = np.linalg.svd(np.ones((1, m)))[2][1:].T
        a = design @ null
        z = np.linalg.solve(a.T @ a + RIDGE**2 * np.eye(m - 1), a.T @ (target - design.mean(1)))
        regressor[joint, near] = 1 / m + null @ z
        if MIRROR[joint] == joint:
            regressor[joint] = (regressor[joint] + regressor[joint][mirror]) / 2
    return regressor


def _around(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the nearest few vertices in each of the eight octants around a point."""
    away = points - place
    octant = (away > 0) @ np.array([1, 2, 4])
    distance = np.linalg.norm(away, axis=1)
    nearest = np.argsort(distance)
    return np.concatenate([nearest[octant[nearest] == k][:PER_OCTANT] for k in range(8)])
