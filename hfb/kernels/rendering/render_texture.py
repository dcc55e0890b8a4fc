"""Compiled entry points about texels: the face that covers each, and the visible ones."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np

from hfb.kernels.compile import entry
from hfb.kernels.rendering.render_screen import code_of, mask_for, see_body
from hfb.kernels.rendering.render_surface import first_texel, uv_of_face


@entry
def paint_charts(uv, owner):
    """Write the first face whose chart covers each texel's centre.

    Args:
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        owner: (A, A), filled.
    """
    size = owner.shape[0]
    for f in range(uv.shape[0]):
        x0, y0, x1, y1 = uv[f, 0, 0] * size, uv[f, 0, 1] * size, uv[f, 1, 0] * size, uv[f, 1, 1] * size
        x2, y2 = uv[f, 2, 0] * size, uv[f, 2, 1] * size
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        for r in range(max(int(np.ceil(min(y0, y1, y2) - 0.5)), 0), min(int(max(y0, y1, y2) + 0.5), size)):
            for c in range(max(int(np.ceil(min(x0, x1, x2) - 0.5)), 0), min(int(max(x0, x1, x2) + 0.5), size)):
                px, py = c + 0.5, r + 0.5
                b1 = ((px - x0) * (y2 - y0) - (x2 - x0) * (py - y0)) / area
                b2 = ((x1 - x0) * (py - y0) - (px - x0) * (y1 - y0)) / area
                if b1 >= 0.0 and b2 >= 0.0 and b1 + b2 <= 1.0 and owner[r, c] < 0:
                    owner[r, c] = f


@entry
def mark_seen(vertices, lens, faces, uv, seen):
    """Mark the texels from which the body's visible points are interpolated.

    Args:
        vertices: (V, 3) [m], camera coordinates.
        lens: fx, fy, cx, cy, nearest depth used, width, height.
        faces: (F, 3), vertex numbers.
        uv: (F, 3, 2), texture coordinates of the faces' corners.
        seen: (A, A), updated.
    """
    size = seen.shape[0]
    mask = mask_for(faces, faces)
    projected, box, nearest = see_body(vertices, lens, 0.0, faces, mask)
    for r in range(nearest.shape[0]):
        for c in range(nearest.shape[1]):
            if nearest[r, c] > 0:
                f = np.uint32(code_of(nearest[r, c], mask))
                u, v = uv_of_face(c + box[0] + 0.5, r + box[1] + 0.5, projected, faces, uv, f)
                column, row = first_texel(u, size), first_texel(v, size)
                after_column, after_row = min(column + 1, size - 1), min(row + 1, size - 1)
                seen[row, column] = seen[row, after_column] = True
                seen[after_row, column] = seen[after_row, after_column] = True
