"""Rotations of whole recordings in numpy: quaternions (w, x, y, z), any leading dimensions, float64.

`hfb.geometry.rotations` serves fits (torch, gradients); this module is several times faster for long clips.
"""

import numpy as np

from hfb.typing import Array, Float


def from_axis_angle(axis_angle: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Return the rotation by |axis_angle| [rad] about its direction, safe at zero.

    Args:
        axis_angle: rotation vector [rad].
    """
    half = np.sqrt((axis_angle * axis_angle).sum(-1, keepdims=True)) / 2
    return np.concatenate([np.cos(half), axis_angle * (np.sinc(half / np.pi) / 2)], -1)


def to_axis_angle(quaternion: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Return the logarithm, angle in [0, pi].

    Args:
        quaternion: (w, x, y, z) of any length but zero.
    """
    w = quaternion[..., :1]
    xyz = quaternion[..., 1:] * np.where(w < 0, -1.0, 1.0)
    sine = np.sqrt((xyz * xyz).sum(-1, keepdims=True))
    cosine = np.abs(w)
    small = sine < 1e-9 * cosine
    ratio = np.where(
        small, 2 / np.where(cosine > 0, cosine, 1), 2 * np.arctan2(sine, cosine) / np.where(small, 1, sine)
    )
    return xyz * ratio


def multiply(left: Float[Array, "*a 4"], right: Float[Array, "*b 4"]) -> Float[Array, "*c 4"]:
    """Return the Hamilton product, broadcast: the rotation `right` followed by `left`.

    Args:
        left: (w, x, y, z).
        right: (w, x, y, z).
    """
    a, b, c, d = (left[..., i] for i in range(4))
    e, f, g, h = (right[..., i] for i in range(4))
    parts = [
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ]
    return np.stack(parts, -1)


def conjugate(quaternion: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
    """Return the inverse rotation of a unit quaternion.

    Args:
        quaternion: (w, x, y, z).
    """
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(quaternion: Float[Array, "*a 4"], vector: Float[Array, "*b 3"]) -> Float[Array, "*c 3"]:
    """Rotate vectors by unit quaternions, broadcast.

    Args:
        quaternion: (w, x, y, z).
        vector: vectors to rotate.
    """
    w, xyz = quaternion[..., :1], quaternion[..., 1:]
    across = 2 * np.cross(xyz, vector)
    return vector + w * across + np.cross(xyz, across)


def align_signs(quaternion: Float[Array, "F *n 4"]) -> Float[Array, "F *n 4"]:
    """Return the same rotations over time, each frame's quaternion in the hemisphere of the one before.

    Args:
        quaternion: (w, x, y, z).
    """
    turned = (quaternion[1:] * quaternion[:-1]).sum(-1, keepdims=True) < 0
    signs = np.where(np.logical_xor.accumulate(turned, axis=0), -1.0, 1.0)
    return np.concatenate([quaternion[:1], quaternion[1:] * signs])


def unit(vector: Float[Array, "*n c"]) -> Float[Array, "*n c"]:
    """Return the vector's direction; nearly zero vectors stay so.

    Args:
        vector: vector of any length.
    """
    return vector / np.maximum(np.sqrt((vector * vector).sum(-1, keepdims=True)), 1e-12)


def share_of(quaternion: Float[Array, "*n 4"], share: float) -> Float[Array, "*n 4"]:
    """Return the rotation by a share of the angle (of the shorter way round).

    Args:
        quaternion: (w, x, y, z).
        share: share of the angle.
    """
    return from_axis_angle(share * to_axis_angle(quaternion))


def between(source: Float[Array, "*n 3"], target: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Return the smallest rotation from one direction to another.

    Args:
        source: unit vector.
        target: unit vector.
    """
    axis = np.cross(source, target)
    cosine = (source * target).sum(-1, keepdims=True)
    opposite = cosine < -1 + 1e-9  # any axis across will do
    across = np.cross(source, np.where(np.abs(source[..., :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0]))
    return unit(np.concatenate([np.where(opposite, 0, 1 + cosine), np.where(opposite, across, axis)], -1))


def from_axes(x: Float[Array, "*n 3"], y: Float[Array, "*n 3"], z: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Return the rotation that takes the coordinate axes to these (nearly) orthonormal ones.

    Shepperd's method, as in `hfb.geometry.rotations.matrix_to_quaternion`.

    Args:
        x: image of the x axis.
        y: image of the y axis.
        z: image of the z axis.
    """
    (a, d, g), (b, e, h), (c, f, k) = (np.moveaxis(axis, -1, 0) for axis in (x, y, z))
    rows = [
        [1 + a + e + k, h - f, c - g, d - b],
        [h - f, 1 + a - e - k, b + d, c + g],
        [c - g, b + d, 1 - a + e - k, f + h],
        [d - b, c + g, f + h, 1 - a - e + k],
    ]
    table = np.stack([np.stack(row, -1) for row in rows], -2)
    pivot = np.diagonal(table, axis1=-2, axis2=-1).argmax(-1)
    return unit(np.take_along_axis(table, pivot[..., None, None], -2)[..., 0, :])
