"""The Warp kernels as torch operators: one set for CUDA devices and, for tests, for Warp's CPU device.

`draw_by_warp` draws any number of bodies at once and averages runs of them; `draw_by_warp_gradient` is its backward.
Tensors are passed without copies, on the caller's stream. Every result has the same bits on every run.
"""

import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import torch
import warp as wp

from hfb.kernels.warp import gradient as gradients
from hfb.kernels.warp import outline as outlines
from hfb.kernels.warp import screen, surface
from hfb.typing import Tensor

_ready: set[str] = set()
_loading = threading.Lock()
_EXACT = 62  # bits of the texture gradient's sums


def _prepare(tensor: Tensor) -> AbstractContextManager:
    """Compile the kernels for the tensor's device (once per machine), and launch them on torch's own stream."""
    name = str(tensor.device)
    with _loading:
        if name not in _ready:
            wp.init()
            for module in (screen, outlines, surface, gradients):
                wp.load_module(module, wp.device_from_torch(tensor.device))
            _ready.add(name)
    if tensor.is_cuda:
        return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(tensor.device)))
    return nullcontext()


def _array(tensor: Tensor, dtype: type | None = None) -> object:
    """Return a tensor as an array of Warp, in the same memory."""
    return wp.from_torch(tensor.detach(), dtype, requires_grad=False)


def _points(tensor: Tensor) -> object:
    """Return rows of three as vectors."""
    return _array(tensor, wp.vec3d)


def _mask(topology: Sequence[Tensor]) -> object:
    """Return a mask of the bits that hold any index of a face or an edge."""
    return wp.int64((1 << (max(len(topology[0]), len(topology[1])) - 1).bit_length()) - 1)


def _launch(kernel: object, size: Sequence[int], tensor: Tensor, *arguments: object) -> None:
    if min(size) > 0:
        wp.launch(kernel, tuple(size), list(arguments), device=wp.device_from_torch(tensor.device))


