"""The readable rasteriser, the reference of the fast ones in values and in gradients (by autograd).

Written for clarity, in plain torch, row of pixels by row of pixels: use it in tests and for small images.
The silhouette is the exact share of each pixel covered by the union of the front faces, found here by another
way than in the kernels (whole rows are cut into slabs, nothing is accumulated), so that each checks the other.
"""

from typing import Literal

import torch

from hfb.body.mesh import Mesh
from hfb.geometry.camera import PinholeCamera
from hfb.rendering.rasterizer import NEAR_M, Rasterizer, Texture
from hfb.rendering.reference_dibr import soft_mask
from hfb.rendering.texels import sample_texture
from hfb.typing import Bool, Float, Int, Tensor

TIE = 1e-9  # squared distances [px^2] and barycentric coordinates closer than this are equal


def front_faces(xy: Float[Tensor, "V 2"], usable: Bool[Tensor, "V"], faces: Int[Tensor, "F 3"]) -> Bool[Tensor, "F"]:
    """Return the faces that look at the camera.

    From outside they run counter-clockwise, so on the screen (y down) their signed area is negative. A face with an
    unusable corner is not among them.

    Args:
        xy: vertices on the screen [px].
        usable: vertices far enough in front of the camera.
        faces: vertex numbers of each triangle.
    """
    a, b, c = xy[faces].unbind(1)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (c - a)[:, 0] * (b - a)[:, 1]
    return usable[faces].all(1) & (area < 0)


def outline_edges(front: Bool[Tensor, "F"], mesh: Mesh) -> Int[Tensor, "C 3"]:
    """Return the edges where the front faces end: (from, to, front face), directed as the front face traverses them.

    Args:
        front: faces that look at the camera.
        mesh: faces, edges and texture coordinates of the body.
    """
    first, second = mesh.edge_faces.long().unbind(1)
    first_front = front[first]
    second_front = torch.where(second >= 0, front[second], False)
    ends = torch.where(first_front[:, None], mesh.edge_vertices, mesh.edge_vertices.flip(1)).long()
    owner = torch.where(first_front, first, second)
    return torch.cat([ends, owner[:, None]], 1)[first_front != second_front]


def _crossing_heights(p: Float[Tensor, "n 2"], d: Float[Tensor, "n 2"]) -> Float[Tensor, "m"]:
    """Return heights y at which edges p + t d, 0 < t < 1, cross each other."""
    across = d[:, None, 0] * d[None, :, 1] - d[:, None, 1] * d[None, :, 0]
    apart = p[None] - p[:, None]
    safe = torch.where(across == 0, torch.ones_like(across), across)
    s = (apart[..., 0] * d[None, :, 1] - apart[..., 1] * d[None, :, 0]) / safe
    t = (apart[..., 0] * d[:, None, 1] - apart[..., 1] * d[:, None, 0]) / safe
    crossing = (across != 0) & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    return (p[:, None, 1] + s * d[:, None, 1])[crossing]


def _share_right_of(top: Float[Tensor, "*n"], bottom: Float[Tensor, "*n"], width: int) -> Float[Tensor, "*n W"]:
    """Share of each pixel (of a slab's height) right of lines that enter the slab at x = top, leave at bottom."""
    left = torch.arange(width, dtype=top.dtype)
    top, run = top[..., None], (bottom - top)[..., None]
    # Where the line is within the pixel's columns; the share is continuous there, so nothing to differentiate.
    with torch.no_grad():
        safe = torch.where(run == 0, torch.full_like(run, 1e-30), run)
        at = torch.stack([((left - top) / safe).clamp(0, 1), ((left + 1 - top) / safe).clamp(0, 1)])
        enters, leaves = at.amin(0), at.amax(0)
        before = torch.where(safe > 0, enters, 1 - leaves)
    return before + (leaves - enters) * (left + 1 - top - run * (enters + leaves) / 2)


