"""Lambert-shaded renderings of bodies whose colour encodes time."""

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
    """Return display colours from blue (first instant) over violet to orange (last).

    Args:
        count: number of instants.
    """
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
    """Render each body Lambert-shaded: premultiplied display colours and coverage.

    The rasterizer only knows textures, so shading becomes one: a vertex's texture coordinate is its brightness, and the
    texture is a ramp from dark to bright. Brightness is thus interpolated between vertices.

    Args:
        vertices: camera coordinates [m].
        colours: sRGB of each body in full light.
        camera: also gives the image's size.
        mesh: faces of all bodies.
        rasterizer: renders the ramp texture.
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
    """Return the bodies seen from the image's left edge, and a camera in which they fill an image of this size.

    The scene is turned by 90 degrees about the vertical through the bodies' centre, so depth becomes width. The camera
    is ten body sizes away, which makes perspective negligible.

    Args:
        vertices: camera coordinates [m].
        height: of the image [px].
        width: of the image [px].
    """
    low, high = vertices.amin((0, 1)), vertices.amax((0, 1))
    x, y, z = (vertices - (low + high) / 2).unbind(-1)
    distance = 10 * float((high - low).max())
    turned = torch.stack([-z, y, x + distance], -1)
    span_x, span_y = float(turned[..., 0].max()) * 2, float(turned[..., 1].max()) * 2
    nearest = float(turned[..., 2].min())
    focal_px = 0.9 * nearest * min(width / max(span_x, 1e-6), height / max(span_y, 1e-6))
    return turned, PinholeCamera.from_focal(focal_px, height, width)