@torch.library.custom_op("hfb::draw_by_warp", mutates_args=())
def draw_by_warp(
    vertices: Tensor,
    textures: Tensor,
    uv: Tensor,
    topology: Sequence[Tensor],
    lenses: Tensor,
    size: Sequence[int],
    near: float,
) -> tuple[Tensor, list[Tensor]]:
    """Return mean images of runs of bodies, and saved values for the backward pass.

    Args:
        vertices: (B, V, 3) [m].
        textures: (G, A, A, 3), linear RGB, each of a run of images; with A = 0 only silhouettes are drawn.
        uv: (F, 3, 2) float64, of the faces' corners.
        topology: int32 tables faces, edge_vertices, edge_faces, and where each vertex's corners begin, the corners,
            where its edges' ends begin, the ends (see `gather`).
        lenses: (P, 4) float64, fx, fy, cx, cy [px] of every image; B is a multiple of P.
        size: height, width.
        near: nearest depth used [m].

    Returns:
        images (P, H, W, 4), or (P, H, W, 1) of silhouettes; projected vertices, front faces,
        first piece of each edge, places and shares of the pieces, coverage and codes of the pixels.
    """
    height, width = size
    bodies, edges, coloured, mask = len(vertices), len(topology[1]), textures.shape[1] > 0, _mask(topology)
    subframes = bodies // len(lenses)
    shape, seen_shape = (bodies, height, width), (bodies if coloured else 0, height, width)

    def real(*size: int) -> Tensor:
        return vertices.new_empty(size, dtype=torch.float64)

    def whole(*size: int, kind: torch.dtype = torch.int32) -> Tensor:
        return vertices.new_zeros(size, dtype=kind)

    with _prepare(vertices):
        faces, edge_vertices, edge_faces = (_array(table) for table in topology[:3])
        projected, front = real(bodies, vertices.shape[1], 3), whole(bodies, len(topology[0]), kind=torch.uint8)
        seen = whole(*seen_shape, kind=torch.int64)
        eye = _array(vertices), _array(lenses), subframes, wp.float64(near)
        _launch(screen.project, vertices.shape[:2], vertices, *eye, _points(projected))
        _launch(screen.see_faces, front.shape, vertices, _points(projected), faces, mask, _array(front), _array(seen))
        counts = whole(bodies, edges)
        outline = _points(projected), _array(front), edge_vertices, edge_faces
        _launch(outlines.count_pieces, counts.shape, vertices, *outline, height, width, _array(counts))
        begins = torch.nn.functional.pad(counts.flatten().cumsum(0, dtype=torch.int32), (1, 0))
        pieces = int(begins[-1])  # the only place where the CPU waits for the device
        winding, newest = whole(bodies, height, width + 1, kind=torch.int64), whole(*shape) - 1
        older, place, span, line = whole(pieces), whole(pieces, 3), real(pieces, 2), real(pieces, 4)
        chains = _array(older), _array(place, wp.vec3i), _array(span, wp.vec2d), _array(line, wp.vec4d)
        sums = _array(begins), _array(winding), _array(newest)
        _launch(outlines.wind, counts.shape, vertices, *outline, *sums, *chains)
        running = winding.cumsum(2)
        alpha, codes, shares = real(*shape), whole(*seen_shape), real(pieces, 2).zero_()
        pixels = _array(alpha), _array(codes), _array(shares, wp.vec2d)
        ends = _points(projected), edge_vertices, _array(seen), mask
        base, areas = whole(*shape), real(pieces)
        newest_of, base_of, areas_of = _array(newest), _array(base), _array(areas)
        _launch(outlines.cover, shape, vertices, _array(running), newest_of, *chains, *ends, *pixels, base_of)
        _launch(outlines.part, (pieces,), vertices, newest_of, *chains, base_of, edges, pixels[2], areas_of)
        older_of, line_of = chains[0], chains[3]
        _launch(outlines.join, shape, vertices, newest_of, older_of, line_of, base_of, areas_of, pixels[2], pixels[0])
        pictures = vertices.new_empty(len(lenses), height, width, 4 if coloured else 1)
        surfaces = *pixels[:2], *outline[:2], faces, edge_vertices, edge_faces, _array(uv, wp.vec2d), _array(textures)
        _launch(surface.shade, pictures.shape[:3], vertices, *surfaces, subframes, _array(pictures))
    return pictures, [projected, front, begins, place, shares, alpha, codes]


@draw_by_warp.register_fake
def _(
    vertices: Tensor,
    textures: Tensor,
    uv: Tensor,
    topology: Sequence[Tensor],
    lenses: Tensor,
    size: Sequence[int],
    near: float,
) -> tuple[Tensor, list[Tensor]]:
    pieces, coloured = torch.library.get_ctx().new_dynamic_size(), textures.shape[1] > 0
    bodies, (height, width) = vertices.shape[0], size

    def empty(kind: torch.dtype, *size: int | torch.SymInt) -> Tensor:
        return vertices.new_empty(size, dtype=kind)

    whole, real = torch.int32, torch.float64
    return vertices.new_empty(lenses.shape[0], height, width, 4 if coloured else 1), [
        empty(real, *vertices.shape),
        empty(torch.uint8, bodies, topology[0].shape[0]),
        empty(whole, bodies * topology[1].shape[0] + 1),
        empty(whole, pieces, 3),
        empty(real, pieces, 2),
        empty(real, bodies, height, width),
        empty(whole, bodies if coloured else 0, height, width),
    ]


