"""Rendering of all bodies of one exposure: drawn in blocks, added in a fixed order, with gradients.

The result has the same bits for any number of threads; nothing is shared between calls.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hfb.kernels.rendering import render_block as kernels
from hfb.kernels.rendering import render_dibr as kernels_dibr
from hfb.kernels.simd import LANES
from hfb.kernels.threads import run_tasks
from hfb.typing import Array, Tensor

TEXTURE_GROUPS = 4  # partial sums of the texture's gradient: fixed, so that the sum's order never depends on threads

Block = tuple[Array, ...]
"""The trace of up to LANES bodies, see `render_block`; of DIB-R's silhouettes of one."""

Box = tuple[int, int, int, int]
"""Left, top, right and bottom of a box in an image [px], the last two exclusive."""


@dataclass(frozen=True)
class Setting:
    """The arguments common to all bodies; fields as in `hfb.kernels.rendering.render_operators.draw`."""

    uv: Array
    faces: Array
    edge_vertices: Array
    edge_faces: Array
    lens: Array
    soft: Array
    mean: bool
    threads: int

    @staticmethod
    def of(
        uv: Tensor, topology: Sequence[Tensor], lens: Sequence[float], soft: Sequence[float], mean: bool, threads: int
    ) -> "Setting":
        """Convert tensors; index tables become unsigned, since numba tests every signed index for being negative.

        An index of -1 (no face) becomes the largest number.

        Args:
            uv: (F, 3, 2), of the faces' corners.
            topology: faces, edge_vertices, edge_faces.
            lens: fx, fy, cx, cy, nearest depth used, width, height.
            soft: DIB-R's constants; zeros for exact coverage.
            mean: average the images.
            threads: number of threads.
        """
        faces, edge_vertices, edge_faces = (
            table.numpy().view(np.uint16 if table.dtype == torch.int16 else np.uint32) for table in topology
        )
        numbers = np.asarray(lens), np.asarray(soft)
        return Setting(uv.numpy(), faces, edge_vertices, edge_faces, *numbers, mean, threads)

    @property
    def is_soft(self) -> bool:
        """DIB-R's mask instead of exact coverage."""
        return bool(self.soft[0] > 0)

    def draw(self, vertices: Array, texels: Array) -> tuple[Block, Array, Array]:
        """Draw a block.

        Args:
            vertices: (n, V, 3) [m], camera coordinates.
            texels: texture (A, A, 4), the fourth channel 1.

        Returns:
            its trace, its pixels' colours (empty for silhouettes alone), and a box around them (left, top, right,
            bottom), which is the whole image for soft bodies.
        """
        if not self.is_soft:
            edges = self.edge_vertices, self.edge_faces
            *trace, colours, box = kernels.draw_block(vertices, self.lens, self.faces, self.uv, *edges, texels)
            return tuple(trace), colours, box
        if len(texels):
            inputs = self.lens, self.soft, self.faces, self.uv, texels
            projected, *parts, colours = kernels_dibr.draw_body_softly(vertices[0], *inputs)
        else:
            projected, *parts = kernels_dibr.cover_body_softly(vertices[0], self.lens, self.soft, self.faces)
            parts, colours = [*parts, np.empty(0, np.int32)], np.empty((0, 4), texels.dtype)
        ends = np.array([[0, 0, 0], [len(parts[0]), len(parts[1]), len(parts[3])]])
        return (projected[None], *parts, ends), colours, np.array([0, 0, *self.lens[5:7]], np.int64)

    def backward(
        self,
        vertices: Array,
        texels: Array,
        block: Block,
        bodies: tuple[int, int],
        grad_output: Array,
        scale: np.floating,
        gradient: Array,
        sums: Array,
        closes: Array,
        total: Array,
    ) -> None:
        """Compute the gradients of some bodies of a block; see `render_block.block_backward`.

        Args:
            vertices: (n, V, 3) [m], camera coordinates.
            texels: texture (A, A, 4), the fourth channel 1.
            block: trace of the block.
            bodies: first number and number after the last one.
            grad_output: (n or 1, H W, C), gradient by the images.
            scale: factor of the images.
            gradient: (n, V, 3), filled.
            sums: (A, A, 4), gradient by the texture, added to.
            closes: (n), bodies after which the sums are moved to `total`.
            total: (A, A, 3), gradient by the texture, added to.
        """
        tables = self.lens, self.faces, self.uv, texels
        if not self.is_soft:
            kernels.block_backward(vertices, *tables, block, *bodies, grad_output, scale, gradient, sums, closes, total)
            return
        projected, *parts, codes, _ = block
        trace, of_images = (projected[0], *parts), (grad_output[0], scale, gradient[0])
        if len(texels):
            kernels_dibr.draw_body_softly_gradient(vertices[0], *tables, trace, codes, *of_images, sums)
        else:
            kernels_dibr.cover_body_softly_gradient(vertices[0], self.lens, self.faces, trace, *of_images)
        if closes[0]:
            kernels.move_texels(sums, total)


