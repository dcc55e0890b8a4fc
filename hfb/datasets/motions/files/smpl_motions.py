"""Motions that are in a SMPL layout already: AMASS (SMPL-H, SMPL-X, SMPL), hfb's own, and plain SMPL poses.

The keys determine the world's axes: `mocap_framerate` or `mocap_frame_rate` mark AMASS, whose z axis points up; `fps` a
plain file with y up; `times_s` one of hfb's own, in camera coordinates (y down). Turning the world about the origin
would also change SMPL's translation by a constant that depends on the person's rest pelvis, since SMPL's root turns
about that joint. This constant is ignored, since a clip's position in the world has no meaning.
"""

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from hfb.datasets.motions.files.npz import read_npz
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.errors import InputError
from hfb.geometry.quaternions import align_signs, from_axis_angle, multiply, rotate, to_axis_angle
from hfb.typing import Array, Float, Shaped

_log = logging.getLogger(__name__)
_POSES = ("poses", "root_orient", "pose_body")
_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_WANTED = (*_POSES, *_RATES, "trans", "times_s")
_EXPECTED = (
    "AMASS: poses (F,156), (F,165) or (F,72), or root_orient (F,3) and pose_body (F,63), with trans (F,3) and "
    "mocap_framerate or mocap_frame_rate; plain SMPL: poses (F,72), trans, fps; hfb: poses (F,72), trans, times_s"
)
_BODY_COLUMNS = 66
"""SMPL-H and SMPL-X share SMPL's pelvis and first 21 joints; their next joints are fingers, jaw and eyes."""
_COLUMNS = {72: 72, 156: _BODY_COLUMNS, 165: _BODY_COLUMNS, 66: _BODY_COLUMNS}
_MAX_FPS = 10_000.0
_MAX_FRAMES = 2_000_000
_MAX_PLACE_M = 1e5
_FASTEST_M_S = 30.0
_UPRIGHT = 0.8  # cosine

_Z_UP = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])
_Y_DOWN = np.array([0.0, 1.0, 0.0, 0.0])
"""Rotations (w, x, y, z) from a world with z up, and from the camera's frame, to one with y up."""


def load_smpl_motion(path: Path, name: str) -> MotionClip:
    """Read one file; hands of SMPL-H and SMPL-X are left at rest.

    Args:
        path: the .npz.
        name: name of the motion.

    Raises:
        InputError: damaged, an unknown layout (the text names the keys), too short or not finite.
    """
    arrays, names = read_npz(path, _WANTED)
    poses = _poses(arrays)
    rates = [arrays[key] for key in _RATES if key in arrays]
    if poses is None or "trans" not in arrays or not (rates or "times_s" in arrays):
        raise InputError(
            f"{path} holds no motion that hfb knows: it has {', '.join(names)[:300]}; expected is {_EXPECTED}"
        )
    trans = arrays["trans"].astype(np.float64)
    if "times_s" in arrays:
        return uniform_clip(name, path, poses, trans, arrays["times_s"].astype(np.float64), _Y_DOWN)
    if rates[0].size != 1:
        raise InputError(f"{path} has {rates[0].size} frame rates; expected is one number")
    world = None if "fps" in arrays and len(rates) == 1 else _Z_UP
    clip = check_clip(name, path, poses, trans, float(rates[0].reshape(())), world)
    along_y = rotate(from_axis_angle(poses[:, :3]), np.array([0.0, 1.0, 0.0]))[:, 1]
    if world is not None and np.median(along_y) > _UPRIGHT:
        _log.warning("%s: its person lies, along y: name its rate fps if y is up in its world", name)
    return clip


def _poses(arrays: Mapping[str, Shaped[Array, "..."]]) -> Float[Array, "F c"] | None:
    """Return poses as (F, 66) or (F, 72) columns; None where they are of no known shape."""
    if "poses" in arrays:
        poses = arrays["poses"]
        width = int(np.prod(poses.shape[1:]))
        if poses.ndim not in (2, 3) or width not in _COLUMNS:
            return None
        return poses.reshape(len(poses), width)[:, : _COLUMNS[width]].astype(np.float64)
    if "root_orient" not in arrays or "pose_body" not in arrays:
        return None
    root, body = arrays["root_orient"], arrays["pose_body"]
    if root.shape != (len(body), 3) or body.shape != (len(body), 63):
        return None
    return np.concatenate([root, body], 1).astype(np.float64)


