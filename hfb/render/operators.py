"""The fast rasteriser as torch operators, so that autograd, torch.compile and export see them.

`draw` draws all sub-frames and averages them on the way, one body at a time in a fixed order: the result has the
same bits for any number of threads. `draw_gradient` is its way back.
"""

from collections.abc import Sequence

import numpy as np
import torch

from hfb.render import kernels, kernels_dibr
from hfb.render.threads import run_tasks
from hfb.shapes import Array, Tensor

TEXTURE_GROUPS = 4  # partial sums of the texture's gradient: fixed, so that the sum's order never depends on threads
PARTS = 8  # tensors kept of each body: its trace (see `kernels`) and its pixels' codes


def _indices(topology: Sequence[Tensor]) -> list[Array]:
    """Faces, edges, and the edges' faces, unsigned (-1, no face, becomes the largest number).

    Unsigned because numba tests every signed index for being negative.
    """
    return [table.numpy().view(np.uint16 if table.dtype == torch.int16 else np.uint32) for table in topology]


@torch.library.custom_op("hfb::draw", mutates_args=())
def draw(
    vertices: Tensor, texture: Tensor, uv: Tensor, topology: Sequence[Tensor], lens: Sequence[float],
    soft: Sequence[float], mean: bool, threads: int,
) -> tuple[Tensor, list[Tensor]]:  # fmt: skip
    """Pictures of S bodies, and what the way back needs.

    Args:
        vertices: (S, V, 3) [m]. texture: (A, A, 4), linear RGB and ones; with A = 0 only silhouettes are drawn.
        uv: (F, 3, 2), of the faces' corners. topology: tables faces, edge_vertices, edge_faces of the mesh, int16
            (read as unsigned) where that holds them, else int32.
        lens: fx, fy, cx, cy, nearest depth used, width, height. soft: DIB-R's 1 / delta [1/px^2], reach [px] and
            number of faces; zeros for exact coverage.
        mean: average the pictures. threads: to draw with.

    Returns:
        pictures (1 or S, H, W, 4), or (1 or S, H, W, 1) of silhouettes; for each body in turn the seven parts of its
        trace (see `kernels`) and its pixels' codes.
    """
    faces, edge_vertices, edge_faces = _indices(topology)
    corners, colours, coordinates = vertices.detach().numpy(), texture.detach().numpy(), uv.numpy()
    view, halo, count = np.asarray(lens), np.asarray(soft), len(vertices)
    coloured, is_soft = len(colours) > 0, soft[0] > 0

    def task(s: int) -> tuple[Array, ...]:
        if is_soft and coloured:
            return kernels_dibr.draw_body_softly(corners[s], view, halo, faces, coordinates, colours)
        if is_soft:
            return kernels_dibr.cover_body_softly(corners[s], view, halo, faces)
        if coloured:
            tables = faces, coordinates, edge_vertices, edge_faces
            return kernels.draw_body(corners[s], view, *tables, colours)
        return kernels.cover_body(corners[s], view, faces, edge_vertices, edge_faces)

    bodies = run_tasks(task, count, threads)
    size = (1 if mean else count, int(lens[6]), int(lens[5]), 4 if coloured else 1)
    pictures = np.zeros(size, corners.dtype)
    scale = corners.dtype.type(1 / count if mean else 1)
    for s, body in enumerate(bodies):
        picture = pictures[0 if mean else s].reshape(-1, size[3])
        if coloured:
            kernels.add_picture(body[2], body[8], scale, picture)
        else:
            kernels.add_silhouette(body[2], body[3], scale, picture)
    return torch.from_numpy(pictures), [torch.from_numpy(part) for body in bodies for part in _signed(body)]


def _signed(body: tuple[Array, ...]) -> list[Array]:
    """What is kept of a body, in types that torch knows."""
    trace, codes = body[:7], body[7] if len(body) > 7 else np.empty(0, np.int32)
    return [trace[0], trace[1].view(np.int32), *trace[2:], codes]


def _trace(kept: Sequence[Tensor], s: int) -> tuple[Array, ...]:
    """The trace of body s."""
    projected, outline, *rest = (part.detach().numpy() for part in kept[PARTS * s : PARTS * s + 7])
    return (projected, outline.view(np.uint32), *rest)


