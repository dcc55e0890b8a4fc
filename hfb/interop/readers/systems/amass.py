"""AMASS (SMPL-H and SMPL-X, z up) and plain SMPL motions (y up): poses without a camera.

The body's posture in an upright world is known; the matte determines its position and from which side it is seen. The
file has a clock of its own: `rate_hz` gives the row of a video's frame.
"""

from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.interop.readers.foreign_rotations import turned, y_up_to_camera
from hfb.interop.readers.parts import numbers_at
from hfb.interop.readers.pose_track import PoseTrack
from hfb.interop.readers.smplx import smpl_poses
from hfb.io.safe.contents import array_in, named

SYSTEM = "AMASS"
_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_WIDTHS = (66, 72, 156, 165)
"""66: body joints alone."""
_Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the motion of a file; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    one = named(content)
    if not {"poses", "trans"} <= one.keys() or not any(rate in one for rate in _RATES) or "K" in one:
        return None
    array = array_in(one["poses"])
    if not array.size:
        raise InputError("it holds no pose")
    flat = array.reshape(len(array), -1)
    width = flat.shape[1]
    if width not in _WIDTHS:
        raise InputError(f"its poses have {width} columns; SMPL's have 72, SMPL-H's 156, SMPL-X's 165")
    poses = flat.reshape(-1, 24, 3) if width == 72 else smpl_poses(flat[:, :3], flat[:, 3:66])
    if "fps" not in one or any(rate in one for rate in _RATES[:2]):
        poses = turned(_Y_UP_FROM_Z_UP, poses)
    return [
        PoseTrack(
            SYSTEM, "0", np.arange(len(poses)), poses=y_up_to_camera(poses), turn_is_known=False, rate_hz=_rate_hz(one)
        )
    ]


def _rate_hz(one: dict[str, Any]) -> float:
    name = next(rate for rate in _RATES if rate in one)
    rate_hz = float(numbers_at(one, name, 1)[0])
    if rate_hz <= 0:
        raise InputError(f"its {name} is {rate_hz:g}; give its frames per second")
    return rate_hz
