"""SMPL-X (and SMPL-H) poses as SMPL's, which shares their pelvis and first 21 joints."""

import numpy as np

from hfb.typing import Array, Float

_REST_PELVIS_M = np.array([0.003, -0.351, 0.012])
"""About where SMPL-X's mean shape has its root joint."""


def smpl_poses(root: Float[Array, "R 3"], body: Float[Array, "R 63"]) -> Float[Array, "R 24 3"]:
    """Return axis-angles of 24 joints, hands at rest.

    Args:
        root: axis-angle [rad].
        body: axis-angles of 21 joints [rad].
    """
    poses = np.zeros((len(root), 24, 3))
    poses[:, 0], poses[:, 1:22] = root, body.reshape(-1, 21, 3)
    return poses


def smplx_pelvis(translation: Float[Array, "R 3"]) -> Float[Array, "R 3"]:
    """Return the root joint of a SMPL-X translation [m]: within about 2 cm, since the shape moves it too.

    Args:
        translation: SMPL-X's [m].
    """
    return translation + _REST_PELVIS_M
