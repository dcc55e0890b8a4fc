"""Simulated static estimates with the errors of METRO on the paper's BT-AMASS, by blur rate.

The paper starts every fit from METRO (Lin et al. 2021), whose weights are not free. Its tables 1 and 2 give METRO's
errors; with estimates of equal errors, ratios are comparable to the paper's.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import erf, exp, log, pi, sqrt
from typing import NamedTuple

import numpy as np
import torch

from hfb.body.model import Body, ShapedBody
from hfb.datasets.blur_bins import BLUR_BINS
from hfb.datasets.network_errors import draw_pose_errors
from hfb.datasets.truth import Truth
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.procrustes import nearest_rotation
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.typing import Array, Float, Int, Tensor

# METRO's rows of the paper's tables 1 (one image) and 2 (two frames), per interval of `BLUR_BINS`.
_SINGLE_MPJPE_MM = (70.0, 71.9, 84.1, 101.2, 121.3, 121.4, 132.8, 143.4, 147.1, 146.4)
_SINGLE_IOU = (0.632, 0.637, 0.615, 0.590, 0.540, 0.500, 0.489, 0.428, 0.421, 0.423)
_PAIR_MPJPE_MM = (68.9, 69.6, 71.6, 67.0, 98.6, 99.6, 108.5, 111.3, 116.8, 121.1)
_PAIR_IOU = (0.645, 0.689, 0.653, 0.601, 0.598, 0.508, 0.477, 0.399, 0.408, 0.388)

_CENTRES = tuple((low + high) / 2 for low, high in BLUR_BINS)

_MPJPE_LOG_SPREAD, _IOU_SPREAD = 0.25, 0.06
_INSTANT_MEAN, _INSTANT_SPREAD = 0.5, 0.15
_AMPLITUDES = torch.linspace(0.06, 1.5, 25)
"""Amplitudes of the shoulder's turn [rad]; the first is the best that a network reaches."""
_TRIES = 6
_SHIFT_M, _LOG_DEPTH = 0.08, 0.035
"""Across the view, and along it as a share of the distance, where the misplacement is 1."""
_LARGEST_MISPLACEMENT, _HALVINGS = 6.0, 7
_PICTURE_PX, _MARGIN = 96, 0.35
_INSTANTS = 8


def simulated_starts(
    truth: Truth, frames: int, blur_rate: float, body: Body, camera: PinholeCamera, rng: np.random.Generator
) -> list[FirstBody]:
    """Draw one static body per frame with METRO's error: MPJPE over all instants of the case, and silhouette IoU.

    The body is the mean one (a network does not know the shape) in the pose of some instant around the middle of the
    exposure. Errors of `hfb.datasets.network_errors` grow until the case has its drawn MPJPE, and it is misplaced until
    it has its IoU. Where motion and shape alone exceed these, the error is larger.

    Args:
        truth: its betas count in the body's own space.
        frames: rows of the truth belong to frames 0 .. frames - 1.
        blur_rate: blur rate of the case.
        body: the model that the fit will use.
        camera: camera of the truth's silhouettes.
        rng: the only source of chance; the same state gives the same bodies.
    """
    wanted = _draw_wanted(blur_rate, frames, rng)
    instants = np.clip(rng.normal(_INSTANT_MEAN, _INSTANT_SPREAD, frames), 0, 1)
    misplaced = _draw_misplacement(frames, rng)
    rows = np.array([_row_at(truth, frame, u) for frame, u in enumerate(instants)])
    mean_person = body.shape(torch.zeros(body.shape_count, dtype=body.template.dtype))
    poses = _poses_with_error(truth, rows, mean_person, wanted, rng)
    placed = _place(poses, truth.motion.joints[rows], mean_person)
    translations = _translations_with_iou(truth, poses, placed, misplaced, mean_person, camera, wanted)
    betas = torch.zeros(len(truth.motion.betas))
    return [FirstBody(pose, where, betas, "simulated") for pose, where in zip(poses, translations, strict=True)]


class _Wanted(NamedTuple):
    """Means of METRO's errors at a blur rate, and standard normal draws of this case's place around them."""

    mpjpe_mm: float
    iou: float
    mpjpe_draw: float
    iou_draw: float


def _draw_wanted(blur_rate: float, frames: int, rng: np.random.Generator) -> _Wanted:
    mpjpe_mm, iou = (_SINGLE_MPJPE_MM, _SINGLE_IOU) if frames == 1 else (_PAIR_MPJPE_MM, _PAIR_IOU)
    draws = rng.standard_normal(2)
    return _Wanted(_between_bins(blur_rate, mpjpe_mm), _between_bins(blur_rate, iou), float(draws[0]), float(draws[1]))


@lru_cache
def _knots(means: tuple[float, ...]) -> tuple[float, ...]:
    """Return values at the intervals' centres whose linear interpolation has the given mean over each interval.

    The table's own values at the centres would smooth away its peaks and dips.
    """
    shares = np.stack(
        [
            [np.interp(np.linspace(low, high, 101), _CENTRES, row).mean() for row in np.eye(len(means))]
            for low, high in BLUR_BINS
        ]
    )
    return tuple(np.linalg.solve(shares, means).tolist())


