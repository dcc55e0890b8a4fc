"""Rendering of a motion's frames: many sub-frames, averaged in linear light over the plate, with sensor noise."""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.model import Body
from hfb.datasets.synthetic.sharp import SHARP_SUBFRAMES
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.sampled import SampledMotion
from hfb.photometry import linear_to_srgb
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.typing import Array, Bool, Float, Tensor

_AT_ONCE = 12
"""Sub-frames drawn together: more would only need more memory."""
_HALF_LIGHT_NOISE, _PLATE_NOISE = (0.004, 0.01), (0.2, 0.5)


@dataclass(frozen=True, eq=False)
class Shot:
    """One exposure before it is composed over the plate.

    Attributes:
        mean: mean of all sub-frames, premultiplied linear colour and silhouette.
        silhouettes: per instant, at half coverage.
        sharp: the eight sub-frames at u = i / 7.
    """

    mean: Float[Tensor, "H W 4"]
    silhouettes: Bool[Array, "S H W"]
    sharp: Float[Array, "8 H W 4"]


@dataclass(frozen=True)
class Sensor:
    """Noise of a linear sensor: variance = read^2 + shot * light; of the plate, as if averaged, only a part."""

    read: float
    shot: float
    plate_share: float

    def expose(
        self, linear: Float[Tensor, "H W 3"], rng: np.random.Generator, share: float = 1.0
    ) -> Float[Array, "H W 3"]:
        """Return the image with `share` of the noise, clipped and encoded as sRGB.

        Args:
            linear: linear light.
            rng: draws the noise.
            share: share of the standard deviation.
        """
        light = linear.double().numpy()
        sigma = share * np.sqrt(self.read**2 + self.shot * np.clip(light, 0, None))
        return linear_to_srgb(np.clip(light + sigma * rng.standard_normal(light.shape), 0, 1)).astype(np.float32)


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """Draw a noise of .004 to .01 at half of full light, one part of it read noise.

    Args:
        rng: draws the sensor.
    """
    total, read, plate = rng.uniform(*_HALF_LIGHT_NOISE), rng.uniform(0.2, 0.6), rng.uniform(*_PLATE_NOISE)
    return Sensor(float(total * read), float(2 * total**2 * (1 - read**2)), float(plate))


NO_NOISE = Sensor(0.0, 0.0, 0.0)


def shoot(
    motion: SampledMotion, frame: int, body: Body, texture: Float[Tensor, "A A 3"], camera: PinholeCamera
) -> Shot:
    """Render every instant of one frame of a motion.

    Args:
        motion: camera coordinates.
        frame: its number.
        body: model of the motion.
        texture: linear light.
        camera: camera of the frame.
    """
    rows = motion.rows_of(frame)
    rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses[rows]).float().unflatten(1, (24, 3)))
    translations = torch.from_numpy(motion.trans[rows]).float()
    shaped = body.shape(torch.from_numpy(motion.betas).float())
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    every = (len(rows) - 1) // (SHARP_SUBFRAMES - 1)
    total = torch.zeros(camera.height, camera.width, 4)
    silhouettes, sharp = [], []
    for first in range(0, len(rows), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        pictures = rasterizer.render(
            shaped.pose(rotations[part], translations[part]).vertices, texture, camera, body.mesh
        )
        total += pictures.sum(0)
        silhouettes.append((pictures[..., 3] >= 0.5).numpy())
        sharp += [picture.numpy() for row, picture in enumerate(pictures, first) if row % every == 0]
    return Shot(total / len(rows), np.concatenate(silhouettes), np.stack(sharp))


def develop(
    shot: Shot, plate_linear: Float[Tensor, "H W 3"], sensor: Sensor, rng: np.random.Generator
) -> Float[Array, "H W 3"]:
    """Return the blurred frame as the camera stores it, sRGB.

    Args:
        shot: sub-frames of one frame.
        plate_linear: background, linear light.
        sensor: its noise.
        rng: draws the noise.
    """
    return sensor.expose(compose(shot.mean, plate_linear), rng)


def touches_border(shot: Shot, margin_px: int) -> bool:
    """Return whether the person comes nearer than this to the image's border.

    Args:
        shot: sub-frames of one frame.
        margin_px: least distance.
    """
    seen = shot.mean[..., 3] > 0
    inner = seen[margin_px:-margin_px, margin_px:-margin_px]
    return bool(seen.sum() != inner.sum())
