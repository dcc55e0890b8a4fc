"""Identity of the person in a clip, merged from a few windows that are spread over it."""

from collections.abc import Sequence

import torch

from hfb.body.model import Body
from hfb.fitting.clip.windows import WindowFit
from hfb.fitting.identity import Identity
from hfb.geometry.camera import PinholeCamera
from hfb.motion.clock import subframe_clock
from hfb.rendering.texels import fill_texture_gutter, texel_faces, visible_texels
from hfb.typing import Bool, Float, Tensor

_SEEN_FROM_PX = 256
_INSTANTS = 3


def merge_identities(fits: Sequence[WindowFit], body: Body) -> Identity:
    """Average the shape, and each texel over the windows in which it is visible.

    Texels that are visible in no window get the mean colour of the others. The order of the windows does not matter.

    Args:
        fits: windows of one clip.
        body: the body model.

    Raises:
        ValueError: a window was fitted with a known identity, or there is no window.
    """
    ordered = sorted(fits, key=lambda found: found.frames)
    textures = [found.texture for found in ordered if found.texture is not None]
    if not ordered or len(textures) < len(ordered):
        raise ValueError("an identity is merged from windows that were fitted without a known one")
    betas = torch.stack([found.betas for found in ordered]).double().mean(0).float()
    side = textures[0].shape[0]
    seen = torch.stack([_find_visible(found, body, side) for found in ordered]).float()[..., None]
    stacked = torch.stack(textures)
    count = seen.sum(0)
    total = (stacked * seen).sum((0, 1, 2)) / seen.sum().clamp_min(1)
    texture = torch.where(count > 0, (stacked * seen).sum(0) / count.clamp_min(1), total)
    return Identity(betas, fill_texture_gutter(texture, texel_faces(body.mesh, side)))


def _find_visible(found: WindowFit, body: Body, side: int) -> Bool[Tensor, "A A"]:
    """Return texels that are visible at some instant of the window."""
    with torch.no_grad():
        clock = subframe_clock(_INSTANTS, found.betas.dtype)
        rotations, translations = (one.flatten(0, 1) for one in found.trajectory.at(clock))
        vertices = body.shape(found.betas).pose(rotations, translations).vertices
        return visible_texels(vertices, _camera_for(vertices), body.mesh, side)


def _camera_for(vertices: Float[Tensor, "S V 3"]) -> PinholeCamera:
    """Return a camera at the real one's place that shows the whole person; occlusion depends on the place alone."""
    points = vertices.flatten(0, 1)
    screen = points[:, :2] / points[:, 2:].clamp_min(1e-3)
    low, high = screen.amin(0), screen.amax(0)
    focal = _SEEN_FROM_PX / float((high - low).max().clamp_min(1e-6))
    cx, cy = (-float(value) * focal for value in low)
    height, width = (max(8, int(float(value) * focal) + 1) for value in (high - low).flip(0))
    return PinholeCamera(focal, focal, cx, cy, height, width)
