"""Compiled distances of joints from the joint network's predictions, with gradients.

`joints` are (T, S, 24, 3) [m, camera] at S instants, the last of them the middle of the exposure, the first its opening
and the last but one its closing; lenses (T, 5) as `hfb.evidence.joint_network.in_units` takes them.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import INLINE, loop_entry


@njit(**INLINE)
def _in_units(joints, lens, j):
    """Return joint j of (24, 3) in the units of its window."""
    x, y, z, pelvis = np.float64(joints[j, 0]), np.float64(joints[j, 1]), np.float64(joints[j, 2]), joints[0, 2]
    return x / z * lens[0] + lens[2], y / z * lens[1] + lens[3], (z - pelvis) / (pelvis * lens[4])


@njit(**INLINE)
def _units_backward(joints, lens, j, a, b, c, gradient):
    """Add to the `gradient` (24, 3) of the joints that by joint j's units."""
    x, y, z, pelvis = np.float64(joints[j, 0]), np.float64(joints[j, 1]), np.float64(joints[j, 2]), joints[0, 2]
    a, b, c = a * lens[0] / z, b * lens[1] / z, c / (pelvis * lens[4])
    gradient[j, 0] += a
    gradient[j, 1] += b
    gradient[j, 2] += c - (a * x + b * y) / z
    gradient[0, 2] -= c * z / pelvis


@njit(**INLINE)
def _far(off):
    """Return sqrt(1 + off^2) - 1, and its slope."""
    root = np.sqrt(1.0 + off * off)
    return root - 1.0, off / root


@loop_entry
def off_middle(joints, lenses, middle, scale, share, gradient):
    """Return `hfb.evidence.robust.evidence_loss` at the middle of the exposure; fill the gradient.

    Args:
        joints: (T, S, 24, 3) [m], camera coordinates; see the module.
        lenses: (T, 5), see `hfb.evidence.joint_network.in_units`.
        middle: (T, 24, 3), joints by the network.
        scale: (T, 24, 3), error scales of the network.
        share: (3), weight of each coordinate.
        gradient: filled.
    """
    total, last, count = 0.0, joints.shape[1] - 1, 3.0 * joints.shape[0] * joints.shape[2]
    gradient[:] = 0.0
    for t in range(joints.shape[0]):
        here = joints[t, last]
        for j in range(joints.shape[2]):
            a, b, c = _in_units(here, lenses[t], j)
            far_a, of_a = _far((a - middle[t, j, 0]) / scale[t, j, 0])
            far_b, of_b = _far((b - middle[t, j, 1]) / scale[t, j, 1])
            far_c, of_c = _far((c - middle[t, j, 2]) / scale[t, j, 2])
            total += share[0] * far_a + share[1] * far_b + share[2] * far_c
            of_a *= share[0] / (scale[t, j, 0] * count)
            of_b *= share[1] / (scale[t, j, 1] * count)
            of_c *= share[2] / (scale[t, j, 2] * count)
            _units_backward(here, lenses[t], j, of_a, of_b, of_c, gradient[t, last])
    return total / count


@njit(**INLINE)
def _off_path(joints, lenses, path, scale, sign, weight, gradient):
    """Return the loss of the path from opening to closing times the sign; add its gradient times the weight."""
    total, closing, count = 0.0, joints.shape[1] - 2, 3.0 * joints.shape[0] * joints.shape[2]
    for t in range(joints.shape[0]):
        for j in range(joints.shape[2]):
            before, after = _in_units(joints[t, 0], lenses[t], j), _in_units(joints[t, closing], lenses[t], j)
            far_a, of_a = _far((sign * (after[0] - before[0]) - path[t, j, 0]) / scale[t, j, 0])
            far_b, of_b = _far((sign * (after[1] - before[1]) - path[t, j, 1]) / scale[t, j, 1])
            far_c, of_c = _far((sign * (after[2] - before[2]) - path[t, j, 2]) / scale[t, j, 2])
            total += far_a + far_b + far_c
            if weight > 0.0:
                of_a *= sign * weight / (scale[t, j, 0] * count)
                of_b *= sign * weight / (scale[t, j, 1] * count)
                of_c *= sign * weight / (scale[t, j, 2] * count)
                _units_backward(joints[t, closing], lenses[t], j, of_a, of_b, of_c, gradient[t, closing])
                _units_backward(joints[t, 0], lenses[t], j, -of_a, -of_b, -of_c, gradient[t, 0])
    return total / count


@loop_entry
def off_path(joints, lenses, path, scale, both_ways, gradient):
    """Return `evidence_loss` of the path from opening to closing; fill the gradient.

    If both directions count it is the smaller of the path's loss and its reverse's, and each has half of the gradient
    where both are equal.

    Args:
        joints: (T, S, 24, 3) [m], camera coordinates; see the module.
        lenses: (T, 5), see `hfb.evidence.joint_network.in_units`.
        path: (T, 24, 3), displacements by the network.
        scale: (T, 24, 3), error scales of the network.
        both_ways: compare with the reverse, too.
        gradient: filled.
    """
    gradient[:] = 0.0
    if not both_ways:
        return _off_path(joints, lenses, path, scale, 1.0, 1.0, gradient)
    forth = _off_path(joints, lenses, path, scale, 1.0, 0.0, gradient)
    back = _off_path(joints, lenses, path, scale, -1.0, 0.0, gradient)
    if forth <= back:
        _off_path(joints, lenses, path, scale, 1.0, 0.5 if forth == back else 1.0, gradient)
    if back <= forth:
        _off_path(joints, lenses, path, scale, -1.0, 0.5 if forth == back else 1.0, gradient)
    return min(forth, back)


@loop_entry
def off_height(betas, per_beta, mean_m, log_height, scale, gradient):
    """Return `evidence_loss` of a person's height, mean_m + per_beta . betas; fill the gradient.

    Args:
        betas: (K), shape coefficients.
        per_beta: (K), height per unit of each beta [m].
        mean_m: height with betas of zero.
        log_height: logarithm of the height [m] by the network.
        scale: its error scale.
        gradient: filled.
    """
    height = mean_m
    for k in range(betas.shape[0]):
        height += np.float64(per_beta[k]) * betas[k]
    far, slope = _far((np.log(height) - log_height) / scale)
    for k in range(betas.shape[0]):
        gradient[k] = slope / (scale * height) * per_beta[k]
    return far