@draw.register_fake
def _(
    vertices: Tensor, texture: Tensor, uv: Tensor, topology: Sequence[Tensor], lens: Sequence[float],
    soft: Sequence[float], mean: bool, threads: int,
) -> tuple[Tensor, list[Tensor]]:  # fmt: skip
    context, coloured = torch.library.get_ctx(), texture.shape[0] > 0

    def whole(*size: int | torch.SymInt) -> Tensor:
        return vertices.new_empty(*size, dtype=torch.int32)

    def real(*size: int | torch.SymInt) -> Tensor:
        return vertices.new_empty(*size, dtype=torch.float64)

    kept = []
    for _ in range(len(vertices)):
        edges, pixels, pieces = (context.new_dynamic_size() for _ in range(3))
        kept += [real(vertices.shape[1], 3), whole(edges, 3), whole(pixels), real(pixels)]
        kept += [
            whole(pieces),
            whole(pieces),
            real(pieces) if soft[0] > 0 else real(pieces, 2),
            whole(pixels if coloured else 0),
        ]
    size = 1 if mean else len(vertices), int(lens[6]), int(lens[5]), 4 if coloured else 1
    return vertices.new_empty(*size), kept


@torch.library.custom_op("hfb::draw_gradient", mutates_args=())
def draw_gradient(
    pictures: Tensor, vertices: Tensor, texture: Tensor, uv: Tensor, topology: Sequence[Tensor],
    lens: Sequence[float], is_soft: bool, kept: Sequence[Tensor], of_vertices: bool, of_texture: bool, threads: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Gradients of the vertices (S, V, 3) and of the texture (A, A, 4), empty where not asked for."""
    faces = _indices(topology)[0]
    corners, colours, coordinates = vertices.detach().numpy(), texture.detach().numpy(), uv.numpy()
    given, view, count = pictures.detach().contiguous().numpy(), np.asarray(lens), len(vertices)
    groups, mean = min(count, TEXTURE_GROUPS), len(pictures) != count
    gradient = np.empty_like(corners) if of_vertices else np.empty((count, 0, 3), corners.dtype)
    partial = np.zeros((groups, *colours.shape) if of_texture else (groups, 0, 0, 4), colours.dtype)
    scale = corners.dtype.type(1 / count if mean else 1)

    def pull(s: int, group: int) -> None:
        trace, codes = _trace(kept, s), kept[PARTS * s + 7].numpy()
        picture = given[0 if mean else s].reshape(-1, given.shape[3])
        if len(colours):
            way_back = kernels_dibr.draw_body_softly_gradient if is_soft else kernels.draw_body_gradient
            tables = faces, coordinates, colours
            way_back(corners[s], view, *tables, trace, codes, picture, scale, gradient[s], partial[group])
        elif is_soft:
            kernels_dibr.cover_body_softly_gradient(corners[s], view, faces, trace, picture, scale, gradient[s])
        else:
            kernels.cover_body_gradient(corners[s], view, trace, picture, scale, gradient[s])

    def task(group: int) -> None:
        for s in range(group * count // groups, (group + 1) * count // groups):
            pull(s, group)

    run_tasks(task, groups, threads)
    return torch.from_numpy(gradient), torch.from_numpy(partial.sum(0))


@draw_gradient.register_fake
def _(
    pictures: Tensor, vertices: Tensor, texture: Tensor, uv: Tensor, topology: Sequence[Tensor],
    lens: Sequence[float], is_soft: bool, kept: Sequence[Tensor], of_vertices: bool, of_texture: bool, threads: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    gradient = torch.empty_like(vertices) if of_vertices else vertices.new_empty(len(vertices), 0, 3)
    return gradient, torch.empty_like(texture) if of_texture else texture.new_empty(0, 0, 4)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    vertices, texture, uv, topology, lens, soft, _, threads = inputs
    ctx.save_for_backward(vertices, texture, uv, *topology, *output[1])
    ctx.lens, ctx.is_soft, ctx.threads = lens, soft[0] > 0, threads
    ctx.set_materialize_grads(False)


def _backward(ctx, of_pictures, *_):  # type: ignore[no-untyped-def]
    no_gradient = None, [None] * 3, None, None, None, None
    if of_pictures is None:
        return None, None, *no_gradient
    vertices, texture, uv, *tables = ctx.saved_tensors
    wanted = ctx.needs_input_grad[0], ctx.needs_input_grad[1] and len(texture) > 0
    gradients = draw_gradient(
        of_pictures, vertices, texture, uv, tables[:3], ctx.lens, ctx.is_soft, tables[3:], *wanted, ctx.threads
    )
    return *(gradient if want else None for gradient, want in zip(gradients, wanted, strict=True)), *no_gradient


draw.register_autograd(_backward, setup_context=_keep)
