"""The fast rasteriser in torch: operators for autograd, torch.compile and export, and a faster path without them.

`draw` renders all sub-frames and averages them in the same pass, one body at a time in a fixed order: the result has
the same bits for any number of threads. `draw_gradient` is its backward pass. Both pass a body's trace as tensors;
where nothing is traced, `pictures` does the same without them, which saves a tenth of the time.
"""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from hfb.kernels.rendering.render_blocks import Block, Box, Setting, bodies_at_once, bodies_backward, draw_bodies
from hfb.typing import Array, Tensor

_PARTS = 9  # tensors kept of each block of bodies: its trace, see `render_block`


def pictures(vertices: Tensor, texture: Tensor, setting: Setting) -> Tensor:
    """Return the first result of `draw`, differentiable in the vertices and the texture, without tracing.

    Args:
        vertices: (S, V, 3) [m], camera coordinates.
        texture: (A, A, 3), linear light; with A = 0 only silhouettes are drawn.
        setting: camera, mesh and options.
    """
    return _Pictures.apply(vertices, texture, setting)


class _Pictures(torch.autograd.Function):
    """`draw` with its backward pass, the bodies' traces kept as they are."""

    @staticmethod
    def forward(ctx: Any, vertices: Tensor, texture: Tensor, setting: Setting) -> Tensor:
        return torch.from_numpy(_drawn(ctx, vertices, texture, setting)[0])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_pictures: Tensor) -> tuple[Tensor | None, ...]:
        return *_input_gradients(ctx, of_pictures.contiguous().numpy()), None


@runtime_checkable
class ImageLoss(Protocol):
    """Losses of a mean image (H, W, 4) with their gradient."""

    def compare(self, mean: Array, box: Box) -> tuple[tuple[float, ...], Any]:
        """Return the losses, and values saved for `backward`.

        Args:
            mean: (H, W, 4), zero outside of the box; may be overwritten.
            box: box of all that is drawn.
        """
        ...

    def backward(self, saved: Any, grad_losses: Sequence[float]) -> Array:
        """Return the gradient by the image; only values inside the box are used.

        Args:
            saved: by `compare`.
            grad_losses: gradient by each loss.
        """
        ...


def losses_of(vertices: Tensor, texture: Tensor, setting: Setting, loss: ImageLoss) -> tuple[Tensor, ...]:
    """Return losses of the mean of `pictures`, differentiable in the vertices and the texture.

    Rendering and losses are one autograd node: the overhead of a second one is as large as the losses' time.

    Args:
        vertices: (S, V, 3) [m], camera coordinates.
        texture: (A, A, 3), linear light; with A = 0 only silhouettes are drawn.
        setting: camera, mesh and options.
        loss: loss of the mean image.
    """
    return _RenderedLosses.apply(vertices, texture, setting, loss)


class _RenderedLosses(torch.autograd.Function):
    """A rendered mean image and its losses."""

    @staticmethod
    def forward(ctx: Any, vertices: Tensor, texture: Tensor, setting: Setting, loss: ImageLoss) -> tuple[Tensor, ...]:
        drawn, box = _drawn(ctx, vertices, texture, setting)
        losses, ctx.kept = loss.compare(drawn[0], box)
        ctx.loss = loss
        return tuple(torch.from_numpy(np.asarray(one, drawn.dtype)) for one in losses)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_losses: Tensor) -> tuple[Tensor | None, ...]:
        grad_image = ctx.loss.backward(ctx.kept, [one.item() for one in grad_losses])
        return *_input_gradients(ctx, grad_image[None]), None, None


def _drawn(ctx: Any, vertices: Tensor, texture: Tensor, setting: Setting) -> tuple[Array, Box]:
    """Return images and the box around all that is drawn; save values for `_input_gradients`."""
    drawn, texels, blocks, box = draw_bodies(vertices.detach().numpy(), texture.detach().numpy(), setting)
    ctx.save_for_backward(vertices, texture)  # detects changes in the meantime
    ctx.setting, ctx.texels, ctx.blocks = setting, texels, blocks
    return drawn, box


def _input_gradients(ctx: Any, of_pictures: Array) -> tuple[Tensor | None, Tensor | None]:
    """Return the wanted gradients by the vertices and by the texture."""
    vertices, texture = ctx.saved_tensors
    wanted = ctx.needs_input_grad[0], ctx.needs_input_grad[1] and len(texture) > 0
    of_vertices, of_texture = bodies_backward(
        of_pictures, vertices.detach().numpy(), ctx.texels, ctx.blocks, ctx.setting, *wanted
    )
    return torch.from_numpy(of_vertices) if wanted[0] else None, torch.from_numpy(of_texture) if wanted[1] else None


