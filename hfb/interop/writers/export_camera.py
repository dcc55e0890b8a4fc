"""The motion's camera for other programs: its field of view, and where the optical axis lies in the image."""

import math

import torch

from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.motion.sampled import SampledMotion

_SHORTEST_FOCAL_PX = 1e-3
NEAR_M = 0.1
"""Distance at which cameras begin to see."""

_FAR_M, _BEYOND = 100.0, 10.0


def camera_of(motion: SampledMotion) -> PinholeCamera:
    """Return the camera; of a motion without the image's size the optical axis is taken to pass through the middle.

    Args:
        motion: camera coordinates.

    Raises:
        InputError: its K has no focal length.
    """
    K = torch.from_numpy(motion.K)
    if min(K[0, 0], K[1, 1]) < _SHORTEST_FOCAL_PX:
        raise InputError("the motion's K has no focal length: it is damaged; make it again with `hfb fit`")
    width, height = motion.size or tuple(max(1, round(2 * float(middle))) for middle in K[:2, 2])
    return PinholeCamera.from_matrix(K, height, width)


def far_m(motion: SampledMotion) -> float:
    """Return a distance behind everything that belongs to the motion [m].

    Args:
        motion: camera coordinates.
    """
    return max(_FAR_M, _BEYOND * float(motion.joints[..., 2].max()))


def field_of_view(camera: PinholeCamera) -> float:
    """Return the vertical angle of view [rad], as if the optical axis passed through the image's middle.

    Args:
        camera: the camera.
    """
    return 2 * math.atan(camera.height / (2 * camera.fy))


def aspect_ratio(camera: PinholeCamera) -> float:
    """Return the width over the height of what the camera sees.

    Args:
        camera: the camera.
    """
    return (camera.width / camera.fx) / (camera.height / camera.fy)


def lens_shift(camera: PinholeCamera) -> tuple[float, float]:
    """Return how far the image's middle is right of and above the optical axis, in heights of the image.

    These are `shift_x` and `shift_y` of a camera in Blender whose sensor fits vertically.

    Args:
        camera: the camera.
    """
    right = (camera.width / 2 - camera.cx) / camera.fx * camera.fy
    return right / camera.height, (camera.cy - camera.height / 2) / camera.height
