"""motion.bvh: a skeleton and its angles, as text; metres, the motion's world with y up.

Offsets are the person's own bones in the rest pose (T, facing +z). The root's offset is zero and its position channels
are its position, so that programs that add the two and those that do not agree. Rows have the rate of the sub-frames:
a program that shows one row per video frame shows slow motion.
"""

import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hfb.body.skeleton import JOINT_NAMES, PARENTS
from hfb.geometry.placement import y_up
from hfb.interop.writers.keys import even_keys, rest_joints, subframe_rate_hz, turned
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float

_ORDER = "ZXY"  # outermost first, as the channels are written
_END = 0.5  # an end site continues the bone before it by this share


def bvh_text(motion: SampledMotion) -> str:
    """Return the file's text.

    Args:
        motion: camera coordinates.

    Raises:
        InputError: the motion's instants are not in order.
    """
    rate = subframe_rate_hz(motion)
    keys = even_keys(motion, rate)
    rest, placed = rest_joints(motion), y_up(motion.export_world)
    places = placed.points(keys.places[:, 0])
    angles = _angles(turned(keys.quaternions, placed.quaternion()))
    order = _depth_first(0)
    rows = np.concatenate([places, angles[:, order].reshape(len(places), -1)], 1)
    lines = ["HIERARCHY", *_joint(0, rest, 0), "MOTION", f"Frames: {len(rows)}", f"Frame Time: {1 / rate:.10f}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
    return "\n".join(lines) + "\n"


def write_bvh(path: Path, motion: SampledMotion) -> None:
    """Write the file whole or not at all; see `bvh_text`.

    Args:
        path: the file.
        motion: camera coordinates.
    """
    write_bytes_atomic(path, bvh_text(motion).encode())


def _angles(quaternions: Float[Array, "F 24 4"]) -> Float[Array, "F 24 3"]:
    """Return degrees about z, x, y, without jumps of a full turn from row to row."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at x = 90 degrees one of many equal answers is taken
        turns = Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True).as_euler(_ORDER)
    return np.degrees(np.unwrap(turns.reshape(-1, 24, 3), axis=0))


def _children(joint: int) -> list[int]:
    return [child for child, parent in enumerate(PARENTS) if parent == joint]


def _depth_first(joint: int) -> list[int]:
    """Return joints in the order of the file's hierarchy and columns."""
    return [joint, *(one for child in _children(joint) for one in _depth_first(child))]


def _joint(joint: int, rest: Float[Array, "24 3"], depth: int) -> list[str]:
    """Return the lines of a joint and its children."""
    margin, parent = "  " * depth, PARENTS[joint]
    offset = rest[joint] - rest[parent] if parent >= 0 else np.zeros(3)
    turns = " ".join(f"{axis}rotation" for axis in _ORDER)
    channels = f"3 {turns}" if parent >= 0 else f"6 Xposition Yposition Zposition {turns}"
    body = [f"OFFSET {_numbers(offset)}", f"CHANNELS {channels}"]
    children = _children(joint)
    if not children:
        body += ["End Site", "{", f"  OFFSET {_numbers(_END * offset)}", "}"]
    lines = [f"{'JOINT' if parent >= 0 else 'ROOT'} {JOINT_NAMES[joint]}", "{", *(f"  {line}" for line in body)]
    below = [line for child in children for line in _joint(child, rest, depth + 1)]
    return [*(margin + line for line in lines), *below, margin + "}"]


def _numbers(vector: Float[Array, "3"]) -> str:
    return " ".join(f"{value:.7f}" for value in vector)
