"""SMPL's model files as a `Body`: variants of the format, other models and damage are recognised."""

from pathlib import Path

import numpy as np
import torch

from hfb.body.atlas import make_atlas
from hfb.body.closing import boundary_loops, fan_corners, fans
from hfb.body.mesh import make_mesh
from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT, PARENTS
from hfb.errors import InputError
from hfb.io.safe.archives import read_arrays
from hfb.typing import Array, Float, Int, Shaped

SHAPE_COUNT = 10
POSE_COUNT = 9 * (JOINT_COUNT - 1)
_NEEDED = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")
_TEXTURE = ("vt", "ft")
_MAX_VERTICES = 200_000
_ABSURD = 1e3
_HEIGHTS_M = (0.2, 5.0)
# Relatives by their number of joints.
_RELATIVES = {55: "a SMPL-X", 54: "a SMPL-X", 52: "a SMPL-H", 16: "a MANO", 5: "a FLAME", 33: "a SMAL", 35: "a SMAL"}
_FIX = "download SMPL from https://smpl.is.tue.mpg.de and give its .npz or .pkl, or leave the body model out"

Arrays = dict[str, Shaped[Array, "..."]]


def read_smpl(path: Path) -> Body:
    """Read a user's SMPL file in float64; the first ten betas; holes closed; with a texture atlas where it has none.

    Args:
        path: .npz or .pkl file.

    Raises:
        InputError: the file is missing, damaged, not a body model, or a model other than SMPL.
    """
    arrays, names = read_arrays(path, (*_NEEDED, *_TEXTURE))
    _refuse_others(path, arrays, names)
    vertex_count = arrays["v_template"].shape[0]
    template = _floats(path, arrays, "v_template", (vertex_count, 3))
    height_m = np.ptp(template, axis=0).max()
    if not _HEIGHTS_M[0] < height_m < _HEIGHTS_M[1]:
        raise InputError(f"{path} is not a SMPL model in metres: its template spans {height_m:.3g}; {_FIX}.")
    shape_directions = _shape_directions(path, arrays, vertex_count)
    pose_directions = np.ascontiguousarray(_floats(path, arrays, "posedirs", (vertex_count, 3, POSE_COUNT)))
    regressor = _floats(path, arrays, "J_regressor", (JOINT_COUNT, vertex_count))
    weights = _floats(path, arrays, "weights", (vertex_count, JOINT_COUNT))
    _check_parents(path, arrays["kintree_table"])
    for name, rows in (("weights", weights), ("J_regressor", regressor)):
        if np.abs(rows.sum(1) - 1).max() > 0.01:
            raise InputError(f"{path} is damaged: rows of {name} do not add up to 1; {_FIX}.")
    weights = weights / weights.sum(1, keepdims=True)
    faces, uv, uv_faces = _surface(path, arrays, template, weights)
    added = len(faces) - len(arrays["f"])
    as_tensor = torch.from_numpy
    return Body(
        name=path.stem,
        betas_space="smpl",
        licence="the terms under which you got the file (SMPL: https://smpl.is.tue.mpg.de)",
        source=f"{path}, closed with {added} faces" if added else str(path),
        template=as_tensor(template),
        shape_directions=as_tensor(shape_directions),
        pose_directions=as_tensor(pose_directions),
        joint_regressor=as_tensor(regressor),
        joint_template=as_tensor(regressor @ template),
        joint_shape_directions=as_tensor(np.einsum("jv,vck->jck", regressor, shape_directions)),
        skinning_weights=as_tensor(weights),
        mesh=make_mesh(faces, uv, uv_faces, torch.float64),
    )


