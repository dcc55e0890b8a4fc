"""Initialisation of SfB and MfB: an ellipsoid as large as the matte, with several guesses of its motion."""

from dataclasses import dataclass

import torch

from hfb.motion.clock import subframe_times_s
from hfb.rendering.observation import Observation
from hfb.typing import Float, Tensor

# The image of an unknown object does not determine its distance: this one is assumed.
DEPTH_M = 3.5
_LEAST_SHARE = 0.25  # of the matte's variance along an axis that stays the object's own, however fast it moves


@dataclass(frozen=True)
class SphereStart:
    """One start guess.

    Attributes:
        axes_m: half the extent of the ellipsoid along x, y and z.
        path_m: coefficients of the centre's path over tau, the constants first.
    """

    axes_m: Float[Tensor, "3"]
    path_m: Float[Tensor, "D1 3"]


def shutter_tau(observation: Observation, subframes: int) -> Float[Tensor, "T S"]:
    """Return the sub-frames' times, from -0.5 to 0.5 over all frames: one polynomial runs through every exposure.

    Args:
        observation: the blurred frames with their mattes and clock.
        subframes: per frame.
    """
    frames = len(observation.mattes)
    times = subframe_times_s(frames, subframes, observation.exposure_s, observation.interval_s)[0]
    return torch.from_numpy(times / times[-1] - 0.5).float().unflatten(0, (frames, subframes))


def sphere_starts(observation: Observation, degree: int) -> list[SphereStart]:
    """Return start guesses from the mattes' moments; an empty matte has none and is left out.

    A single frame gives three: the object is as large as its matte and rests, or half of the matte's variance across
    (or down) the image is motion. The positions of several frames' mattes determine the motion.

    Args:
        observation: the blurred frames with their mattes and clock.
        degree: degree of the path's polynomial.
    """
    moments = [_moments(matte) for matte in observation.mattes if matte.sum() > 0]
    centres, variances = (torch.stack(list(part)) for part in zip(*moments, strict=True))
    camera = observation.camera
    m_per_px = DEPTH_M / ((camera.fx + camera.fy) / 2)
    variance, path_px = variances.mean(0), torch.zeros(degree + 1, 2)
    if len(moments) > 1:
        seen = torch.stack([matte.sum() > 0 for matte in observation.mattes])
        middle = shutter_tau(observation, 3)[:, 1][seen]
        powers = middle[:, None] ** torch.arange(2)
        path_px[:2] = torch.linalg.lstsq(powers, centres).solution
        span_s = observation.exposure_s + (len(observation.mattes) - 1) * observation.interval_s
        during = path_px[1] * (observation.exposure_s / span_s)
        guesses = [(variance - during**2 / 12, path_px)]
    else:
        path_px[0] = centres[0]
        guesses = [(variance, path_px)]
        for axis in range(2):
            still, moving = variance.clone(), path_px.clone()
            moving[1, axis] = (12 * variance[axis] / 2).sqrt()
            still[axis] = variance[axis] / 2
            guesses.append((still, moving))
    starts = []
    for own_variance, path in guesses:
        # A filled ellipse has a variance of a quarter of its half axis squared.
        half = 2 * own_variance.maximum(_LEAST_SHARE * variance).clamp_min(1).sqrt() * m_per_px
        path_m = torch.cat([path * m_per_px, torch.zeros(degree + 1, 1)], 1)
        path_m[0] = camera.unproject(path[0], torch.tensor(DEPTH_M))
        starts.append(SphereStart(torch.cat([half, half.min()[None]]), path_m))
    return starts


def _moments(matte: Float[Tensor, "H W"]) -> tuple[Float[Tensor, "2"], Float[Tensor, "2"]]:
    """Return centre (x, y) [px] and variance [px^2] of a matte."""
    height, width = matte.shape
    grid = torch.stack(torch.meshgrid(torch.arange(width) + 0.5, torch.arange(height) + 0.5, indexing="xy"), -1)
    share = matte[..., None] / matte.sum()
    centre = (share * grid).sum((0, 1))
    return centre, (share * (grid - centre) ** 2).sum((0, 1))
