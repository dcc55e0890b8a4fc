"""The fast rasteriser: compiled kernels behind torch operators (visible to autograd, torch.compile and export).

Each operator draws all sub-frames and averages them on the way, one body at a time in a fixed order, so the
result has the same bits for any number of threads.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch

from hfb.body.mesh import Mesh
from hfb.render import kernels, kernels_dibr
from hfb.render.camera import PinholeCamera
from hfb.render.rasterizer import NEAR_M
from hfb.render.reference_dibr import dibr_constants
from hfb.render.threads import run_tasks
from hfb.shapes import Array, Float, Tensor

TEXTURE_GROUPS = 8  # partial sums of the texture's gradient: fixed, so that the sum's order never depends on threads


@torch.library.custom_op("hfb::draw", mutates_args=())
def draw(
    vertices: Tensor, texture: Tensor, uv: Tensor, topology: Sequence[Tensor], lens: Sequence[float],
    soft: Sequence[float], mean: bool, threads: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    """Pictures (1 or S, H, W, 4) and what the way back needs: the bodies' traces (see `kernels`), their pixels'
    codes, and where each body's part of these lists ends."""
    faces, uv_faces, edge_vertices, edge_faces = _indices(topology)
    corners, colours, coordinates = vertices.detach().numpy(), texture.detach().numpy(), uv.numpy()
    view, halo = np.asarray(lens), np.asarray(soft, np.float64)
    count = corners.shape[0]

    def task(s: int) -> tuple[Array, ...]:
        if soft[0] > 0:
            return kernels_dibr.draw_body_softly(corners[s], view, halo, faces, coordinates, uv_faces, colours)
        return kernels.draw_body(corners[s], view, faces, coordinates, uv_faces, edge_vertices, edge_faces, colours)

    bodies = run_tasks(task, count, threads)
    pictures = _pictures(count, mean, view, vertices.dtype, 4)
    scale = colours.dtype.type(1 / count if mean else 1)
    for s, body in enumerate(bodies):
        kernels.add_picture(body[2], body[8], scale, pictures[0 if mean else s].reshape(-1, 4))
    return torch.from_numpy(pictures), *_join(bodies, range(8))


def _indices(topology: Sequence[Tensor]) -> tuple[Array, Array, Array, Array]:
    """Faces, their texture corners, edges, and the edges' faces; unsigned but for the last, where -1 is none.

    Unsigned because numba tests every signed index for being negative.
    """
    faces, uv_faces, edge_vertices, edge_faces = (table.numpy() for table in topology)
    return faces.view(np.uint32), uv_faces.view(np.uint32), edge_vertices.view(np.uint32), edge_faces


def _pictures(count: int, mean: bool, view: Array, dtype: torch.dtype, channels: int) -> Array:
    width, height = int(view[5]), int(view[6])
    return np.zeros(
        (1 if mean else count, height, width, channels), np.float64 if dtype == torch.float64 else np.float32
    )


def _join(bodies: list[tuple[Array, ...]], parts: Sequence[int]) -> list[Tensor]:
    """Parts of the bodies' traces end to end, and per body the ends of its outline, pixels and overlaps there."""
    ends = np.cumsum([[len(body[1]), len(body[2]), len(body[4])] for body in bodies], 0)
    joined = [np.concatenate([body[part] for body in bodies]) for part in parts]
    joined[1] = joined[1].view(np.int32)
    return [torch.from_numpy(part) for part in (*joined, ends)]


def _trace(kept: Sequence[Tensor], count: int) -> list[tuple[Array, ...]]:
    """Each body's trace (see `kernels`), then its codes where there are any: `_join` undone."""
    projected, outline, pixels, coverage, owner, edge, weights, *codes, ends = (part.numpy() for part in kept)
    starts = np.concatenate([np.zeros_like(ends[:1]), ends])
    traces = []
    for s in range(count):
        e, p, o = (slice(starts[s, k], starts[s + 1, k]) for k in range(3))
        body = projected.reshape(count, -1, 3)[s], outline.view(np.uint32)[e], pixels[p], coverage[p]
        traces.append((*body, owner[o], edge[o], weights[o], *(code[p] for code in codes)))
    return traces


def _fake_trace(vertices: Tensor) -> list[Tensor]:
    """Shapes of a trace as `_join` gives it: the lengths depend on what is seen."""
    context = torch.library.get_ctx()
    edges, pixels, overlaps = (context.new_dynamic_size() for _ in range(3))
    whole = {"dtype": torch.int32, "device": vertices.device}
    real = {"dtype": torch.float64, "device": vertices.device}
    return [
        torch.empty(vertices.shape[0] * vertices.shape[1], 3, **real),
        torch.empty(edges, 3, **whole),
        torch.empty(pixels, **whole),
        torch.empty(pixels, **real),
        torch.empty(overlaps, **whole),
        torch.empty(overlaps, **whole),
        torch.empty(overlaps, 2, **real),
    ]


def _fake_ends(vertices: Tensor) -> Tensor:
    return vertices.new_empty(vertices.shape[0], 3, dtype=torch.int64)