def _cover_row(p: Float[Tensor, "n 2"], q: Float[Tensor, "n 2"], row: int, width: int) -> Float[Tensor, "W"]:
    """Return covered share of one row of pixels, from the outline edges p -> q that touch it."""
    d = q - p
    # The covered length is continuous where one slab meets the next: the heights need no gradient.
    with torch.no_grad():
        heights = torch.cat([p[:, 1], q[:, 1], _crossing_heights(p, d)]).clamp(row, row + 1)
        heights = torch.cat([heights, heights.new_tensor([row, row + 1])]).sort().values
        thick = heights.diff() > 1e-12
    low, high = heights[:-1][thick, None], heights[1:][thick, None]
    middle = (low + high) / 2
    active = (torch.minimum(p[:, 1], q[:, 1]) < middle) & (middle < torch.maximum(p[:, 1], q[:, 1]))
    slope = d[:, 0] / torch.where(d[:, 1] == 0, torch.ones_like(d[:, 1]), d[:, 1])
    top, bottom = p[:, 0] + (low - p[:, 1]) * slope, p[:, 0] + (high - p[:, 1]) * slope
    order = torch.where(active, (top + bottom).detach(), torch.inf).argsort(1)
    # More body to the right of an edge that runs down the screen, less of one that runs up.
    step = torch.where(active, d[:, 1].detach().sign(), 0).expand(len(low), -1).gather(1, order)
    winding = step.cumsum(1)
    covers = (winding > 0.5).to(p.dtype) - (winding - step > 0.5).to(p.dtype)
    share = _share_right_of(top.gather(1, order), bottom.gather(1, order), width)
    return (covers[..., None] * (high - low)[..., None] * share).sum((0, 1))


def coverage(xy: Float[Tensor, "V 2"], edges: Int[Tensor, "C 3"], height: int, width: int) -> Float[Tensor, "H W"]:
    """Return the share of each pixel where the outline winds about at least one front layer.

    Args:
        xy: vertices on the screen [px].
        edges: outline edges (from, to, ...), see `outline_edges`.
        height: height of the image [px].
        width: width of the image [px].
    """
    p, q = xy[edges[:, 0]], xy[edges[:, 1]]
    low, high = torch.minimum(p, q)[:, 1], torch.maximum(p, q)[:, 1]
    rows = []
    for row in range(height):
        touching = (low < row + 1) & (high > row)
        rows.append(_cover_row(p[touching], q[touching], row, width) if touching.any() else xy.new_zeros(width))
    return torch.stack(rows)


def barycentric(points: Float[Tensor, "*n 2"], corners: Float[Tensor, "*n 3 2"]) -> Float[Tensor, "*n 3"]:
    """Return barycentric coordinates on the screen.

    Args:
        points: on the screen [px].
        corners: corners of the triangles [px].
    """
    a, b, c = corners.unbind(-2)

    def cross(u: Tensor, v: Tensor) -> Tensor:
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    area = cross(b - a, c - a)
    second, third = cross(points - a, c - a) / area, cross(b - a, points - a) / area
    return torch.stack([1 - second - third, second, third], -1)


@torch.no_grad()
def visible_faces(
    xy: Float[Tensor, "V 2"],
    inverse_depth: Float[Tensor, "V"],
    front: Bool[Tensor, "F"],
    faces: Int[Tensor, "F 3"],
    height: int,
    width: int,
) -> Int[Tensor, "H W"]:
    """Return the nearest front face at each pixel's centre, -1 where there is none.

    Args:
        xy: vertices on the screen [px].
        inverse_depth: inverse depth of the vertices [1/m].
        front: faces that look at the camera.
        faces: vertex numbers of each triangle.
        height: height of the image [px].
        width: width of the image [px].
    """
    candidates = front.nonzero().squeeze(1)
    y = xy[faces[candidates]][..., 1]
    low, high = y.amin(1), y.amax(1)
    columns = torch.arange(width, dtype=xy.dtype) + 0.5
    rows = []
    for row in range(height):
        centre = row + 0.5
        here = candidates[(low <= centre) & (high >= centre)]
        if len(here) == 0:
            rows.append(torch.full((width,), -1))
            continue
        centres = torch.stack([columns, torch.full_like(columns, centre)], -1)[:, None].expand(-1, len(here), -1)
        b = barycentric(centres, xy[faces[here]].expand(width, -1, -1, -1))
        depth = torch.where((b >= -TIE).all(-1), (b * inverse_depth[faces[here]]).sum(-1), 0)
        best, which = depth.max(1)
        rows.append(torch.where(best > 0, here[which], -1))
    return torch.stack(rows)