@torch.library.custom_op("hfb::draw_by_warp_gradient", mutates_args=())
def draw_by_warp_gradient(
    of_pictures: Tensor,
    vertices: Tensor,
    textures: Tensor,
    uv: Tensor,
    topology: Sequence[Tensor],
    lenses: Tensor,
    kept: Sequence[Tensor],
    of_vertices: bool,
    of_textures: bool,
) -> tuple[Tensor, Tensor]:
    """Return the gradients by the vertices (B, V, 3) and by the textures (G, A, A, 3).

    Args:
        of_pictures: gradient by the images.
        vertices: as of `draw_by_warp`.
        textures: as of `draw_by_warp`.
        uv: as of `draw_by_warp`.
        topology: as of `draw_by_warp`.
        lenses: as of `draw_by_warp`.
        kept: saved by `draw_by_warp`.
        of_vertices: compute the first one, else it is empty.
        of_textures: compute the second one, else it is empty.
    """
    projected, front, begins, place, shares, alpha, codes = kept
    bodies, coloured, grad_output = len(vertices), textures.shape[1] > 0, of_pictures.contiguous()
    subframes = bodies // len(lenses)
    groups = grad_output.unflatten(0, (len(textures), -1)).flatten(1).abs().amax(1).double().clamp_min(1e-300)
    steps = 2.0**_EXACT / max(alpha.numel() // len(textures), 1) / groups  # of each texture alone
    total = vertices.new_zeros(textures.shape if of_textures else (1, 0, 0, 3), dtype=torch.int64)
    of_pixels = vertices.new_empty(*alpha.shape, 3, dtype=torch.float64)
    with _prepare(vertices):
        faces, edge_vertices, edge_faces = (_array(table) for table in topology[:3])
        seen = _points(projected), _array(front), faces
        of_uv, shown = _array(uv, wp.vec2d), _array(codes)
        surfaces = _array(alpha), shown, *seen, edge_vertices, edge_faces, of_uv, _array(textures)
        into = _array(steps), _points(of_pixels), _array(total)
        _launch(surface.pixels_backward, alpha.shape, vertices, *surfaces, subframes, _array(grad_output), *into)
        gradient = vertices.new_empty(vertices.shape if of_vertices else (bodies, 0, 3))
        if of_vertices:
            on_corners = of_pixels.new_empty(bodies if coloured else 0, len(topology[0]), 3, 3)
            on_ends = of_pixels.new_empty(bodies, len(topology[1]), 2, 3)
            if coloured:
                into_corners = _points(of_pixels), _points(on_corners)
                _launch(gradients.faces_backward, on_corners.shape[:2], vertices, *seen, of_uv, shown, *into_corners)
            pieces = _array(begins), _array(place, wp.vec3i), _array(shares, wp.vec2d)
            ends = *seen, edge_vertices, edge_faces, of_uv, *pieces, shown, _points(of_pixels), _points(on_ends)
            _launch(gradients.edges_backward, on_ends.shape[:2], vertices, *ends)
            sums = _points(on_corners), _points(on_ends), _array(gradient)
            members = *(_array(table) for table in topology[3:7]), *sums
            where = _array(vertices), _points(projected), _array(lenses), subframes
            _launch(gradients.gather, vertices.shape[:2], vertices, *where, *members)
    return gradient, (total / steps[:, None, None, None]).to(textures.dtype)


@draw_by_warp_gradient.register_fake
def _(_of_pictures: Tensor, vertices: Tensor, textures: Tensor, *others: Any) -> tuple[Tensor, Tensor]:
    *_, of_vertices, of_textures = others
    gradient = torch.empty_like(vertices) if of_vertices else vertices.new_empty(len(vertices), 0, 3)
    return gradient, torch.empty_like(textures) if of_textures else textures.new_empty(1, 0, 0, 3)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    vertices, textures, uv, topology, lenses, _, _ = inputs
    ctx.save_for_backward(vertices, textures, uv, lenses, *topology, *output[1])
    ctx.tables = len(topology)
    ctx.set_materialize_grads(False)


def _backward(ctx, of_pictures, *_):  # type: ignore[no-untyped-def]
    no_gradient = None, [None] * ctx.tables, None, None, None
    if of_pictures is None:
        return None, None, *no_gradient
    vertices, textures, uv, lenses, *tables = ctx.saved_tensors
    wanted = ctx.needs_input_grad[0], ctx.needs_input_grad[1] and textures.shape[1] > 0
    topology, kept = tables[: ctx.tables], tables[ctx.tables :]
    found = draw_by_warp_gradient(of_pictures, vertices, textures, uv, topology, lenses, kept, *wanted)
    return *(gradient if want else None for gradient, want in zip(found, wanted, strict=True)), *no_gradient


draw_by_warp.register_autograd(_backward, setup_context=_keep)
