"""Who is seen in a clip: shape and texture agreed on by a few windows that are spread over it."""

from collections.abc import Sequence

import torch

from hfb.body.model import Body
from hfb.fitting.clip.windows import WindowFit
from hfb.fitting.clip_person import ClipPerson
from hfb.geometry.camera import PinholeCamera
from hfb.motion.clock import subframe_clock
from hfb.rendering.texels import fill_texture_gutter, texel_faces, visible_texels
from hfb.typing import Bool, Float, Tensor

_SEEN_FROM_PX = 256
_INSTANTS = 3


def agree_on_person(fits: Sequence[WindowFit], body: Body) -> ClipPerson:
    """The mean shape, and per texel the mean colour over the windows that saw it.

    A texel that no window saw has the mean colour of those that were seen. The order of the windows does not matter.

    Raises:
        ValueError: a window has no texture of its own, or none is given.
    """
    ordered = sorted(fits, key=lambda found: found.frames)
    textures = [found.texture for found in ordered if found.texture is not None]
    if not ordered or len(textures) < len(ordered):
        raise ValueError("the person needs windows that were fitted without a known one")
    betas = torch.stack([found.betas for found in ordered]).double().mean(0).float()
    side = textures[0].shape[0]
    seen = torch.stack([_seen(found, body, side) for found in ordered]).float()[..., None]
    stacked = torch.stack(textures)
    count = seen.sum(0)
    total = (stacked * seen).sum((0, 1, 2)) / seen.sum().clamp_min(1)
    texture = torch.where(count > 0, (stacked * seen).sum(0) / count.clamp_min(1), total)
    return ClipPerson(betas, fill_texture_gutter(texture, texel_faces(body.mesh, side)))


def _seen(found: WindowFit, body: Body, side: int) -> Bool[Tensor, "A A"]:
    """Texels that face the camera and are not hidden at some instant of the window."""
    with torch.no_grad():
        clock = subframe_clock(_INSTANTS, found.betas.dtype)
        rotations, translations = (one.flatten(0, 1) for one in found.trajectory.at(clock))
        vertices = body.shape(found.betas).pose(rotations, translations).vertices
        return visible_texels(vertices, _camera_for(vertices), body.mesh, side)


def _camera_for(vertices: Float[Tensor, "S V 3"]) -> PinholeCamera:
    """A camera in the real one's place that shows the whole person: what hides what depends on the place alone."""
    points = vertices.flatten(0, 1)
    screen = points[:, :2] / points[:, 2:].clamp_min(1e-3)
    low, high = screen.amin(0), screen.amax(0)
    focal = _SEEN_FROM_PX / float((high - low).max().clamp_min(1e-6))
    cx, cy = (-float(value) * focal for value in low)
    height, width = (max(8, int(float(value) * focal) + 1) for value in (high - low).flip(0))
    return PinholeCamera(focal, focal, cx, cy, height, width)