@torch.no_grad()
def rim_edges(xy: Float[Tensor, "V 2"], edges: Int[Tensor, "C 3"], height: int, width: int) -> Int[Tensor, "H W"]:
    """Return, of the outline edges that cross a pixel, the one closest to its centre (the first of equals); -1: none.

    Args:
        xy: vertices on the screen [px].
        edges: outline edges (from, to, ...), see `outline_edges`.
        height: height of the image [px].
        width: width of the image [px].
    """
    p = xy[edges[:, 0]]
    d = xy[edges[:, 1]] - p
    tiny = torch.where(d == 0, torch.full_like(d, 1e-30), d)
    columns = torch.arange(width, dtype=xy.dtype)
    rows = []
    for row in range(height):
        at = torch.stack([(row - p[:, 1]) / tiny[:, 1], (row + 1 - p[:, 1]) / tiny[:, 1]])
        enters, leaves = at.amin(0).clamp_min(0), at.amax(0).clamp_max(1)
        here = (enters <= leaves).nonzero().squeeze(1)
        if len(here) == 0:
            rows.append(torch.full((width,), -1))
            continue
        left = (columns[:, None] - p[here, 0]) / tiny[here, 0]
        right = (columns[:, None] + 1 - p[here, 0]) / tiny[here, 0]
        enters = torch.maximum(torch.minimum(left, right), enters[here])
        leaves = torch.minimum(torch.maximum(left, right), leaves[here])
        centres = torch.stack([columns + 0.5, torch.full_like(columns, row + 0.5)], -1)[:, None]
        t = closest_parameter(centres, p[here], d[here])
        squared = ((p[here] + t[..., None] * d[here] - centres) ** 2).sum(-1)
        squared = torch.where(enters <= leaves, squared, torch.inf)
        best = squared.amin(1, keepdim=True)
        first = (squared <= best + TIE).to(torch.uint8).argmax(1)
        rows.append(torch.where(best[:, 0] < torch.inf, here[first], -1))
    return torch.stack(rows)


def closest_parameter(
    points: Float[Tensor, "*n 2"], start: Float[Tensor, "*m 2"], direction: Float[Tensor, "*m 2"]
) -> Float[Tensor, "*k"]:
    """Return the parameter t in [0, 1] of the point start + t direction closest to a point.

    Args:
        points: on the screen [px].
        start: first ends of segments [px].
        direction: second minus first ends [px].
    """
    squared_length = (direction * direction).sum(-1)
    safe = torch.where(squared_length == 0, torch.ones_like(squared_length), squared_length)
    return (((points - start) * direction).sum(-1) / safe).clamp(0, 1)


def _uv_of_faces(
    centres: Float[Tensor, "n 2"],
    face: Int[Tensor, "n"],
    xy: Float[Tensor, "V 2"],
    inverse_depth: Float[Tensor, "V"],
    mesh: Mesh,
) -> Float[Tensor, "n 2"]:
    """Return perspective-correct texture coordinates of pixel centres in their faces."""
    corners = mesh.faces.long()[face]
    weights = barycentric(centres, xy[corners]) * inverse_depth[corners]
    uv = mesh.uv.to(xy.dtype)[mesh.uv_faces.long()[face]]
    return (weights[..., None] * uv).sum(1) / weights.sum(1, keepdim=True)