def _refuse_others(path: Path, arrays: Arrays, names: frozenset[str]) -> None:
    """Say by name what was given instead of SMPL."""
    if {"poses", "trans"} <= names:
        raise InputError(f"{path} is a motion file (AMASS), not a body model; {_FIX}.")
    if "v_template" not in arrays:
        raise InputError(f"{path} is not a body model, it has no v_template; {_FIX}.")
    template, parents = arrays["v_template"], arrays.get("kintree_table", np.zeros((2, 0)))
    if template.ndim != 2 or template.shape[1] != 3 or not 4 <= template.shape[0] <= _MAX_VERTICES:
        raise InputError(f"{path} is not a body model, its v_template has the shape {template.shape}; {_FIX}.")
    joints = parents.shape[1] if parents.ndim == 2 else 0
    poses = arrays["posedirs"].shape[-1] if "posedirs" in arrays and arrays["posedirs"].ndim else 0
    relative = _RELATIVES.get(joints) or _RELATIVES.get(poses // 9 + 1 if poses and poses % 9 == 0 else 0)
    if relative is None and joints == JOINT_COUNT and poses == 93:
        relative = "a STAR"
    if relative:
        raise InputError(
            f"{path} is {relative} model ({joints} joints, {poses} pose blend shapes), "
            f"and hfb fits SMPL ({JOINT_COUNT} joints, {POSE_COUNT}); {_FIX}."
        )
    missing = [name for name in _NEEDED if name not in arrays]
    if missing:
        raise InputError(f"{path} is not a whole SMPL model, it lacks {', '.join(missing)}; {_FIX}.")


def _floats(path: Path, arrays: Arrays, name: str, shape: tuple[int, ...]) -> Float[Array, "..."]:
    array = arrays[name]
    if array.shape != shape:
        raise InputError(f"{path} is not a SMPL model: {name} has the shape {array.shape}, not {shape}; {_FIX}.")
    array = array.astype(np.float64)
    if not (np.abs(array) < _ABSURD).all():  # NaN too
        raise InputError(f"{path} is damaged: {name} holds values that are not finite or absurdly large; {_FIX}.")
    return array


def _shape_directions(path: Path, arrays: Arrays, vertex_count: int) -> Float[Array, "V 3 10"]:
    """Return the first ten shape directions; files have 10, 16 or 300 by falling variance."""
    array = arrays["shapedirs"]
    if array.ndim != 3 or array.shape[2] < SHAPE_COUNT:
        raise InputError(
            f"{path} is not a SMPL model: shapedirs has the shape {array.shape}, "
            f"not ({vertex_count}, 3, {SHAPE_COUNT} or more); {_FIX}."
        )
    arrays = {"shapedirs": array[:, :, :SHAPE_COUNT]}
    return np.ascontiguousarray(_floats(path, arrays, "shapedirs", (vertex_count, 3, SHAPE_COUNT)))


def _check_parents(path: Path, table: Shaped[Array, "..."]) -> None:
    """Check the parents; the root's is -1, which files of uint32 store as 4294967295."""
    if table.shape != (2, JOINT_COUNT):
        raise InputError(
            f"{path} is not a SMPL model: kintree_table has the shape {table.shape}, not (2, {JOINT_COUNT}); {_FIX}."
        )
    parents = table[0].astype(np.int64)
    parents[parents == 2**32 - 1] = -1
    if tuple(parents[1:].tolist()) != PARENTS[1:] or parents[0] not in (-1, 0):
        raise InputError(f"{path} is not a SMPL model: its kintree_table is not SMPL's skeleton; {_FIX}.")


def _surface(
    path: Path, arrays: Arrays, template: Float[Array, "V 3"], weights: Float[Array, "V 24"]
) -> tuple[Int[Array, "F 3"], Float[Array, "U 2"], Int[Array, "F 3"]]:
    """Return (faces, uv, uv_faces), closed."""
    faces = _indices(path, "f", arrays["f"], len(template))
    filling = fans(boundary_loops(faces))
    if not all(name in arrays for name in _TEXTURE):
        faces = np.concatenate([faces, filling])
        uv, uv_faces = make_atlas(template, faces, weights)
        return faces, uv, uv_faces
    uv = arrays["vt"].astype(np.float64)
    if uv.ndim != 2 or uv.shape[1] != 2 or not np.isfinite(uv).all() or arrays["ft"].shape != faces.shape:
        raise InputError(f"{path} is damaged: its texture coordinates vt, ft do not fit its faces; {_FIX}.")
    uv_faces = _indices(path, "ft", arrays["ft"], len(uv))
    # OBJ's v runs upwards, hfb's downwards.
    uv = np.clip(np.stack([uv[:, 0], 1 - uv[:, 1]], 1), 0.0, 1.0)
    return np.concatenate([faces, filling]), uv, np.concatenate([uv_faces, fan_corners(filling, faces, uv_faces)])


def _indices(path: Path, name: str, array: Shaped[Array, "..."], count: int) -> Int[Array, "F 3"]:
    if array.ndim != 2 or array.shape[1] != 3 or not len(array) or array.dtype.kind not in "iu":
        raise InputError(f"{path} is not a SMPL model: {name} is no list of triangles; {_FIX}.")
    indices = array.astype(np.int64)
    if indices.min() < 0 or indices.max() >= count:
        raise InputError(f"{path} is damaged: {name} points outside its {count} vertices; {_FIX}.")
    return indices
