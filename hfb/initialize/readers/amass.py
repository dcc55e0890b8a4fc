"""AMASS (SMPL-H and SMPL-X, z up) and plain SMPL motions (y up): poses without a camera.

How the body stands in an upright world is known; from where it is seen and where it stands, the matte must tell.
"""

from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.initialize.readers.contents import array_in, named, numbers
from hfb.initialize.readers.pose_track import PoseTrack
from hfb.initialize.readers.rotations import turned, y_up_to_camera
from hfb.initialize.readers.smplx import smpl_poses

SYSTEM = "AMASS"
_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """The motion of a file; None where it is something else."""
    one = named(content)
    if not {"poses", "trans"} <= one.keys() or not any(rate in one for rate in _RATES) or "K" in one:
        return None
    given = array_in(one["poses"])
    if not given.size:
        raise InputError("it holds no pose")
    flat = numbers(given.reshape(len(given), -1), None, None)
    width = flat.shape[1]
    poses = flat.reshape(-1, 24, 3) if width == 72 else smpl_poses(flat[:, :3], flat[:, 3:66])
    if "fps" not in one or any(rate in one for rate in _RATES[:2]):
        poses = turned(_Y_UP_FROM_Z_UP, poses)
    return [PoseTrack(SYSTEM, "0", np.arange(len(poses)), poses=y_up_to_camera(poses), turn_is_known=False)]
