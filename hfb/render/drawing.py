"""All bodies of one exposure: every one drawn by compiled kernels, added up in a fixed order, and the way back.

The result has the same bits for any number of threads; nothing is shared between calls.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hfb.render import kernels, kernels_dibr
from hfb.render.threads import run_tasks
from hfb.shapes import Array, Tensor
from hfb.vector_code import LANES

TEXTURE_GROUPS = 4  # partial sums of the texture's gradient: fixed, so that the sum's order never depends on threads

Body = tuple[tuple[Array, ...], Array]
"""One body's trace (see `kernels`) and its pixels' codes, empty for a silhouette."""


@dataclass(frozen=True)
class Setting:
    """What is the same for all bodies; the fields are as in `hfb.render.operators.draw`."""

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
        """Index tables unsigned (-1, no face, becomes the largest number): numba tests every signed index for being
        negative."""
        faces, edge_vertices, edge_faces = (
            table.numpy().view(np.uint16 if table.dtype == torch.int16 else np.uint32) for table in topology
        )
        numbers = np.asarray(lens), np.asarray(soft)
        return Setting(uv.numpy(), faces, edge_vertices, edge_faces, *numbers, mean, threads)

    @property
    def is_soft(self) -> bool:
        """DIB-R's mask instead of exact coverage."""
        return bool(self.soft[0] > 0)

    def draw(self, vertices: Array, texels: Array) -> list[tuple[Array, ...]]:
        """Each of up to LANES bodies: the seven parts of its trace, and of a coloured one codes and colours."""
        coloured = len(texels) > 0
        if self.is_soft and coloured:
            given = self.lens, self.soft, self.faces, self.uv, texels
            return [kernels_dibr.draw_body_softly(one, *given) for one in vertices]
        if self.is_soft:
            return [kernels_dibr.cover_body_softly(one, self.lens, self.soft, self.faces) for one in vertices]
        projected, boxes, candidates, n_candidates, sides, n_sides = kernels.survey(
            vertices, self.lens, self.faces, self.edge_faces, coloured
        )
        edges, width, bodies = (self.edge_vertices, self.edge_faces), int(self.lens[5]), []
        for s in range(len(vertices)):
            there, outlined = (projected[s], boxes[s]), sides[s, : n_sides[s]]
            if coloured:
                shown = candidates[s, : n_candidates[s]]
                body = kernels.draw_body(*there, shown, outlined, self.faces, self.uv, *edges, width, texels)
            else:
                body = kernels.cover_body(*there, outlined, *edges, width)
            bodies.append((projected[s], *body))
        return bodies

    def pull(
        self,
        vertices: Array,
        texels: Array,
        body: Body,
        given: Array,
        scale: np.floating,
        gradient: Array,
        of_texels: Array,
    ) -> None:
        """The way back of one body: fills `gradient` (V, 3), adds to `of_texels`; empty ones are left out."""
        trace, codes = body
        if len(texels):
            way_back = kernels_dibr.draw_body_softly_gradient if self.is_soft else kernels.draw_body_gradient
            tables = self.faces, self.uv, texels
            way_back(vertices, self.lens, *tables, trace, codes, given, scale, gradient, of_texels)
        elif self.is_soft:
            kernels_dibr.cover_body_softly_gradient(vertices, self.lens, self.faces, trace, given, scale, gradient)
        else:
            kernels.cover_body_gradient(vertices, self.lens, trace, given, scale, gradient)


def draw_bodies(vertices: Array, texture: Array, setting: Setting) -> tuple[Array, Array, list[Body]]:
    """Pictures, the texture as the way back wants it, and the bodies' traces."""
    count, lens = len(vertices), setting.lens
    # Four channels suit the processor, and the fourth, ones drawn like the others, is the silhouette itself.
    texels = np.empty((*texture.shape[:2], 4), vertices.dtype)
    kernels.widen(texture, texels)
    # As many at once as kernels take, but something for every thread. A body does not depend on who is beside it.
    at_once = min(LANES, max(-(-count // setting.threads), 1))
    blocks = range(0, count, at_once)
    drawn = run_tasks(
        lambda block: setting.draw(vertices[blocks[block] : blocks[block] + at_once], texels),
        len(blocks), setting.threads,
    )  # fmt: skip
    found = [body for block in drawn for body in block]
    pictures = np.zeros(
        (1 if setting.mean else count, int(lens[6]), int(lens[5]), 4 if len(texels) else 1), vertices.dtype
    )
    scale = vertices.dtype.type(1 / count if setting.mean else 1)
    for s, body in enumerate(found):
        picture = pictures[0 if setting.mean else s].reshape(-1, pictures.shape[3])
        if len(texels):
            kernels.add_picture(body[2], body[8], scale, picture)
        else:
            kernels.add_silhouette(body[2], body[3], scale, picture)
    none = np.empty(0, np.int32)
    return pictures, texels, [(body[:7], body[7] if len(body) > 7 else none) for body in found]


def pull_bodies(
    of_pictures: Array,
    vertices: Array,
    texels: Array,
    bodies: Sequence[Body],
    setting: Setting,
    of_vertices: bool,
    of_texture: bool,
) -> tuple[Array, Array]:
    """Gradients of the vertices (S, V, 3) and of the texture (A, A, 3), empty where not asked for."""
    count = len(vertices)
    groups = min(count, TEXTURE_GROUPS)
    gradient = np.empty_like(vertices) if of_vertices else np.empty((count, 0, 3), vertices.dtype)
    size = texels.shape if of_texture else (0, 0, 4)
    total = np.zeros((*size[:2], 3), texels.dtype)
    scale = vertices.dtype.type(1 / count if setting.mean else 1)

    def pull_group(group: int, sums: Array) -> Array:
        for s in range(group * count // groups, (group + 1) * count // groups):
            given = of_pictures[0 if setting.mean else s].reshape(-1, of_pictures.shape[3])
            setting.pull(vertices[s], texels, bodies[s], given, scale, gradient[s], sums)
        return sums

    if setting.threads > 1:
        for sums in run_tasks(lambda group: pull_group(group, np.zeros(size, texels.dtype)), groups, setting.threads):
            kernels.move_texels(sums, total)
    else:  # the same sums in the same order, in one place that stays in the processor's cache
        sums = np.zeros(size, texels.dtype)
        for group in range(groups):
            kernels.move_texels(pull_group(group, sums), total)
    return gradient, total
