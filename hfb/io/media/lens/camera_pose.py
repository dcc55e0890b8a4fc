"""How the camera stands in the world: options, clip.toml, or the calibration file that it names."""

import cv2
import numpy as np

from hfb.config import CameraConfig
from hfb.errors import InputError
from hfb.geometry.placement import row_of, rows_of, up_of_angles, world_of_pose, world_of_up
from hfb.geometry.world import Row, Rows, World, rotation_fault
from hfb.io.clip import ClipCamera
from hfb.io.media.lens.clip_lens import choose_camera, find_entry, flat_numbers
from hfb.io.media.lens.lens_models import plain

_ROTATION = ("rotation", "rworldtocam", "rotationmatrix", "rotationvector", "rvec", "r")
_TRANSLATION = ("translation", "tworldtocam", "translationvector", "tvec", "t")
# R alone is a rectification.
_LIKE_A_POSE = ("rvec", "tvec", "rotation", "translation", "extrinsic", "pose", "worldtocam")
FARTHEST_M = 100.0
"""Translations beyond it are in other units, such as a board's millimetres: then only the rotation counts."""


def clip_world(options: CameraConfig, camera: ClipCamera, video: str) -> World | None:
    """Return the world of exports; None where nothing is known of it.

    Args:
        options: options of the camera; they win over clip.toml.
        camera: entries of clip.toml, which win over its calibration file.
        video: the footage's file name: a calibration of several cameras is searched by it where no name is given.

    Raises:
        InputError: as `calibrated_pose`.
    """
    for tilt, roll in ((options.tilt_deg, options.roll_deg), (camera.tilt_deg, camera.roll_deg)):
        if tilt is not None or roll is not None:
            return world_of_up(up_of_angles(tilt or 0.0, roll or 0.0))
    pose = calibrated_pose(camera, video)
    if pose is None:
        return None
    rotation, translation = np.array(pose[0], np.float64), np.array(pose[1], np.float64)
    up = options.world_up or camera.world_up or "z"
    if float(np.linalg.norm(translation)) > FARTHEST_M:
        return world_of_pose(rotation, np.zeros(3), up).model_copy(update={"source": "rotation"})
    return world_of_pose(rotation, translation, up)


def calibrated_pose(camera: ClipCamera, video: str) -> tuple[Rows, Row] | None:
    """Return rotation and translation, x = R X + t, of a clip's camera; None where they are not given.

    A camera without rotation in the origin is what files hold that know no pose; it is taken as none.

    Args:
        camera: entries of clip.toml.
        video: as of `clip_world`.

    Raises:
        InputError: the calibration is missing, damaged, has no such camera, or its rotation is none.
    """
    if camera.rotation is not None and camera.translation is not None:
        return camera.rotation, camera.translation
    if camera.calibration is None:
        return None
    where, entries = choose_camera(camera.calibration, camera.name, video)
    found = [find_entry(entries, names) for names in (_ROTATION, _TRANSLATION)]
    if found[0] is None or found[1] is None:
        return None
    turn, place = (flat_numbers(one.get("data") if isinstance(one, dict) else one, where) for one in found)
    if turn.size not in (3, 9) or place.size != 3 or not np.isfinite([*turn, *place]).all():
        raise InputError(f"{where}: its rotation must be 3 or 9 finite numbers and its translation 3; export it again.")
    R = turn.reshape(3, 3) if turn.size == 9 else np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    if fault := rotation_fault(rows_of(R)):
        raise InputError(f"{where}: its rotation {fault}.")
    if not place.any() and np.array_equal(R, np.eye(3)):
        return None
    return rows_of(R), row_of(place)


def pose_remarks(camera: ClipCamera, video: str) -> tuple[str, ...]:
    """Return a sentence for the user if a calibration has entries like a pose, and no pose that is read.

    Args:
        camera: entries of clip.toml.
        video: as of `clip_world`.

    Raises:
        InputError: the calibration is missing, damaged, or has no such camera.
    """
    if camera.calibration is None or camera.rotation is not None:
        return ()
    where, entries = choose_camera(camera.calibration, camera.name, video)
    if all(find_entry(entries, names) is not None for names in (_ROTATION, _TRANSLATION)):
        return ()
    named = [key for key in entries if key.isprintable() and any(word in plain(key) for word in _LIKE_A_POSE)]
    if not named:
        return ()
    verb = "is" if len(named) == 1 else "are"
    return (
        f"{where}: {' and '.join(named[:4])} {verb} not taken as the camera's pose, which is a "
        "rotation (rotation, R_world_to_cam, rotation_matrix, rotation_vector, rvec or R) together with a translation "
        "(translation, t_world_to_cam, translation_vector, tvec or t): give both under such names",
    )