def check_clip(
    name: str,
    path: Path,
    poses: Float[Array, "F c"],
    trans: Shaped[Array, "..."],
    fps: float,
    world: Float[Array, "4"] | None = None,
) -> MotionClip:
    """Check arrays from outside and return them as a clip whose world has y up.

    Args:
        name: name of the motion.
        path: the file, named in errors.
        poses: axis-angle columns of the first joints [rad]; the others stay at rest.
        trans: translation of the root [m], in the file's world.
        fps: frames per second.
        world: rotation (w, x, y, z) from the file's world to one with y up; None where it is one.

    Raises:
        InputError: shapes that do not belong together, fewer than two frames, values that are not finite or in degrees,
            no such rate.
    """
    if trans.shape != (len(poses), 3):
        raise InputError(f"{path} has {len(poses)} poses but translations of shape {trans.shape}; expected is (F, 3)")
    if not 2 <= len(poses) <= _MAX_FRAMES:
        raise InputError(f"{path} has {len(poses)} frames; a motion needs from 2 to {_MAX_FRAMES}")
    if not np.isfinite(poses).all() or not np.isfinite(trans).all() or np.abs(trans).max() > _MAX_PLACE_M:
        raise InputError(f"{path} has values that are not finite or not in radians and metres; export it again")
    largest = np.linalg.norm(poses.reshape(len(poses), -1, 3)[:, 1:], axis=-1).max(1, initial=0.0)
    if np.median(largest) > 2 * np.pi:  # below a half turn where they are vectors; the root may go on turning
        raise InputError(f"{path} turns its joints by {np.median(largest):.0f} rad: convert its degrees to radians")
    if not 0.1 <= fps <= _MAX_FPS:
        raise InputError(f"{path} says it has {fps:g} frames per second; expected is 0.1 to {_MAX_FPS:g}")
    speed_m_s = float(np.percentile(np.linalg.norm(np.diff(trans, axis=0), axis=1), 90)) * fps
    if speed_m_s > _FASTEST_M_S:
        raise InputError(f"{path} moves its person by {speed_m_s:.0f} m/s: give its translations in metres")
    full = np.zeros((len(poses), 24, 3))
    full.reshape(len(poses), 72)[:, : poses.shape[1]] = poses
    if world is not None:
        full[:, 0] = to_axis_angle(multiply(world, from_axis_angle(full[:, 0])))
        trans = rotate(world, trans)
    return MotionClip(name, full, trans, fps)


def uniform_clip(
    name: str,
    path: Path,
    poses: Float[Array, "F c"],
    trans: Float[Array, "F 3"],
    times_s: Float[Array, "F"],
    world: Float[Array, "4"] | None = None,
) -> MotionClip:
    """Resample poses at uneven instants, such as the sub-frames of several exposures, to a clip of even rate.

    The rate is that of most of them.

    Args:
        name: name of the motion.
        path: the file, named in errors.
        poses: axis-angle columns of the first joints [rad].
        trans: translation of the root [m], in the file's world.
        times_s: times of the poses, in order.
        world: rotation (w, x, y, z) from the file's world to one with y up; None where it is one.

    Raises:
        InputError: as `check_clip`, or instants that are not in order.
    """
    if times_s.shape != (len(poses),) or not np.isfinite(times_s).all() or np.any(np.diff(times_s) < 0):
        raise InputError(f"{path} has instants (times_s) that are not one for each pose, in order; export it again")
    first = np.concatenate([[True], np.diff(times_s) > 1e-9])  # an exposure may begin where the last one ended
    poses, trans, times_s = poses[first], trans[first], times_s[first]
    steps = np.diff(times_s)
    fps = 1 / float(np.median(steps)) if len(steps) else 0.0
    clip = check_clip(name, path, poses, trans, fps, world)
    if np.ptp(steps) <= 1e-3 * steps.min():
        return clip
    count = int((times_s[-1] - times_s[0]) * fps + 1e-6) + 1
    if count > _MAX_FRAMES:
        raise InputError(f"{path} has gaps between its instants that are far longer than its steps; cut it at the gaps")
    instants = np.minimum(times_s[0] + np.arange(count) / fps, times_s[-1])
    between = PchipInterpolator(times_s, align_signs(from_axis_angle(clip.poses)), axis=0)(instants)
    places = PchipInterpolator(times_s, clip.translations, axis=0)(instants)
    return MotionClip(name, to_axis_angle(between), places, fps)
