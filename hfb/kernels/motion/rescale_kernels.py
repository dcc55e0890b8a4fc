"""Compiled rescaling of a path for other betas that keeps the size in the image, with gradients."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

import numpy as np
from numba import njit

from hfb.kernels.compile import JIT, LOOP, entry


@njit(**LOOP)
def _rest(betas, template, rows, joints):
    """Fill the joints (72) of the rest pose [m]."""
    for n in range(joints.shape[0]):
        joints[n] = template[n]
        for k in range(betas.shape[0]):
            joints[n] += np.float64(rows[k, n]) * betas[k]


@njit(**LOOP)
def _length(joints, parents):
    """Return the total length of all bones [m]."""
    total = 0.0
    for child in range(1, parents.shape[0]):
        x, y, z = _bone(joints, parents[child], child)
        total += np.sqrt(x * x + y * y + z * z)
    return total


@njit(**LOOP)
def _bone(joints, parent, child):
    a, b = 3 * parent, 3 * child
    return joints[b] - joints[a], joints[b + 1] - joints[a + 1], joints[b + 2] - joints[a + 2]


@njit(**JIT)
def _people(betas, reference, template, rows, parents):
    """Return rest joints of both people, and the ratio of their bones' lengths."""
    now, before = np.empty(template.shape[0], np.float64), np.empty(template.shape[0], np.float64)
    _rest(betas, template, rows, now)
    _rest(reference, template, rows, before)
    return now, before, _length(now, parents) / _length(before, parents)


@entry
def as_large(translation, betas, reference, template, rows, parents, moved):
    """Rescale a path so that a person with other betas looks as large in the image.

    Args:
        translation: (T, D1, 4), coefficients of the path [m].
        betas: (K), shape coefficients.
        reference: (K), shape for which `translation` holds.
        template: (72), rest joints with betas of zero [m].
        rows: (K, 72), see `hfb.body.model.Body.shape_rows`.
        parents: (24), -1 for the root.
        moved: (T, D1, 4), coefficients of the rescaled path [m], filled.
    """
    now, before, factor = _people(betas, reference, template, rows, parents)
    for t in range(translation.shape[0]):
        for d in range(translation.shape[1]):
            for c in range(3):
                moved[t, d, c] = factor * translation[t, d, c]
            moved[t, d, 3] = translation[t, d, 3]
        for c in range(3):
            moved[t, 0, c] = factor * (np.float64(translation[t, 0, c]) + before[c]) - now[c]


@entry
def as_large_gradient(translation, betas, reference, template, rows, parents, grad_output, of_translation, of_betas):
    """Compute the gradients of `as_large`.

    Args:
        translation: (T, D1, 4), coefficients of the path [m].
        betas: (K), shape coefficients.
        reference: (K), shape for which `translation` holds.
        template: (72), rest joints with betas of zero [m].
        rows: (K, 72), see `hfb.body.model.Body.shape_rows`.
        parents: (24), -1 for the root.
        grad_output: gradient by the rescaled coefficients.
        of_translation: gradient, filled.
        of_betas: gradient, filled.
    """
    now, before, factor = _people(betas, reference, template, rows, parents)
    of_joints, of_factor = np.zeros(now.shape[0], np.float64), 0.0
    for t in range(translation.shape[0]):
        for d in range(translation.shape[1]):
            for c in range(3):
                of_translation[t, d, c] = factor * grad_output[t, d, c]
                of_factor += np.float64(grad_output[t, d, c]) * translation[t, d, c]
            of_translation[t, d, 3] = grad_output[t, d, 3]
        for c in range(3):
            of_factor += grad_output[t, 0, c] * before[c]
            of_joints[c] -= grad_output[t, 0, c]
    of_factor /= _length(before, parents)
    for child in range(1, parents.shape[0]):
        x, y, z = _bone(now, parents[child], child)
        of_length = of_factor / np.sqrt(x * x + y * y + z * z)
        for c, along in enumerate((x, y, z)):
            of_joints[3 * child + c] += of_length * along
            of_joints[3 * parents[child] + c] -= of_length * along
    for k in range(betas.shape[0]):
        total = 0.0
        for n in range(of_joints.shape[0]):
            total += rows[k, n] * of_joints[n]
        of_betas[k] = total
