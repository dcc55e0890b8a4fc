"""Things to draw: the embedded body in random poses, balls, boxes and limbs, with their meshes."""

from functools import lru_cache

import numpy as np
import torch
import trimesh

from hfb.body.assets import load_default_body
from hfb.body.mesh import Mesh, make_mesh
from hfb.geometry.rotations import axis_angle_to_matrix


@lru_cache
def person_mesh(dtype: torch.dtype = torch.float64) -> Mesh:
    return load_default_body(dtype).mesh


def people(count: int, seed: int = 0, dtype: torch.dtype = torch.float64, spread_rad: float = 0.3) -> torch.Tensor:
    """Vertices (count, V, 3) of the embedded body 3.2 m before the camera, in random poses that overlap themselves."""
    generator = torch.Generator().manual_seed(seed)
    body = load_default_body(torch.float64)
    poses = spread_rad * torch.randn(count, 24, 3, generator=generator, dtype=torch.float64)
    poses[:, 0] = 0
    rotations = axis_angle_to_matrix(poses)
    turn = torch.zeros(count, 3, dtype=torch.float64)
    turn[:, 1] = torch.linspace(0, 1.5, count, dtype=torch.float64) + 0.4 * seed
    upright = axis_angle_to_matrix(torch.tensor([torch.pi, 0.0, 0.0], dtype=torch.float64))
    rotations[:, 0] = upright @ axis_angle_to_matrix(turn)
    person = body.shape(torch.zeros(10, dtype=torch.float64))
    place = torch.tensor([0.0, 0.0, 3.2], dtype=torch.float64) - person.joints[0]
    return person.pose(rotations, place.expand(count, 3)).vertices.to(dtype)


def _with_uv(solid: trimesh.Trimesh, dtype: torch.dtype) -> tuple[torch.Tensor, Mesh]:
    """Vertices and mesh; every face gets a chart of its own somewhere in the texture."""
    faces = np.asarray(solid.faces, np.int64)
    uv = np.random.default_rng(0).uniform(0.1, 0.9, (len(faces), 1, 2)) + np.array([[0, 0], [0.05, 0], [0, 0.05]])
    uv_faces = np.arange(3 * len(faces)).reshape(-1, 3)
    return torch.tensor(np.asarray(solid.vertices)).to(dtype), make_mesh(faces, uv.reshape(-1, 2), uv_faces, dtype)


def _turned_ball(subdivisions: int, radius_m: float) -> trimesh.Trimesh:
    """Turned so that no side lies along a row of pixels: there a derivative has two sides."""
    solid = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m)
    solid.apply_transform(trimesh.transformations.euler_matrix(0.1, 0.2, 0.3))
    return solid


def ball(radius_m: float = 0.5, subdivisions: int = 2, dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, Mesh]:
    return _with_uv(_turned_ball(subdivisions, radius_m), dtype)


def box(sides_m: tuple[float, float, float], dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, Mesh]:
    return _with_uv(trimesh.creation.box(extents=sides_m), dtype)


def limb(dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, Mesh]:
    """A thin forearm-like capsule, 25 cm long, 6 cm thick, upright."""
    solid = trimesh.creation.capsule(height=0.25, radius=0.03, count=[24, 24])
    solid.apply_translation([0, 0, -0.125])
    solid.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return _with_uv(solid, dtype)


def two_balls(dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, Mesh]:
    """A ball half before another: their outlines cross, as an arm's crosses the torso's."""
    near = _turned_ball(2, 0.25)
    near.apply_translation([0.4, 0.1, -0.6])
    far = _turned_ball(2, 0.5)
    return _with_uv(trimesh.util.concatenate([near, far]), dtype)


def smooth_texture(size: int = 32, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Random colours without jumps, so that finite differences mean something."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, 6, 6, generator=generator, dtype=torch.float64)
    fine = torch.nn.functional.interpolate(coarse, size=(size, size), mode="bilinear", align_corners=True)
    return fine[0].permute(1, 2, 0).contiguous().to(dtype)


def at(vertices: torch.Tensor, x_m: float, y_m: float, z_m: float) -> torch.Tensor:
    """One body moved to a place: (1, V, 3)."""
    return (vertices + vertices.new_tensor([x_m, y_m, z_m]))[None]