def _between_bins(blur_rate: float, means: tuple[float, ...]) -> float:
    """Interpolate linearly over the blur rate with the given means per interval; constant beyond the outer centres."""
    return float(np.interp(blur_rate, _CENTRES, _knots(means)))


def _row_at(truth: Truth, frame: int, u: float) -> int:
    """Return the true instant nearest to u of a frame's exposure."""
    rows = truth.motion.rows_of(frame)
    return int(rows[round(u * (len(rows) - 1))])


def _poses_with_error(
    truth: Truth, rows: Int[Array, "T"], person: ShapedBody, wanted: _Wanted, rng: np.random.Generator
) -> Float[Tensor, "T 24 3"]:
    """Return the true poses of some rows with errors, at the amplitude whose MPJPE is the drawn one.

    Another error is drawn where the joints' limits keep this one too small at any amplitude.
    """
    true_poses = torch.from_numpy(truth.motion.poses[rows]).float().unflatten(1, (24, 3))
    for _ in range(_TRIES):
        errors = draw_pose_errors(true_poses, rng)
        poses = errors.poses_at(_AMPLITUDES)
        reached_mm = np.maximum.accumulate(_mpjpe_mm(_joints(poses, person), truth))
        target_mm = _lognormal_above(wanted.mpjpe_mm, _MPJPE_LOG_SPREAD, reached_mm[0], wanted.mpjpe_draw)
        above = int(np.searchsorted(reached_mm, target_mm))
        if above < len(reached_mm):
            break
    if above in (0, len(reached_mm)):
        return poses[min(above, len(reached_mm) - 1)]
    finer = torch.linspace(float(_AMPLITUDES[above - 1]), float(_AMPLITUDES[above]), 8)
    poses = errors.poses_at(torch.cat([_AMPLITUDES[: above - 1], finer]))[above - 1 :]
    return poses[int(np.abs(_mpjpe_mm(_joints(poses, person), truth) - target_mm).argmin())]


def _joints(poses: Float[Tensor, "A T 24 3"], person: ShapedBody) -> Float[Array, "A T 24 3"]:
    rotations = axis_angle_to_matrix(poses.flatten(0, 1).to(person.joints))
    return person.joints_of(rotations, rotations.new_zeros(len(rotations), 3)).unflatten(0, poses.shape[:2]).numpy()


def _mpjpe_mm(still: Float[Array, "A T 24 3"], truth: Truth) -> Float[Array, "A"]:
    """Return `hfb.evaluation.metrics.mpjpe_mm` of several static estimates at once."""
    frame_index = truth.motion.frame_index
    source = (still - still[:, :, :1]).astype(np.float64)[:, frame_index]
    target = truth.motion.joints - truth.motion.joints[:, :1]
    rotations = nearest_rotation(np.einsum("rjx,arjy->axy", target, source))
    turned = np.einsum("axy,arjy->arjx", rotations, source)
    return 1000 * np.linalg.norm(turned - target, axis=-1).mean((1, 2))


def _place(
    poses: Float[Tensor, "T 24 3"], true_joints: Float[Array, "T 24 3"], person: ShapedBody
) -> Float[Tensor, "T 3"]:
    """Return SMPL translations that give the estimate's joints the person's size and place in the image.

    The depth compensates the difference in size of the mean body and the person.
    """
    joints = torch.from_numpy(_joints(poses[None], person))[0].double()
    target = torch.from_numpy(true_joints)
    seen = target[..., :2] / target[..., 2:]
    translations = target[:, 0] - joints[:, 0]
    for _ in range(3):
        moved = joints + translations[:, None]
        shown = moved[..., :2] / moved[..., 2:]
        nearer = _spread(shown) / _spread(seen)
        pelvis = moved[:, 0] * nearer[:, None]
        pelvis[:, :2] += (seen - shown).mean(1) * pelvis[:, 2:]
        translations = pelvis - joints[:, 0]
    return translations.float()


def _spread(points: Float[Tensor, "T 24 2"]) -> Float[Tensor, "T"]:
    """Return root mean square distance from their centre."""
    return (points - points.mean(1, keepdim=True)).square().sum(-1).mean(1).sqrt()


def _draw_misplacement(frames: int, rng: np.random.Generator) -> Float[Tensor, "T 3"]:
    """Draw directions of misplacement: across the view, more sideways than up and down, and standard normal in depth.

    Most of it is common to all frames. Upright people stay upright, since networks seldom miss feet and heads.
    """
    angle = rng.uniform(0, 2 * pi) + 0.5 * rng.standard_normal(frames)
    depth = np.clip(sqrt(0.6) * rng.standard_normal() + sqrt(0.4) * rng.standard_normal(frames), -2, 2)
    return torch.from_numpy(np.stack([np.cos(angle), 0.5 * np.sin(angle), depth], 1)).float()


