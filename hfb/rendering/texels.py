"""The body's texture: lookup of colours, texels of each face, and visible texels.

A texture is a square image in linear RGB; texture coordinates (u, v) span it from its left and TOP border,
texel centres lie at half-integer positions, and beyond the outermost centres the border's colour goes on.
"""

import numpy as np
import torch
from scipy import ndimage

from hfb.body.mesh import Mesh
from hfb.geometry.camera import PinholeCamera
from hfb.rendering.rasterizer import NEAR_M
from hfb.typing import Bool, Float, Int, Tensor


def _texel_cell(coordinate: Float[Tensor, "n"], size: int) -> tuple[Int[Tensor, "n"], Float[Tensor, "n"]]:
    """Return first texel of the pair around a coordinate, and the share of the second."""
    position = (coordinate * size - 0.5).clamp(0, size - 1)
    texel = position.detach().long().clamp_max(max(size - 2, 0))
    return texel, position - texel


def sample_texture(texture: Float[Tensor, "A A 3"], uv: Float[Tensor, "n 2"]) -> Float[Tensor, "n 3"]:
    """Look up bilinear colours at texture coordinates; differentiable in both.

    Args:
        texture: linear light.
        uv: texture coordinates in [0, 1], v = 0 at the top row.
    """
    size = texture.shape[0]
    column, right = _texel_cell(uv[:, 0], size)
    row, below = _texel_cell(uv[:, 1], size)
    next_column, next_row = (column + 1).clamp_max(size - 1), (row + 1).clamp_max(size - 1)
    right, below = right[:, None], below[:, None]
    upper = (1 - right) * texture[row, column] + right * texture[row, next_column]
    lower = (1 - right) * texture[next_row, column] + right * texture[next_row, next_column]
    return (1 - below) * upper + below * lower


def corner_uv(mesh: Mesh) -> Float[Tensor, "F 3 2"]:
    """Return the texture coordinates of each face's corners.

    Args:
        mesh: faces, edges and texture coordinates of the body.
    """
    return mesh.uv.detach()[mesh.uv_faces.long()]


def texel_faces(mesh: Mesh, size: int) -> Int[Tensor, "A A"]:
    """Return for each texel of an A x A texture the face whose chart covers its centre; -1 in the void between charts.

    Args:
        mesh: faces, edges and texture coordinates of the body.
        size: A, the texture's side [texels].
    """
    from hfb.kernels.rendering.render_texture import paint_charts

    owner = np.full((size, size), -1, np.int32)
    paint_charts(corner_uv(mesh).double().numpy(), owner)
    return torch.from_numpy(owner)


def visible_texels(
    vertices: Float[Tensor, "S V 3"], camera: PinholeCamera, mesh: Mesh, size: int
) -> Bool[Tensor, "A A"]:
    """Return the texels of an A x A texture that some pixel of some sub-frame samples (its four bilinear neighbours).

    Args:
        vertices: vertices of each sub-frame [m], camera coordinates.
        camera: pinhole camera; its height and width are the image's.
        mesh: faces, edges and texture coordinates of the body.
        size: A, the texture's side [texels].
    """
    from hfb.kernels.rendering.render_texture import mark_seen

    seen = np.zeros((size, size), np.bool_)
    view = np.array([camera.fx, camera.fy, camera.cx, camera.cy, NEAR_M, camera.width, camera.height], np.float64)
    faces, uv = mesh.faces.to(torch.int32).numpy().view(np.uint32), corner_uv(mesh).double().numpy()
    for body in vertices.detach().contiguous().numpy():
        mark_seen(body, view, faces, uv, seen)
    return torch.from_numpy(seen)


def fill_texture_gutter(texture: Float[Tensor, "A A 3"], texel_faces: Int[Tensor, "A A"]) -> Float[Tensor, "A A 3"]:
    """Give every void texel the colour of the chart texel nearest to it, so that no seam shows the void.

    Args:
        texture: linear light.
        texel_faces: face of each texel, -1 in the void, by `texel_faces`.
    """
    void = (texel_faces < 0).numpy()
    if void.all() or not void.any():
        return texture
    rows, columns = ndimage.distance_transform_edt(void, return_distances=False, return_indices=True)
    return texture[torch.from_numpy(rows.astype(np.int64)), torch.from_numpy(columns.astype(np.int64))]