def bodies_at_once(count: int, threads: int, soft: bool) -> int:
    """Return the number of bodies in a block: up to LANES, but work for every thread. Results do not depend on it.

    Args:
        count: number of all bodies.
        threads: number of threads.
        soft: whether silhouettes are DIB-R's.
    """
    return 1 if soft else min(LANES, max(-(-count // threads), 1))


def draw_bodies(vertices: Array, texture: Array, setting: Setting) -> tuple[Array, Array, list[Block], Box]:
    """Return images, the texture with four channels, the blocks' traces, and a box around all that is drawn.

    Args:
        vertices: (n, V, 3) [m], camera coordinates.
        texture: (A, A, 3), linear light.
        setting: camera, mesh and options.
    """
    count, lens = len(vertices), setting.lens
    # Four channels suit the CPU, and the fourth, ones drawn like the others, is the silhouette itself.
    texels = np.empty((*texture.shape[:2], 4), vertices.dtype)
    kernels.widen(texture, texels)
    at_once = bodies_at_once(count, setting.threads, setting.is_soft)
    blocks = range(0, count, at_once)
    drawn = run_tasks(
        lambda block: setting.draw(vertices[blocks[block] : blocks[block] + at_once], texels),
        len(blocks),
        setting.threads,
    )
    size = int(lens[6]), int(lens[5]), 4 if len(texels) else 1
    pictures = np.zeros((1 if setting.mean else count, *size), vertices.dtype)
    scale = vertices.dtype.type(1 / count if setting.mean else 1)
    for first, (trace, colours, _) in zip(blocks, drawn, strict=True):
        _, _, pixels, coverage, *_, ends = trace
        some = pictures if setting.mean else pictures[first : first + at_once]
        kernels.add_block(pixels, coverage, ends, colours, scale, some.reshape(len(some), -1, size[2]))
    return pictures, texels, [trace for trace, *_ in drawn], _around([box.tolist() for *_, box in drawn])


def _around(boxes: Sequence[Sequence[int]]) -> Box:
    """Return the box around all boxes, empty where nothing is drawn."""
    left, top, right, bottom = zip(*boxes, strict=True) if boxes else [(0,)] * 4
    return min(left), min(top), max(*right, min(left)), max(*bottom, min(top))


def bodies_backward(
    of_pictures: Array,
    vertices: Array,
    texels: Array,
    blocks: Sequence[Block],
    setting: Setting,
    of_vertices: bool,
    of_texture: bool,
) -> tuple[Array, Array]:
    """Return the gradients by the vertices (S, V, 3) and by the texture (A, A, 3).

    Args:
        of_pictures: (1 or S, H, W, C), gradient by the images.
        vertices: (n, V, 3) [m], camera coordinates.
        texels: texture (A, A, 4), the fourth channel 1.
        blocks: traces of the blocks.
        setting: camera, mesh and options.
        of_vertices: compute the first one, else it is empty.
        of_texture: compute the second one, else it is empty.
    """
    count = len(vertices)
    groups, at_once = min(count, TEXTURE_GROUPS), bodies_at_once(count, setting.threads, setting.is_soft)
    gradient = np.empty_like(vertices) if of_vertices else np.empty((count, 0, 3), vertices.dtype)
    size = texels.shape if of_texture else (0, 0, 4)
    total = np.zeros((*size[:2], 3), texels.dtype)
    scale = vertices.dtype.type(1 / count if setting.mean else 1)
    grad_output = of_pictures.reshape(len(of_pictures), -1, of_pictures.shape[3])
    limits = [group * count // groups for group in range(groups + 1)]
    closes = np.zeros(count, np.bool_)

    def backward(first: int, last: int, sums: Array) -> Array:
        for at in range(first // at_once * at_once, last, at_once):
            some = slice(at, at + at_once)
            bodies = max(first - at, 0), min(last - at, at_once)
            grad_some = grad_output if setting.mean else grad_output[some]
            setting.backward(
                vertices[some],
                texels,
                blocks[at // at_once],
                bodies,
                grad_some,
                scale,
                gradient[some],
                sums,
                closes[some],
                total,
            )
        return sums

    if setting.threads > 1:
        tasks = run_tasks(
            lambda group: backward(limits[group], limits[group + 1], np.zeros(size, texels.dtype)),
            groups,
            setting.threads,
        )
        for sums in tasks:
            kernels.move_texels(sums, total)
    else:  # the same sums in the same order, in one place that stays in the CPU's cache
        closes[[limit - 1 for limit in limits[1:]]] = of_texture
        backward(0, count, np.zeros(size, texels.dtype))
    return gradient, total