@torch.library.custom_op("hfb::draw", mutates_args=())
def draw(
    vertices: Tensor,
    texture: Tensor,
    uv: Tensor,
    topology: Sequence[Tensor],
    lens: Sequence[float],
    soft: Sequence[float],
    mean: bool,
    threads: int,
) -> tuple[Tensor, list[Tensor]]:
    """Return images of S bodies, and saved values for the backward pass.

    Args:
        vertices: (S, V, 3) [m].
        texture: (A, A, 3), linear RGB; with A = 0 only silhouettes are drawn.
        uv: (F, 3, 2), of the faces' corners.
        topology: tables faces, edge_vertices, edge_faces of the mesh, int16 (read as unsigned) where that holds them,
            else int32.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        soft: DIB-R's 1 / delta [1/px^2], reach [px] and number of faces; zeros for exact coverage.
        mean: average the images.
        threads: number of threads.

    Returns:
        images (1 or S, H, W, 4), or (1 or S, H, W, 1) of silhouettes; then the texture with a fourth channel of ones,
        and for each block of bodies in turn the parts of its trace (see `render_block`).
    """
    setting = Setting.of(uv, topology, lens, soft, mean, threads)
    drawn, texels, blocks, _ = draw_bodies(vertices.detach().numpy(), texture.detach().numpy(), setting)
    kept = [texels]
    for trace in blocks:
        kept += [trace[0], trace[1].view(np.int32), *trace[2:]]  # types that torch knows
    return torch.from_numpy(drawn), [torch.from_numpy(part) for part in kept]


@draw.register_fake
def _(
    vertices: Tensor,
    texture: Tensor,
    uv: Tensor,
    topology: Sequence[Tensor],
    lens: Sequence[float],
    soft: Sequence[float],
    mean: bool,
    threads: int,
) -> tuple[Tensor, list[Tensor]]:
    context, coloured = torch.library.get_ctx(), texture.shape[0] > 0

    def whole(*size: int | torch.SymInt) -> Tensor:
        return vertices.new_empty(*size, dtype=torch.int32)

    def real(*size: int | torch.SymInt) -> Tensor:
        return vertices.new_empty(*size, dtype=torch.float64)

    kept = [vertices.new_empty(texture.shape[0], texture.shape[1], 4)]
    at_once = bodies_at_once(len(vertices), threads, soft[0] > 0)
    for first in range(0, len(vertices), at_once):
        edges, pixels, pieces = (context.new_dynamic_size() for _ in range(3))
        bodies = min(at_once, len(vertices) - first)
        kept += [real(bodies, vertices.shape[1], 4), whole(edges, 3), whole(pixels), real(pixels)]
        kept += [whole(pieces), whole(pieces), real(pieces) if soft[0] > 0 else real(pieces, 2)]
        kept += [whole(pixels if coloured else 0), vertices.new_empty(bodies + 1, 3, dtype=torch.int64)]
    size = 1 if mean else len(vertices), int(lens[6]), int(lens[5]), 4 if coloured else 1
    return vertices.new_empty(*size), kept


@torch.library.custom_op("hfb::draw_gradient", mutates_args=())
def draw_gradient(
    of_pictures: Tensor,
    vertices: Tensor,
    uv: Tensor,
    topology: Sequence[Tensor],
    lens: Sequence[float],
    soft: Sequence[float],
    mean: bool,
    kept: Sequence[Tensor],
    of_vertices: bool,
    of_texture: bool,
    threads: int,
) -> tuple[Tensor, Tensor]:
    """Return the gradients by the vertices (S, V, 3) and by the texture (A, A, 3).

    Args:
        of_pictures: gradient by the images.
        vertices: (S, V, 3) [m], camera coordinates.
        uv: as of `draw`.
        topology: as of `draw`.
        lens: as of `draw`.
        soft: as of `draw`.
        mean: as of `draw`.
        kept: saved by `draw`.
        of_vertices: compute the first one, else it is empty.
        of_texture: compute the second one, else it is empty.
        threads: number of threads.
    """
    texels, *parts = (part.detach().numpy() for part in kept)
    blocks = [_block(parts[s : s + _PARTS]) for s in range(0, len(parts), _PARTS)]
    setting = Setting.of(uv, topology, lens, soft, mean, threads)
    grad_output = of_pictures.detach().contiguous().numpy()
    gradients = bodies_backward(
        grad_output, vertices.detach().numpy(), texels, blocks, setting, of_vertices, of_texture
    )
    return torch.from_numpy(gradients[0]), torch.from_numpy(gradients[1])


def _block(parts: Sequence[Any]) -> Block:
    return parts[0], parts[1].view(np.uint32), *parts[2:]


@draw_gradient.register_fake
def _(_of_pictures: Tensor, vertices: Tensor, *others: Any) -> tuple[Tensor, Tensor]:
    *_, kept, of_vertices, of_texture, _threads = others
    gradient = torch.empty_like(vertices) if of_vertices else vertices.new_empty(len(vertices), 0, 3)
    side = kept[0].shape[0] if of_texture else 0
    return gradient, vertices.new_empty(side, side, 3)


def _keep(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    vertices, texture, uv, topology, *ctx.numbers, ctx.threads = inputs
    ctx.coloured = len(texture) > 0
    ctx.save_for_backward(vertices, uv, *topology, *output[1])
    ctx.set_materialize_grads(False)


def _backward(ctx, of_pictures, *_):  # type: ignore[no-untyped-def]
    no_gradient = None, [None] * 3, None, None, None, None
    if of_pictures is None:
        return None, None, *no_gradient
    vertices, uv, *tables = ctx.saved_tensors
    wanted = ctx.needs_input_grad[0], ctx.needs_input_grad[1] and ctx.coloured
    gradients = draw_gradient(of_pictures, vertices, uv, tables[:3], *ctx.numbers, tables[3:], *wanted, ctx.threads)
    return *(gradient if want else None for gradient, want in zip(gradients, wanted, strict=True)), *no_gradient


draw.register_autograd(_backward, setup_context=_keep)
