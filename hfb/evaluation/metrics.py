"""Metrics of motions against the truth, and of images.

Joints are SMPL's 24 in metres, camera coordinates; R counts sub-frames, frame after frame. Everything is computed
in float64, errors are in millimetres. A real video's truth knows only some joints, and those not always:
`subset_errors` leaves out what is NaN there; nothing else does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from hfb.body.skeleton import H36M_14
from hfb.geometry.procrustes import align_known, align_similarity, rotate_sequence
from hfb.typing import Array, Bool, Float

_PELVIS = 0
_SSIM_SIGMA_PX, _SSIM_RIM_PX = 1.5, 5
_K1, _K2 = 0.01, 0.03

Metric = Callable[[Array, Array], float]


def mpjpe_mm(
    predicted: Float[Array, "R J 3"], truth: Float[Array, "R J 3"], joints: Sequence[int] | None = None
) -> float:
    """Return the mean joint position error [mm], pelvis (joint 0) centred, after one rotation of the whole sequence.

    The one rotation (Kabsch, no scale, over all joints of all sub-frames) aligns the predicted sequence's axes with
    the truth's, as the paper does; it is no rotation per sub-frame, so a wrong turn within the sequence counts.

    Args:
        predicted: joints [m].
        truth: joints [m], at the same instants.
        joints: joints over which the mean is taken (the alignment uses all); every joint when not given.
    """
    return _mean_mm(_aligned_residual(predicted, truth), joints)


def pa_mpjpe_mm(
    predicted: Float[Array, "R J 3"], truth: Float[Array, "R J 3"], joints: Sequence[int] | None = None
) -> float:
    """Return MPJPE [mm] after a similarity (rotation, translation, scale) per sub-frame, of the chosen joints.

    Args:
        predicted: joints [m].
        truth: joints [m], at the same instants.
        joints: joints over which is aligned and averaged; every joint when not given.
    """
    chosen = slice(None) if joints is None else list(joints)
    source, target = _float64(predicted)[:, chosen], _float64(truth)[:, chosen]
    return _mean_mm(align_similarity(source, target) - target, None)


def in_plane_depth_mm(predicted: Float[Array, "R J 3"], truth: Float[Array, "R J 3"]) -> tuple[float, float]:
    """Split MPJPE's residuals along the camera's axes: mean length across the view (x, y), mean |z| along it [mm].

    Args:
        predicted: joints [m].
        truth: joints [m], at the same instants.
    """
    residual = _aligned_residual(predicted, truth)
    return 1000 * float(np.linalg.norm(residual[..., :2], axis=-1).mean()), 1000 * float(abs(residual[..., 2]).mean())


def joint_errors_mm(predicted: Float[Array, "R J 3"], truth: Float[Array, "R J 3"]) -> Float[Array, "J"]:
    """Return `mpjpe_mm` per joint: each one's mean over the sub-frames [mm], after the same alignment of all of them.

    Args:
        predicted: joints [m].
        truth: joints [m], at the same instants.
    """
    return errors_mm(predicted, truth).mean(0)


def errors_mm(predicted: Float[Array, "R J 3"], truth: Float[Array, "R J 3"]) -> Float[Array, "R J"]:
    """Return the distances whose mean is `mpjpe_mm`, per joint and sub-frame [mm].

    Args:
        predicted: joints [m].
        truth: joints [m], at the same instants.
    """
    return 1000 * np.linalg.norm(_aligned_residual(predicted, truth), axis=-1)


@dataclass(frozen=True)
class SubsetErrors:
    """Errors over the joints that the truth knows [mm]; NaN where it knows too few of them.

    Attributes:
        mpjpe_mm: after one rotation of the sequence, over the sub-frames in which the centre is known.
        in_plane_mm: the part of these errors across the view.
        depth_mm: the part along it.
        pa_mpjpe_mm: after a similarity per sub-frame, over those with three known joints or more.
        distances_mm: the errors whose mean is ``mpjpe_mm``; NaN where a joint does not count.
    """

    mpjpe_mm: float
    pa_mpjpe_mm: float
    in_plane_mm: float
    depth_mm: float
    distances_mm: Float[Array, "R P"]

    @property
    def joints_mm(self) -> Float[Array, "P"]:
        """MPJPE joint by joint."""
        return np.array([_mean_of_known(column) for column in self.distances_mm.T])


def subset_errors(
    predicted: Float[Array, "R P 3"], truth: Float[Array, "R P 3"], centre: Sequence[int]
) -> SubsetErrors:
    """Return errors where only some joints are known, at some instants.

    Args:
        predicted: the same joints as in the truth.
        truth: NaN where a joint is unknown at an instant; such a joint counts nowhere, neither in an alignment nor in a
            mean.
        centre: positions within P whose mean stands in for the pelvis, such as the two hips; a sub-frame in which one
            of them is unknown is left out of MPJPE.

    Raises:
        ValueError: the prediction is not finite where the truth is known.
    """
    source, target = _float64(predicted), _float64(truth)
    known = np.isfinite(target).all(-1)
    if not np.isfinite(source[known]).all():
        raise ValueError("the prediction is not finite")
    source, target = np.where(known[..., None], source, 0), np.where(known[..., None], target, 0)
    counted = known & known[:, list(centre)].all(1)[:, None]
    residual = _aligned_residual(source, target, list(centre), counted)
    errors = 1000 * np.where(counted, np.linalg.norm(residual, axis=-1), np.nan)
    similar = known & (known.sum(1) >= 3)[:, None]
    pa_residual = align_known(source, target, similar) - target
    return SubsetErrors(
        mpjpe_mm=_mean_of_known(errors),
        pa_mpjpe_mm=1000 * _mean_of_known(np.where(similar, np.linalg.norm(pa_residual, axis=-1), np.nan)),
        in_plane_mm=1000 * _mean_of_known(np.where(counted, np.linalg.norm(residual[..., :2], axis=-1), np.nan)),
        depth_mm=1000 * _mean_of_known(np.where(counted, abs(residual[..., 2]), np.nan)),
        distances_mm=errors,
    )


def reverse_time(joints: Float[Array, "R *s"], frames: int = 1) -> Float[Array, "R *s"]:
    """Reverse the order of the sub-frames within every frame.

    A uniform exposure looks the same either way: one frame cannot tell the direction of time.

    Args:
        joints: or silhouettes, or anything else with a row per sub-frame.
        frames: number of frames that the rows divide into.
    """
    return joints.reshape(frames, -1, *joints.shape[1:])[:, ::-1].reshape(joints.shape)


def wrong_direction(
    predicted: Float[Array, "R J 3"], truth: Float[Array, "R J 3"], frames: int = 1, metric: Metric = mpjpe_mm
) -> Bool[Array, "T"]:
    """Return per frame whether the prediction would be nearer to the truth, by this metric, with its time reversed.

    Args:
        predicted: joints [m].
        truth: joints [m], at the same instants.
        frames: number of frames that the rows divide into.
        metric: error of one frame's sub-frames.
    """
    pairs = zip(np.split(predicted, frames), np.split(truth, frames), strict=True)
    return np.array([metric(one[::-1], other) < metric(one, other) for one, other in pairs])


def turned_in_time(rows: Float[Array, "R *s"], wrong: Bool[Array, "T"]) -> Float[Array, "R *s"]:
    """Reverse time in the frames whose direction is wrong.

    Args:
        rows: a row per sub-frame.
        wrong: by `wrong_direction`.
    """
    turned = np.repeat(wrong, len(rows) // len(wrong))
    return np.where(turned.reshape(-1, *[1] * (rows.ndim - 1)), reverse_time(rows, len(wrong)), rows)


def better_of_both(
    metric: Metric, predicted: Float[Array, "R J 3"], truth: Float[Array, "R J 3"], frames: int = 1
) -> float:
    """Return the metric of the prediction with every frame in the direction of time that has the lower error.

    Args:
        metric: error of joints against the truth.
        predicted: joints [m].
        truth: joints [m], at the same instants.
        frames: number of frames that the rows divide into.
    """
    return metric(turned_in_time(predicted, wrong_direction(predicted, truth, frames, metric)), truth)


@dataclass(frozen=True)
class MotionErrors:
    """Errors of one clip for a results table; all lengths in mm.

    Attributes:
        mpjpe_mm: over SMPL's 24 joints, in the predicted direction of time.
        pa_mpjpe_mm: over SMPL's 24 joints, in the predicted direction of time.
        mpjpe_14_mm: over the 14 joints shared with Human3.6M.
        pa_mpjpe_14_mm: over the 14 joints shared with Human3.6M.
        better_mpjpe_mm: in the better direction of time, chosen frame by frame.
        better_pa_mpjpe_mm: in the better direction of time, chosen frame by frame.
        in_plane_mm: MPJPE's residuals across and along the view.
        depth_mm: MPJPE's residuals across and along the view.
        wrong_direction: share of frames that would be nearer to the truth with their time reversed.
    """

    mpjpe_mm: float
    pa_mpjpe_mm: float
    mpjpe_14_mm: float
    pa_mpjpe_14_mm: float
    better_mpjpe_mm: float
    better_pa_mpjpe_mm: float
    in_plane_mm: float
    depth_mm: float
    wrong_direction: float


def motion_errors(predicted: Float[Array, "R 24 3"], truth: Float[Array, "R 24 3"], frames: int = 1) -> MotionErrors:
    """Return all motion metrics of one clip of `frames` frames with R / frames sub-frames each.

    Args:
        predicted: joints [m].
        truth: joints [m], at the same instants.
        frames: number of frames that the rows divide into.
    """
    in_plane, depth = in_plane_depth_mm(predicted, truth)
    return MotionErrors(
        mpjpe_mm=mpjpe_mm(predicted, truth),
        pa_mpjpe_mm=pa_mpjpe_mm(predicted, truth),
        mpjpe_14_mm=mpjpe_mm(predicted, truth, H36M_14),
        pa_mpjpe_14_mm=pa_mpjpe_mm(predicted, truth, H36M_14),
        better_mpjpe_mm=better_of_both(mpjpe_mm, predicted, truth, frames),
        better_pa_mpjpe_mm=better_of_both(pa_mpjpe_mm, predicted, truth, frames),
        in_plane_mm=in_plane,
        depth_mm=depth,
        wrong_direction=float(wrong_direction(predicted, truth, frames).mean()),
    )


def blur_rate(silhouettes: Float[Array, "S H W"]) -> float:
    """Return |union of R_S(i)| / |R_S(1)| - 1, the union being the pixelwise maximum: 0 for a body at rest.

    Of one frame; the rate of a clip is the mean over its frames.

    Args:
        silhouettes: R_S of one frame's sub-frames, in [0, 1].

    Raises:
        ValueError: the first silhouette is empty.
    """
    first = _float64(silhouettes[0]).sum()
    if first <= 0:
        raise ValueError("the blur rate is undefined: the first sub-frame's silhouette is empty")
    return float(_float64(silhouettes.max(0)).sum() / first - 1)


def soft_iou(alpha: Float[Array, "H W"], matte: Float[Array, "H W"]) -> float:
    """Return sum min / sum max of two mattes, the paper's IoU: 1 only where they agree. Two empty ones agree.

    Args:
        alpha: one matte.
        matte: the other one.
    """
    covered = _float64(np.maximum(alpha, matte)).sum()
    return float(_float64(np.minimum(alpha, matte)).sum() / covered) if covered > 0 else 1.0


def silhouette_iou(predicted: Float[Array, "S H W"], truth: Float[Array, "S H W"]) -> float:
    """Return the mean IoU of rendered and true silhouettes over the sub-frames.

    Args:
        predicted: rendered silhouettes.
        truth: true silhouettes.
    """
    return float(np.mean([soft_iou(one, other) for one, other in zip(predicted, truth, strict=True)]))


def psnr_db(
    predicted: Float[Array, "H W 3"], truth: Float[Array, "H W 3"], mask: Float[Array, "H W"] | None = None
) -> float:
    """Return the peak signal-to-noise ratio [dB] of images in [0, 1]; infinite where they are equal.

    Args:
        predicted: image in [0, 1].
        truth: true image in [0, 1].
        mask: weight per pixel, such as the matte; the whole image when not given, or when it is empty.
    """
    squared = ((_float64(predicted) - _float64(truth)) ** 2).mean(-1)
    weighted = mask is not None and mask.sum() > 0
    error = float(np.average(squared, weights=_float64(mask)) if weighted and mask is not None else squared.mean())
    return math.inf if error == 0 else -10 * math.log10(error)


def ssim(
    predicted: Float[Array, "H W 3"], truth: Float[Array, "H W 3"], mask: Float[Array, "H W"] | None = None
) -> float:
    """Return the structural similarity of images in [0, 1] (Wang et al. 2004, eq. 13, mean of channels); 1 where equal.

    The paper's own settings: a Gaussian window of sigma 1.5 (11 pixels), biased covariances, K1 .01, K2 .03.

    Args:
        predicted: image in [0, 1].
        truth: true image in [0, 1].
        mask: weight per pixel of the map of similarities, such as the matte; when not given, or when it is empty, the
            mean is over the image but for a rim of half a window.

    Raises:
        ValueError: an image smaller than the window.
    """
    if min(predicted.shape[:2]) < 2 * _SSIM_RIM_PX + 1:
        raise ValueError(f"a picture of {predicted.shape[1]} x {predicted.shape[0]} px is smaller than SSIM's window")
    p, t = _float64(predicted), _float64(truth)
    p_mean, t_mean = _window_mean(p), _window_mean(t)
    variances = (_window_mean(p * p) - p_mean * p_mean) + (_window_mean(t * t) - t_mean * t_mean)
    covariance = _window_mean(p * t) - p_mean * t_mean
    luminance, structure = _K1**2, _K2**2
    per_pixel = ((2 * p_mean * t_mean + luminance) * (2 * covariance + structure)) / (
        (p_mean**2 + t_mean**2 + luminance) * (variances + structure)
    )
    if mask is None or mask.sum() <= 0:
        inside = slice(_SSIM_RIM_PX, -_SSIM_RIM_PX)
        return float(np.mean([channel.mean() for channel in np.moveaxis(per_pixel[inside, inside], -1, 0)]))
    return float(np.average(per_pixel.mean(-1), weights=_float64(mask)))


def _window_mean(values: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
    return gaussian_filter(values, _SSIM_SIGMA_PX, radius=_SSIM_RIM_PX, axes=(0, 1))


def _float64(values: Array) -> Array:
    return np.asarray(values, dtype=np.float64)


def _aligned_residual(
    predicted: Array, truth: Array, centre: Sequence[int] = (_PELVIS,), counted: Array | None = None
) -> Array:
    """Return predicted - truth, both centred (on the pelvis), the prediction turned by one rotation.

    The rotation is the best one for the counted joints; the residuals of other joints are meaningless.
    """
    source, target = _float64(predicted), _float64(truth)
    source = source - source[:, centre].mean(1, keepdims=True)
    target = target - target[:, centre].mean(1, keepdims=True)
    if counted is not None:
        source, target = source * counted[..., None], target * counted[..., None]
    return rotate_sequence(source, target) - target


def _mean_of_known(values: Array) -> float:
    """Return the mean without NaN; NaN of no value."""
    known = np.isfinite(values)
    return float(values[known].mean()) if known.any() else math.nan


def _mean_mm(residual: Array, joints: Sequence[int] | None) -> float:
    chosen = slice(None) if joints is None else list(joints)
    return 1000 * float(np.linalg.norm(residual[:, chosen], axis=-1).mean())
