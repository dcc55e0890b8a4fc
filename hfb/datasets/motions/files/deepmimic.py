"""DeepMimic's motions (Peng et al., DeepMimic, 2018): JSON with `Loop` and `Frames`, of 44 numbers each, as .txt.

A frame has its duration [s], the root's place [m] and rotation, then the joints' rotations: quaternions (w, x, y, z),
of knees and elbows one angle [rad] about z. The character looks along x, y is up, its right is z; its arms
hang down at rest.
"""

import json
from pathlib import Path

import numpy as np

from hfb.datasets.motions.files.bvh import BvhMotion
from hfb.errors import InputError
from hfb.typing import Array, Float

_MAX_BYTES, _SNIFFED = 64 << 20, 4096
_COLUMNS = 44
_MAX_FRAMES = 1 << 20
_ORDER = (
    ("Chest", 4),
    ("Head", 4),
    ("RightHip", 4),
    ("RightKnee", 1),
    ("RightAnkle", 4),
    ("RightShoulder", 4),
    ("RightElbow", 1),
    ("LeftHip", 4),
    ("LeftKnee", 1),
    ("LeftAnkle", 4),
    ("LeftShoulder", 4),
    ("LeftElbow", 1),
)
"""Joints after the root in a frame, and how many numbers each has; the neck's joint turns the head."""
_SKELETON = {
    "Hips": ("", (0.0, 0.0, 0.0)), "Chest": ("Hips", (0.0, 0.236, 0.0)), "Head": ("Chest", (0.0, 0.224, 0.0)),
    "RightHip": ("Hips", (0.0, 0.0, 0.085)), "RightKnee": ("RightHip", (0.0, -0.422, 0.0)),
    "RightAnkle": ("RightKnee", (0.0, -0.410, 0.0)), "RightShoulder": ("Chest", (-0.024, 0.244, 0.183)),
    "RightElbow": ("RightShoulder", (0.0, -0.275, 0.0)), "RightWrist": ("RightElbow", (0.0, -0.259, 0.0)),
    "LeftHip": ("Hips", (0.0, 0.0, -0.085)), "LeftKnee": ("LeftHip", (0.0, -0.422, 0.0)),
    "LeftAnkle": ("LeftKnee", (0.0, -0.410, 0.0)), "LeftShoulder": ("Chest", (-0.024, 0.244, -0.183)),
    "LeftElbow": ("LeftShoulder", (0.0, -0.275, 0.0)), "LeftWrist": ("LeftElbow", (0.0, -0.259, 0.0)),
}  # fmt: skip
"""Each joint's parent, and its place [m] in the parent's frame: the humanoid's proportions."""


def is_deepmimic(path: Path) -> bool:
    """Return whether a text file begins like such a motion; False where it cannot be read.

    Args:
        path: the .txt.
    """
    try:
        with path.open("rb") as file:
            begin = file.read(_SNIFFED)
    except OSError:
        return False
    return begin.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{") and b'"Frames"' in begin


def read_deepmimic(path: Path) -> tuple[BvhMotion, Float[Array, "F"]]:
    """Read a motion and the time of each of its frames [s].

    Args:
        path: the .txt.

    Raises:
        InputError: damaged, or of another character than the humanoid.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path} is larger than {_MAX_BYTES >> 20} MB; cut the motion into shorter ones")
        content = json.loads(path.read_bytes())
        rows = content["Frames"]
        if not 2 <= len(rows) <= _MAX_FRAMES:
            raise InputError(f"{path} has {len(rows)} frames; a motion needs from 2 to {_MAX_FRAMES}")
        widths = {len(row) for row in rows}
        if widths != {_COLUMNS}:
            raise InputError(
                f"{path} has frames of {min(widths)} numbers; hfb reads DeepMimic's humanoid, which has {_COLUMNS}"
            )
        frames = np.array(rows, np.float64)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); give a motion of DeepMimic") from error
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(f"{path} is no motion of DeepMimic ({str(error)[:80]}); export it again") from error
    if frames.shape != (len(rows), _COLUMNS) or not np.isfinite(frames).all() or np.abs(frames).max() > 1e5:
        raise InputError(f"{path} has values that are not finite or not in radians and metres; export it again")
    if (frames[:-1, 0] <= 0).any():
        raise InputError(f"{path} has frames without a duration; export it again")
    return _motion(path, frames), np.concatenate([[0.0], np.cumsum(frames[:-1, 0])])


def _motion(path: Path, frames: Float[Array, "F 44"]) -> BvhMotion:
    names = tuple(_SKELETON)
    parents = tuple(names.index(parent) if parent else -1 for parent, _ in _SKELETON.values())
    offsets = np.array([place for _, place in _SKELETON.values()])
    rotations = np.tile([1.0, 0, 0, 0], (len(frames), len(names), 1))
    rotations[:, 0] = _unit(path, frames[:, 4:8])
    at = 8
    for name, width in _ORDER:
        turn = frames[:, at : at + width]
        joint = rotations[:, names.index(name)]
        if width == 1:
            joint[:, 0], joint[:, 3] = np.cos(turn[:, 0] / 2), np.sin(turn[:, 0] / 2)
        else:
            joint[:] = _unit(path, turn)
        at += width
    places = np.tile(offsets, (len(frames), 1, 1))
    places[:, 0] = frames[:, 1:4]
    fps = 1 / float(np.median(frames[:-1, 0]))
    return BvhMotion(names, parents, offsets, np.zeros_like(offsets), rotations, places, fps)


def _unit(path: Path, quaternions: Float[Array, "F 4"]) -> Float[Array, "F 4"]:
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if (np.abs(lengths - 1) > 0.1).any():
        raise InputError(f"{path} has rotations that are no unit quaternions; export it again")
    return quaternions / lengths
