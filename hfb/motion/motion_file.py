"""motion.npz: the lossless result, readable with numpy alone."""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from hfb.errors import InputError
from hfb.geometry.world import World, rotation_fault
from hfb.io.array_files import read_arrays
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array

_ARRAYS = ("poses", "trans", "betas", "joints", "times_s", "frame_index", "K")
_OPTIONAL = ("joint_radius_mm",)
_WORLD = ("R_world_camera", "t_world_camera", "world_up", "world_source")
_FLOOR = ("floor_source", "floor")
_LARGEST = {
    "poses": 1e4,
    "trans": 1e6,
    "betas": 1e4,
    "joints": 1e6,
    "K": 1e9,
    "times_s": 1e10,
    "frame_index": 1e6,
    "joint_radius_mm": 1e9,
}
"""Values beyond those of any person in front of a camera, which would cost readers memory or time."""

_SHORTEST_STEP_S = 1e-12
_WIDEST_PX = 1_000_000


def motion_arrays(motion: SampledMotion, betas_space: str) -> dict[str, Array]:
    """Return the members of a motion file, by name.

    Args:
        motion: camera coordinates.
        betas_space: space of the shape coefficients: ``"smpl"`` or ``"hfb"`` (the embedded body's own).
    """
    known = {name: getattr(motion, name) for name in (*_ARRAYS, *_OPTIONAL) if getattr(motion, name) is not None}
    if (world := motion.world) is not None:
        parts = (world.rotation, world.translation, world.up, world.source)
        known |= {name: np.array(part) for name, part in zip(_WORLD, parts, strict=True)}
        known |= {name: np.array(part) for name in _FLOOR if (part := getattr(world, name)) is not None}
    if motion.size is not None:
        known["size"] = np.array(motion.size)
    return known | {"betas_space": np.array(betas_space)}


def save_motion(path: Path, motion: SampledMotion, betas_space: str) -> None:
    """Write the motion whole or not at all; no pickled member.

    Args:
        path: the .npz file.
        motion: camera coordinates.
        betas_space: space of the shape coefficients: ``"smpl"`` or ``"hfb"`` (the embedded body's own).
    """
    write_arrays(path, motion_arrays(motion, betas_space))


def write_arrays(path: Path, arrays: dict[str, Array]) -> None:
    """Write a compressed .npz of plain arrays, whole or not at all.

    Args:
        path: the .npz file.
        arrays: by name.
    """
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]  # its stub confuses them with allow_pickle
    write_bytes_atomic(path, buffer.getvalue())


def load_motion(path: Path) -> tuple[SampledMotion, str]:
    """Read a motion file; return the motion and the space of its betas.

    Args:
        path: the .npz file.

    Raises:
        InputError: not a motion file, or a damaged one.
    """
    try:
        found = read_arrays(path, (*_ARRAYS, *_OPTIONAL, *_WORLD, *_FLOOR, "size", "betas_space"))
        _check(found)
        names = (*_ARRAYS, *(name for name in _OPTIONAL if name in found))
        parts = {name: found[name] for name in names}
        return SampledMotion(**parts, world=_world(found), size=_size(found)), str(found["betas_space"])
    except FileNotFoundError:
        raise InputError(f"there is no motion file at {path}: name a finished result, or make it again") from None
    except (KeyError, ValueError, OSError) as error:
        raise InputError(f"{path} is not a motion file of hfb ({error}); make one with `hfb fit`") from None


def _check(found: Mapping[str, Array]) -> None:
    """Raise ValueError where arrays are of other kinds or shapes, KeyError where one is missing."""
    rows = len(found["poses"]) if found["poses"].ndim else 0
    shapes = {
        "poses": (rows, 72),
        "trans": (rows, 3),
        "betas": (10,),
        "joints": (rows, 24, 3),
        "times_s": (rows,),
        "frame_index": (rows,),
        "K": (3, 3),
        "joint_radius_mm": (rows, 24),
    }
    for name, shape in shapes.items():
        if name in _OPTIONAL and name not in found:
            continue
        array = found[name]
        if array.shape != shape or array.dtype.kind not in ("iu" if name == "frame_index" else "f"):
            raise ValueError(f"its {name} is {array.dtype} {array.shape}, not numbers {shape}")
        if name not in _OPTIONAL and not np.isfinite(array).all():
            raise ValueError(f"its {name} is not finite")
    if not rows or found["frame_index"].min() < 0:
        raise ValueError("it has no instant, or a frame before the first")
    for name, largest in _LARGEST.items():
        if name in found and np.nanmax(np.abs(found[name]), initial=0, where=np.isfinite(found[name])) > largest:
            raise ValueError(f"its {name} has a number beyond {largest:g}")
    _check_clock(found["times_s"], found["frame_index"])


def _world(found: Mapping[str, Array]) -> World | None:
    """Return the world; None in files that have none. Raises KeyError or ValueError where it is damaged."""
    if _WORLD[0] not in found:
        return None
    parts = {key: found[key].tolist() for key in (*_WORLD, *(name for name in _FLOOR if name in found))}
    names = dict(zip(_WORLD, ("rotation", "translation", "up", "source"), strict=True))
    try:
        world = World.model_validate({names.get(key, key): part for key, part in parts.items()})
    except ValidationError:
        raise ValueError("its world is none") from None
    if fault := rotation_fault(world.rotation):
        raise ValueError(f"its R_world_camera {fault}")
    if not all(abs(value) < _LARGEST["trans"] for value in world.translation):
        raise ValueError("its t_world_camera is not finite, or beyond any place")
    return world


def _size(found: Mapping[str, Array]) -> tuple[int, int] | None:
    """Return width and height; None in files that have none. Raises ValueError where they are no image's."""
    if "size" not in found:
        return None
    size = found["size"]
    if size.shape != (2,) or size.dtype.kind not in "iu" or not ((size > 0) & (size <= _WIDEST_PX)).all():
        raise ValueError("its size is not the width and height of an image")
    return int(size[0]), int(size[1])


def _check_clock(times_s: Array, frame_index: Array) -> None:
    """Raise ValueError where instants cannot be those of a recording, as everything made of them would be absurd."""
    if (frame_index[1:] < frame_index[:-1]).any():
        raise ValueError("its frames are not in order")
    steps = np.diff(times_s)[frame_index[1:] == frame_index[:-1]]
    steps = steps[steps != 0]
    if len(steps) and np.abs(steps).min() < _SHORTEST_STEP_S:
        raise ValueError(f"its times_s has two sub-frames within {_SHORTEST_STEP_S:g} s")
