"""Registration of the body to 2D keypoints, with a prior of plausible poses.

Reprojection and priors, as in SMPLify (Bogo et al., ECCV 2016). Pixels alone leave the depth open, so the search starts
from the nearest of about fifty poses, seen from all sides, and keeps the most likely result.
"""

import math
from dataclasses import dataclass

import torch

from hfb.body.model import Body, ShapedBody
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.point_registration import Registered, Start, fit_points
from hfb.initialization.pose_bank import bank_rotations
from hfb.priors.anatomy import AnatomicalPrior
from hfb.typing import Array, Bool, Float, Tensor

LEAST_KEYPOINTS = 6
_SPREAD = 0.01
"""Standard deviation of keypoints, relative to the person's size in the image."""
_ROBUST = 5.0  # spreads above which a keypoint counts as wrong
_WIDE = 8.0  # factor of the spread at the start, so that distant joints are attracted to their keypoints, too
_YAWS, _PITCHES = 16, (-0.35, 0.0, 0.35)
_STARTS, _LEAST_APART = 4, 3
_ROUNDS = ((_WIDE, 80, 0.04), (1.0, 80, 0.02))  # spread, iterations, rate
_LIKELY = 0.3
_NEAREST_M = 0.3


def register_keypoints(
    pixels: Float[Array, "S 24 2"], camera: PinholeCamera, body: Body, betas: Float[Tensor, "K"] | None = None
) -> Registered:
    """Lay the body onto where an image shows its joints.

    Args:
        pixels: SMPL's joints [px], NaN where not seen.
        camera: camera of the image.
        body: the body model.
        betas: shape of the person, the mean one's where not given.

    Returns:
        poses before the camera; `residual_m` is what the image shows, at the body's depth [m].

    Raises:
        InputError: fewer than six joints are seen at some instant.
    """
    dtype = body.template.dtype
    seen = _Seen.of(torch.as_tensor(pixels).to(dtype), camera)
    if not len(pixels) or int(seen.known.sum(1).min()) < LEAST_KEYPOINTS:
        raise InputError(f"fewer than {LEAST_KEYPOINTS} keypoints are seen; a body needs more to be laid onto them")
    shape = torch.zeros(body.shape_count, dtype=dtype) if betas is None else betas.to(dtype)
    rotations, places = _nearest(seen, body.shape(shape))
    several = seen.repeated(_STARTS)
    for spread, iterations, rate in _ROUNDS:

        def misfit(shaped: ShapedBody, turns: Tensor, at: Tensor, spread: float = spread) -> tuple[Tensor, Tensor]:
            return several.misfit(shaped.joints_of(turns, at), spread)

        found = fit_points(Start(rotations, places, shape, shape_is_free=False), body, misfit, iterations, rate)
        rotations, places = axis_angle_to_matrix(found.poses), found.translations
    cost = misfit(body.shape(shape), rotations, places)[0] + _LIKELY * AnatomicalPrior()(found.poses[:, 1:])
    best = cost.reshape(-1, _STARTS).argmin(1) + _STARTS * torch.arange(len(pixels))
    return Registered(found.poses[best], found.translations[best], shape, found.residual_m[best])