@dataclass(frozen=True, eq=False)
class _Views:
    """The truth's silhouettes at a few instants of each frame in a small window around the person, and its camera."""

    silhouettes: Float[Array, "T N H W"]
    camera: PinholeCamera


def _translations_with_iou(
    truth: Truth,
    poses: Float[Tensor, "T 24 3"],
    placed: Float[Tensor, "T 3"],
    misplaced: Float[Tensor, "T 3"],
    person: ShapedBody,
    camera: PinholeCamera,
    wanted: _Wanted,
) -> Float[Tensor, "T 3"]:
    """Misplace the bodies until the silhouettes have the drawn IoU."""
    views = _small_views(truth, camera, len(poses))
    rotations = axis_angle_to_matrix(poses.to(person.joints))
    at_origin = person.pose(rotations, placed.new_zeros(placed.shape).to(person.joints))
    rasterizer, mesh = make_rasterizer("coverage", "cpu", 1), person.body.mesh
    pelvis = at_origin.joints[:, 0].float()

    def moved(amount: float) -> Float[Tensor, "T 3"]:
        root = placed + pelvis
        root = root * torch.exp(_LOG_DEPTH * amount * misplaced[:, 2:])
        across = torch.cat([_SHIFT_M * amount * misplaced[:, :2], torch.zeros(len(root), 1)], 1)
        return root + across - pelvis

    def iou(amount: float) -> float:
        scores = []
        for vertices, where, seen in zip(at_origin.vertices, moved(amount), views.silhouettes, strict=True):
            shown = rasterizer.silhouette_mean((vertices + where)[None], views.camera, mesh).numpy()
            either = np.maximum(shown, seen).sum((1, 2))
            scores.append((np.minimum(shown, seen).sum((1, 2)) / np.maximum(either, 1e-9)).mean())
        return float(np.mean(scores))

    target = _normal_below(wanted.iou, _IOU_SPREAD, iou(0.0), wanted.iou_draw)
    low, high = 0.0, _LARGEST_MISPLACEMENT
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if iou(middle) > target else (low, middle)
    return moved(low)


def _small_views(truth: Truth, camera: PinholeCamera, frames: int) -> _Views:
    """Cut a square around everything the person covers and shrink it."""
    rows = [truth.motion.rows_of(frame) for frame in range(frames)]
    count = min(_INSTANTS, min(len(row) for row in rows))
    chosen = np.stack([row[np.linspace(0, len(row) - 1, count).round().astype(int)] for row in rows])
    ys, xs = np.nonzero(truth.silhouettes.any(0))
    if len(ys) == 0:
        ys, xs = np.array([0, camera.height - 1]), np.array([0, camera.width - 1])
    side = int((1 + 2 * _MARGIN) * (max(np.ptp(ys), np.ptp(xs)) + 1))
    top, left = int(ys.min() + ys.max() + 1 - side) // 2, int(xs.min() + xs.max() + 1 - side) // 2
    pixels = torch.from_numpy(truth.silhouettes[chosen.ravel()]).float()
    padding = (-left, left + side - camera.width, -top, top + side - camera.height)
    window = torch.nn.functional.pad(pixels, padding)
    small = torch.nn.functional.interpolate(window[:, None], (_PICTURE_PX, _PICTURE_PX), mode="area")[:, 0]
    return _Views(
        small.numpy().reshape(frames, count, _PICTURE_PX, _PICTURE_PX),
        camera.crop(left, top, side, side).resize(_PICTURE_PX, _PICTURE_PX),
    )


def _lognormal_above(mean: float, spread: float, floor: float, draw: float) -> float:
    """Return exp(mu + spread * draw) or the floor if that is higher, mu such that the mean over draws is the given one.

    E max(floor, X) = floor Phi((ln floor - mu) / s) + exp(mu + s^2 / 2) Phi((mu + s^2 - ln floor) / s).
    """
    low, high = log(mean) - 8 * spread, log(mean)
    for _ in range(40):
        mu = (low + high) / 2
        expected = floor * _phi((log(floor) - mu) / spread) + exp(mu + spread**2 / 2) * _phi(
            (mu + spread**2 - log(floor)) / spread
        )
        low, high = (mu, high) if expected < mean else (low, mu)
    return max(floor, exp(low + spread * draw))


def _normal_below(mean: float, spread: float, ceiling: float, draw: float) -> float:
    """Return mu + spread * draw or the ceiling if that is lower, mu such that the mean over all draws is the given one.

    E min(c, X) = mu - s (d Phi(d) + phi(d)) with d = (mu - c) / s.
    """
    low, high = mean - 0.1 * spread, mean + 8 * spread
    for _ in range(40):
        mu = (low + high) / 2
        d = (mu - ceiling) / spread
        expected = mu - spread * (d * _phi(d) + exp(-d * d / 2) / sqrt(2 * pi))
        low, high = (mu, high) if expected < mean else (low, mu)
    return min(ceiling, low + spread * draw)


def _phi(x: float) -> float:
    return (1 + erf(x / sqrt(2))) / 2
