"""Image formation, eq. (1) of the paper."""

import torch

from hfb.geometry.camera import PinholeCamera
from hfb.typing import Float, Tensor


def see_by_rows(vertices: Float[Tensor, "*t S V 3"], camera: PinholeCamera) -> Float[Tensor, "*t S V 3"]:
    """Return where a camera sees each vertex at each sub-frame: with a rolling shutter, at the time of its own row.

    Every row is exposed for the same time, later by its delay. So eq. (1) holds with x(u + delay) in place of x(u),
    which is x(u) + delay dx/du to first order: motion is nearly even while an image is read.

    Args:
        vertices: at the S sub-frames of each exposure, first and last instant included, camera coordinates [m].
        camera: with its `row_clock`; without one the vertices are returned as they are.
    """
    clock = camera.row_clock
    if clock is None:
        return vertices
    x, y, z = vertices.unbind(-1)
    late = (clock.across * x + clock.down * y) / z + clock.middle
    (speed,) = torch.gradient(vertices, spacing=1 / (vertices.shape[-3] - 1), dim=-3)
    return vertices + late[..., None] * speed


def compose(foreground: Float[Tensor, "*t H W 4"], plate_linear: Float[Tensor, "H W 3"]) -> Float[Tensor, "*t H W 3"]:
    """Return I^ = (1 - mean R_S) B + mean(R_S R_F), in the light in which the sensor averages.

    Args:
        foreground: mean over the sub-frames of premultiplied colour and silhouette, as a rasteriser returns it.
        plate_linear: the clean background B.
    """
    return (1 - foreground[..., 3:]) * plate_linear + foreground[..., :3]