@dataclass(frozen=True)
class _Seen:
    """Joints in the image."""

    pixels: Float[Tensor, "S 24 2"]
    known: Bool[Tensor, "S 24"]
    size_px: Float[Tensor, "S"]
    camera: PinholeCamera

    @staticmethod
    def of(pixels: Float[Tensor, "S 24 2"], camera: PinholeCamera) -> "_Seen":
        known = torch.isfinite(pixels).all(-1)
        low, high = (
            torch.where(known[..., None], pixels, torch.full_like(pixels, end)) for end in (math.inf, -math.inf)
        )
        size = (high.amax(1) - low.amin(1)).amax(1).clamp(1, 1e5)
        return _Seen(torch.where(known[..., None], pixels, torch.zeros_like(pixels)), known, size, camera)

    def repeated(self, times: int) -> "_Seen":
        """Return every instant so many times, one after another."""
        pixels, known, size = (one.repeat_interleave(times, 0) for one in (self.pixels, self.known, self.size_px))
        return _Seen(pixels, known, size, self.camera)

    def misfit(self, joints: Float[Tensor, "S 24 3"], spread: float) -> tuple[Float[Tensor, "S"], Float[Tensor, "S"]]:
        """Return the Geman-McClure loss, which is robust to single wrong keypoints, and the mean distance [m]."""
        in_front = torch.cat([joints[..., :2], joints[..., 2:].clamp_min(_NEAREST_M)], -1)
        apart_px = (self.camera.project(in_front) - self.pixels).norm(dim=-1)
        square = (apart_px / (spread * _SPREAD * self.size_px[:, None])) ** 2 * self.known
        apart_m = (apart_px * in_front[..., 2] / self.camera.fx * self.known).sum(1) / self.known.sum(1)
        return (_ROBUST**2 * square / (square + _ROBUST**2)).sum(1) / 2, apart_m.detach()


def _nearest(seen: _Seen, shaped: ShapedBody) -> tuple[Float[Tensor, "n 24 3 3"], Float[Tensor, "n 3"]]:
    """Return _STARTS poses of the bank per instant, at the view and position that match best."""
    dtype = seen.pixels.dtype
    poses, sides = axis_angle_to_matrix(bank_rotations(dtype)[1]), _sides(dtype)
    pairs = torch.cartesian_prod(torch.arange(len(poses)), torch.arange(len(sides)))
    turns = torch.cat([sides[pairs[:, 1]], poses[pairs[:, 0]]], 1)
    joints = shaped.joints_of(turns, turns.new_zeros(len(turns), 3))
    rows = []
    for pixels, known in zip(seen.pixels, seen.known, strict=True):
        there, here = pixels[known], joints[:, known, :2]
        there, here = there - there.mean(0), here - here.mean(1, keepdim=True)
        scale = ((here * there).sum((1, 2)) / (here * here).sum((1, 2)).clamp_min(1e-9)).clamp_min(1e-6)
        apart = ((scale[:, None, None] * here - there) ** 2).sum((1, 2))
        chosen = _apart_from_each_other(torch.argsort(apart, stable=True), len(sides))
        depth = (seen.camera.fx + seen.camera.fy) / 2 / scale[chosen]
        middle = seen.camera.unproject(pixels[known].mean(0).expand(len(chosen), 2), depth)
        offset = joints[chosen][:, known].mean(1)
        rows.append((turns[chosen], middle - offset))
    rotations, places = (torch.cat(parts) for parts in zip(*rows, strict=True))
    return rotations, places


def _apart_from_each_other(ranked: Tensor, sides: int) -> Tensor:
    """Return the best candidate and the next ones from another side: number of the pose times sides plus side."""
    chosen: list[int] = []
    for one in ranked.tolist():
        yaw = one % sides // len(_PITCHES)
        others = [other % sides // len(_PITCHES) for other in chosen]
        if all(min((yaw - other) % _YAWS, (other - yaw) % _YAWS) >= _LEAST_APART for other in others):
            chosen.append(one)
        if len(chosen) == _STARTS:
            break
    return torch.tensor(chosen)


def _sides(dtype: torch.dtype) -> Float[Tensor, "n 1 3 3"]:
    """Return roots: upright before a camera whose y points down, turned about the vertical and nodding a little."""

    def turn(x: float, y: float) -> Tensor:
        return axis_angle_to_matrix(torch.tensor([x, y, 0.0], dtype=dtype))

    upright = turn(math.pi, 0)
    yaws = [2 * math.pi * number / _YAWS for number in range(_YAWS)]
    return torch.stack([turn(pitch, 0) @ upright @ turn(0, yaw) for yaw in yaws for pitch in _PITCHES])[:, None]
