"""Bodies drawn to be looked at: clay under one light, its colour telling the time."""

from dataclasses import replace

import torch

from hfb.body.mesh import Mesh, vertex_normals
from hfb.geometry.camera import PinholeCamera
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Float, Tensor

_TIME_COLOURS = ((0.35, 0.58, 0.98), (0.80, 0.50, 0.85), (0.99, 0.62, 0.27))  # first, middle, last instant
_LIGHT_DIRECTION = (-0.35, -0.55, -0.76)  # towards the light, camera coordinates: above the viewer's left shoulder
_AMBIENT = 0.35
_RAMP_TEXELS = 64


def time_colours(count: int) -> Float[Tensor, "S 3"]:
    """Display colours from blue (first instant) over violet to orange (last)."""
    first, middle, last = torch.tensor(_TIME_COLOURS)
    share = torch.linspace(-1, 1, count)[:, None]
    return middle + (-share).clamp_min(0) * (first - middle) + share.clamp_min(0) * (last - middle)


def shade_bodies(
    vertices: Float[Tensor, "S V 3"],
    colours: Float[Tensor, "S 3"],
    camera: PinholeCamera,
    mesh: Mesh,
    rasterizer: Rasterizer,
) -> Float[Tensor, "S H W 4"]:
    """Lambert-shaded pictures of bodies, one each: premultiplied display colours and coverage.

    The rasteriser knows only textures, so the shade becomes one: each vertex's texture coordinate is its
    brightness, the texture a ramp from the darkest to the brightest tone. That shades smoothly between vertices.

    Args:
        vertices: camera coordinates [m].
        colours: of each body in full light, sRGB.
    """
    light = torch.tensor(_LIGHT_DIRECTION, dtype=vertices.dtype)
    brightness = (vertex_normals(vertices, mesh) @ light).clamp(0, 1)
    # Half a texel in from both ends, where a bilinear lookup is a ramp.
    along = (0.5 + brightness * (_RAMP_TEXELS - 1)) / _RAMP_TEXELS
    ramp = torch.linspace(_AMBIENT, 1, _RAMP_TEXELS, dtype=vertices.dtype).expand(_RAMP_TEXELS, -1)[..., None]
    pictures = []
    for body, coordinate, colour in zip(vertices, along, colours, strict=True):
        clay = replace(mesh, uv=torch.stack([coordinate, torch.full_like(coordinate, 0.5)], -1), uv_faces=mesh.faces)
        with torch.no_grad():
            pictures.append(rasterizer.render(body[None], ramp * colour.to(ramp), camera, clay)[0])
    return torch.stack(pictures)


def side_view(
    vertices: Float[Tensor, "S V 3"], height: int, width: int
) -> tuple[Float[Tensor, "S V 3"], PinholeCamera]:
    """The same bodies seen from the left edge of the picture, together filling a picture of this size.

    The scene turns by a quarter about the vertical through the bodies' middle: what was depth is then width.
    A long lens from ten body sizes away keeps proportions true.
    """
    low, high = vertices.amin((0, 1)), vertices.amax((0, 1))
    x, y, z = (vertices - (low + high) / 2).unbind(-1)
    distance = 10 * float((high - low).max())
    turned = torch.stack([-z, y, x + distance], -1)
    span_x, span_y = float(turned[..., 0].max()) * 2, float(turned[..., 1].max()) * 2
    nearest = float(turned[..., 2].min())
    focal_px = 0.9 * nearest * min(width / max(span_x, 1e-6), height / max(span_y, 1e-6))
    return turned, PinholeCamera.from_focal(focal_px, height, width)