@draw.register_fake
def _(vertices, texture, uv, topology, lens, soft, mean, threads):
    trace = _fake_trace(vertices)
    pictures = vertices.new_empty(1 if mean else vertices.shape[0], int(lens[6]), int(lens[5]), 4)
    return pictures, *trace, torch.empty_like(trace[2]), _fake_ends(vertices)


@torch.library.custom_op("hfb::draw_gradient", mutates_args=())
def draw_gradient(
    pictures: Tensor, vertices: Tensor, texture: Tensor, uv: Tensor, topology: Sequence[Tensor],
    lens: Sequence[float], is_soft: bool, kept: Sequence[Tensor], of_vertices: bool, of_texture: bool, threads: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Gradients of the vertices (S, V, 3) and of the texture (A, A, 3), empty where not asked for."""
    faces, uv_faces, _, _ = _indices(topology)
    corners, colours, coordinates = vertices.detach().numpy(), texture.detach().numpy(), uv.numpy()
    given = pictures.detach().contiguous().numpy()
    count, mean = corners.shape[0], given.shape[0] != corners.shape[0]
    groups = min(count, TEXTURE_GROUPS)
    gradient = np.empty_like(corners) if of_vertices else np.empty((count, 0, 3), corners.dtype)
    partial = np.zeros((groups, *(colours.shape if of_texture else (0, 0, 3))), colours.dtype)
    scale = corners.dtype.type(1 / count if mean else 1)
    view, traces = np.asarray(lens), _trace(kept, count)
    way_back = kernels_dibr.draw_body_softly_gradient if is_soft else kernels.draw_body_gradient

    def task(group: int) -> None:
        for s in range(group * count // groups, (group + 1) * count // groups):
            way_back(
                corners[s], view, faces, coordinates, uv_faces, colours, traces[s][:7], traces[s][7],
                given[0 if mean else s].reshape(-1, 4), scale, gradient[s], partial[group],
            )  # fmt: skip

    run_tasks(task, groups, threads)
    return torch.from_numpy(gradient), torch.from_numpy(partial.sum(0))


@draw_gradient.register_fake
def _(pictures, vertices, texture, uv, topology, lens, is_soft, kept, of_vertices, of_texture, threads):
    gradient = torch.empty_like(vertices) if of_vertices else vertices.new_empty(vertices.shape[0], 0, 3)
    return gradient, torch.empty_like(texture) if of_texture else texture.new_empty(0, 0, 3)


def _keep_draw(ctx, inputs, output) -> None:
    vertices, texture, uv, topology, lens, soft, _, threads = inputs
    ctx.save_for_backward(vertices, texture, uv, *topology, *output[1:])
    ctx.lens, ctx.is_soft, ctx.threads = lens, soft[0] > 0, threads
    ctx.set_materialize_grads(False)


def _draw_backward(ctx, of_pictures, *_):
    if of_pictures is None:
        return None, None, None, [None] * 4, None, None, None, None
    vertices, texture, uv, *tables = ctx.saved_tensors
    of_vertices, of_texture = ctx.needs_input_grad[:2]
    by_vertices, by_texture = draw_gradient(
        of_pictures, vertices, texture, uv, tables[:4], ctx.lens, ctx.is_soft, tables[4:], of_vertices, of_texture,
        ctx.threads,
    )  # fmt: skip
    return (
        by_vertices if of_vertices else None, by_texture if of_texture else None, None, [None] * 4, None, None, None, None
    )  # fmt: skip


draw.register_autograd(_draw_backward, setup_context=_keep_draw)


@torch.library.custom_op("hfb::cover", mutates_args=())
def cover(
    vertices: Tensor, topology: Sequence[Tensor], lens: Sequence[float], soft: Sequence[float], mean: bool, threads: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Silhouettes (1 or S, H, W) and what the way back needs, as `draw` but without colours."""
    faces, _, edge_vertices, edge_faces = _indices(topology)
    corners, view, halo = vertices.detach().numpy(), np.asarray(lens), np.asarray(soft, np.float64)
    count = corners.shape[0]

    def task(s: int) -> tuple[Array, ...]:
        if soft[0] > 0:
            return kernels_dibr.cover_body_softly(corners[s], view, halo, faces)
        return kernels.cover_body(corners[s], view, faces, edge_vertices, edge_faces)

    bodies = run_tasks(task, count, threads)
    pictures = _pictures(count, mean, view, vertices.dtype, 1)[..., 0]
    for s, body in enumerate(bodies):
        kernels.add_silhouette(body[2], body[3], 1 / count if mean else 1.0, pictures[0 if mean else s].reshape(-1))
    return torch.from_numpy(pictures), *_join(bodies, range(7))


@cover.register_fake
def _(vertices, topology, lens, soft, mean, threads):
    pictures = vertices.new_empty(1 if mean else vertices.shape[0], int(lens[6]), int(lens[5]))
    return pictures, *_fake_trace(vertices), _fake_ends(vertices)


@torch.library.custom_op("hfb::cover_gradient", mutates_args=())
def cover_gradient(
    pictures: Tensor,
    vertices: Tensor,
    topology: Sequence[Tensor],
    lens: Sequence[float],
    is_soft: bool,
    kept: Sequence[Tensor],
    threads: int,
) -> Tensor:
    """Gradient of the vertices (S, V, 3)."""
    corners, view = vertices.detach().numpy(), np.asarray(lens)
    given = pictures.detach().contiguous().numpy()
    count, mean = corners.shape[0], given.shape[0] != corners.shape[0]
    gradient, traces = np.empty_like(corners), _trace(kept, count)
    faces = _indices(topology)[0]

    def task(s: int) -> None:
        picture = given[0 if mean else s].reshape(-1)
        scale = 1 / count if mean else 1.0
        if is_soft:
            kernels_dibr.cover_body_softly_gradient(corners[s], view, faces, traces[s], picture, scale, gradient[s])
        else:
            kernels.cover_body_gradient(corners[s], view, traces[s], picture, scale, gradient[s])

    run_tasks(task, count, threads)
    return torch.from_numpy(gradient)


@cover_gradient.register_fake
def _(pictures, vertices, topology, lens, is_soft, kept, threads):
    return torch.empty_like(vertices)


def _keep_cover(ctx, inputs, output) -> None:
    vertices, topology, lens, soft, _, threads = inputs
    ctx.save_for_backward(vertices, *topology, *output[1:])
    ctx.lens, ctx.is_soft, ctx.threads = lens, soft[0] > 0, threads
    ctx.set_materialize_grads(False)


def _cover_backward(ctx, of_pictures, *_):
    if of_pictures is None:
        return None, [None] * 4, None, None, None, None
    vertices, *tables = ctx.saved_tensors
    gradient = cover_gradient(of_pictures, vertices, tables[:4], ctx.lens, ctx.is_soft, tables[4:], ctx.threads)
    return gradient, [None] * 4, None, None, None, None


cover.register_autograd(_cover_backward, setup_context=_keep_cover)


class CpuRasterizer:
    """The Protocol of `hfb.render.rasterizer` by compiled kernels, in float32 or float64 (kernels add in float64)."""

    def __init__(self, silhouette: Literal["coverage", "dibr"] = "coverage", threads: int = 1) -> None:
        self.silhouette = silhouette
        self.threads = threads
        self._tables: tuple[Mesh, Tensor, list[Tensor]] | None = None

    def _of_mesh(self, mesh: Mesh) -> tuple[Tensor, list[Tensor]]:
        """Texture coordinates in float64 and index tables in int32, kept for the mesh used last."""
        tables = self._tables
        if tables is None or tables[0] is not mesh:
            index = [mesh.faces, mesh.uv_faces, mesh.edge_vertices, mesh.edge_faces]
            whole = [table.to(torch.int32).contiguous() for table in index]
            tables = self._tables = (mesh, mesh.uv.detach().double().contiguous(), whole)
        return tables[1], tables[2]

    def _soft(self, camera: PinholeCamera) -> list[float]:
        return [0.0, 0.0, 0.0] if self.silhouette == "coverage" else [float(value) for value in dibr_constants(camera)]

    def _draw(self, vertices: Tensor, texture: Tensor | None, camera: PinholeCamera, mesh: Mesh, mean: bool) -> Tensor:
        uv, topology = self._of_mesh(mesh)
        lens, soft = lens_of(camera), self._soft(camera)
        vertices = vertices.contiguous()
        if texture is None:
            alpha = cover(vertices, topology, lens, soft, mean, self.threads)[0]
            return torch.cat([alpha.new_zeros(*alpha.shape, 3), alpha[..., None]], -1)
        # A fourth channel of ones: four at a time suit the processor, and the fourth is the silhouette itself.
        texture = torch.nn.functional.pad(texture.to(vertices.dtype), (0, 1), value=1.0)
        return draw(vertices, texture, uv, topology, lens, soft, mean, self.threads)[0]

    def render(
        self,
        vertices: Float[Tensor, "S V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
    ) -> Float[Tensor, "S H W 4"]:
        """One picture per sub-frame: R_S R_F and R_S."""
        return self._draw(vertices, texture, camera, mesh, False)

    def render_mean(
        self,
        vertices: Float[Tensor, "S V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
    ) -> Float[Tensor, "H W 4"]:
        """Mean of `render` over the sub-frames, without holding the single pictures."""
        return self._draw(vertices, texture, camera, mesh, True)[0]

    def silhouette_mean(
        self, vertices: Float[Tensor, "S V 3"], camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W"]:
        """Mean of R_S over the sub-frames."""
        _, topology = self._of_mesh(mesh)
        return cover(vertices.contiguous(), topology, lens_of(camera), self._soft(camera), True, self.threads)[0][0]


def lens_of(camera: PinholeCamera) -> list[float]:
    """What the kernels take of a camera."""
    return [camera.fx, camera.fy, camera.cx, camera.cy, NEAR_M, float(camera.width), float(camera.height)]