def _uv_of_edges(
    centres: Float[Tensor, "n 2"],
    edge: Int[Tensor, "n 3"],
    xy: Float[Tensor, "V 2"],
    inverse_depth: Float[Tensor, "V"],
    mesh: Mesh,
) -> Float[Tensor, "n 2"]:
    """Return texture coordinates at the points of outline edges closest to pixel centres."""
    start, end, face = edge.unbind(1)
    t = closest_parameter(centres, xy[start], xy[end] - xy[start])
    weights = torch.stack([(1 - t) * inverse_depth[start], t * inverse_depth[end]], 1)
    corners, uv_corners = mesh.faces.long()[face], mesh.uv_faces.long()[face]
    both = [uv_corners.gather(1, (corners == v[:, None]).to(torch.uint8).argmax(1, keepdim=True)) for v in (start, end)]
    uv = mesh.uv.to(xy.dtype)[torch.cat(both, 1)]
    return (weights[..., None] * uv).sum(1) / weights.sum(1, keepdim=True)


class ReferenceRasterizer(Rasterizer):
    """The Protocol of `hfb.rendering.rasterizer` in plain torch, in the precision of the vertices.

    Args:
        silhouette: exact coverage, or DIB-R's mask.
        sharpness: of DIB-R's mask, see `hfb.rendering.reference_dibr.dibr_constants`.
    """

    def __init__(self, silhouette: Literal["coverage", "dibr"] = "coverage", sharpness: float = 1.0) -> None:
        self.silhouette, self._sharpness = silhouette, sharpness

    def _body(
        self, vertices: Float[Tensor, "V 3"], texture: Float[Tensor, "A A 3"] | None, camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W 4"]:
        height, width, faces = camera.height, camera.width, mesh.faces.long()
        usable = vertices[:, 2] > NEAR_M
        # Unusable vertices must not even be divided: a NaN would spread through their zero gradient.
        safe = torch.where(usable[:, None], vertices, vertices.new_tensor([0.0, 0.0, 1.0]))
        xy, inverse_depth = camera.project(safe), 1 / safe[:, 2]
        front = front_faces(xy.detach(), usable, faces)
        edges = outline_edges(front, mesh)
        seen = visible_faces(xy, inverse_depth, front, faces, height, width)
        inside = seen >= 0
        if self.silhouette == "dibr":
            countable = usable[faces].all(1)
            owners = countable.nonzero().squeeze(1)
            alpha, sides = soft_mask(xy, faces[countable], owners, inside, camera, self._sharpness)
            rim = sides[..., 2] >= 0
        else:
            alpha, closest = coverage(xy, edges, height, width), rim_edges(xy, edges, height, width)
            rim, sides = (closest >= 0) & ~inside, edges[closest] if len(edges) else edges.new_zeros(height, width, 3)
        if texture is None:
            return torch.cat([alpha.new_zeros(height, width, 3), alpha[..., None]], -1)
        centres = torch.stack(
            torch.meshgrid(torch.arange(width) + 0.5, torch.arange(height) + 0.5, indexing="xy"), -1
        ).to(xy)
        uv = xy.new_zeros(height, width, 2)
        uv = uv.index_put((inside,), _uv_of_faces(centres[inside], seen[inside], xy, inverse_depth, mesh))
        uv = uv.index_put((rim,), _uv_of_edges(centres[rim], sides[rim], xy, inverse_depth, mesh))
        colour = sample_texture(texture, uv.reshape(-1, 2)).reshape(height, width, 3) * (inside | rim)[..., None]
        return torch.cat([colour * alpha[..., None], alpha[..., None]], -1)

    def render(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "S H W 4"]:
        """Return one image per sub-frame: R_S R_F and R_S.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light; None draws silhouettes alone.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        return torch.stack([self._body(body, texture, camera, mesh) for body in vertices])
