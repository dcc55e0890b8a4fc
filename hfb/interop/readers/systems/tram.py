"""TRAM: hps/hps_track_k.npy, tensors in a pickle (pred_rotmat, pred_shape, pred_trans, frame), and camera.npy beside.

`pred_trans` is SMPL's translation before the camera of camera.npy (img_focal, img_center). Without that file the focal
length is assumed to be the image's diagonal, TRAM's own first guess.
"""

import math
from typing import Any

import numpy as np

from hfb.errors import InputError
from hfb.interop.readers.foreign_rotations import from_matrices
from hfb.interop.readers.parts import numbers_at
from hfb.interop.readers.pose_track import PoseTrack, pinhole, size_seen
from hfb.io.safe.contents import frame_numbers, named
from hfb.typing import Array, Float

SYSTEM = "TRAM"
CAMERA_FILE = "camera.npy"


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the one person of a track file; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    one = named(content)
    if not {"pred_rotmat", "pred_shape", "pred_trans", "frame"} <= one.keys():
        return None
    frames = numbers_at(one, "frame", None)
    count = len(frames)
    K = np.tile(_camera(named(beside.get(CAMERA_FILE)), size), (count, 1, 1))
    return [
        PoseTrack(
            SYSTEM,
            "0",
            frame_numbers(frames),
            size_seen(K, size),
            poses=from_matrices(numbers_at(one, "pred_rotmat", count, 24, 3, 3, finite=False)),
            trans=numbers_at(one, "pred_trans", count, 1, 3, finite=False)[:, 0],
            betas=numbers_at(one, "pred_shape", count, 10, finite=False),
            K=K,
        )
    ]


def _camera(camera: dict[str, Any], size: tuple[int, int]) -> Float[Array, "3 3"]:
    height, width = size
    if not camera:
        return pinhole(math.hypot(height, width), width / 2, height / 2)
    if not {"img_focal", "img_center"} <= camera.keys():
        raise InputError(f"the {CAMERA_FILE} beside it has no img_focal and img_center")
    cx, cy = numbers_at(camera, "img_center", 2)
    return pinhole(float(numbers_at(camera, "img_focal", 1)[0]), float(cx), float(cy))
