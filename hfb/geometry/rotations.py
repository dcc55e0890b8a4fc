"""Rotations as quaternions (w, x, y, z), axis-angle vectors, matrices and 6D; safe at 0 and at pi.

All functions take any leading dimensions and are differentiable everywhere they are defined: norms are
taken so that their gradient at zero is finite (the motion starts at exactly zero).
"""

import torch

from hfb.typing import Float, Tensor


def _sinc(angle_squared: Tensor) -> Tensor:
    """Return sin(a)/a as a smooth function of a**2, by its series near zero."""
    small = angle_squared < 1e-8
    angle = torch.where(small, torch.ones_like(angle_squared), angle_squared).sqrt()
    return torch.where(small, 1 - angle_squared / 6, torch.sin(angle) / angle)


def axis_angle_to_quaternion(axis_angle: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 4"]:
    """Return the exponential map: the rotation by |axis_angle| [rad] about its direction.

    Args:
        axis_angle: rotation vector [rad].
    """
    half_squared = (axis_angle * axis_angle).sum(-1, keepdim=True) / 4
    small = half_squared < 1e-8
    half = torch.where(small, torch.ones_like(half_squared), half_squared).sqrt()
    cosine = torch.where(small, 1 - half_squared / 2, torch.cos(half))
    return torch.cat([cosine, axis_angle * _sinc(half_squared) / 2], -1)


def quaternion_to_axis_angle(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 3"]:
    """Return the logarithm of a unit quaternion; the angle is in [0, pi]. q and -q give the same vector.

    Args:
        quaternion: (w, x, y, z), unit length.
    """
    flip = torch.where(quaternion[..., :1] < 0, -1.0, 1.0).to(quaternion)
    w, xyz = quaternion[..., :1] * flip, quaternion[..., 1:] * flip
    sine_squared = (xyz * xyz).sum(-1, keepdim=True)
    small = sine_squared < 1e-12
    sine = torch.where(small, torch.ones_like(sine_squared), sine_squared).sqrt()
    factor = torch.where(small, 2 / w.clamp_min(0.5), 2 * torch.atan2(sine, w) / sine)
    return xyz * factor


def normalize_quaternion(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """Return the unit quaternion along the given one; a zero quaternion stays (nearly) zero instead of NaN.

    Args:
        quaternion: (w, x, y, z) of any length.
    """
    return quaternion * ((quaternion * quaternion).sum(-1, keepdim=True) + 1e-24).rsqrt()


def quaternion_to_matrix(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 3 3"]:
    """Return the rotation matrix of a unit quaternion.

    Args:
        quaternion: (w, x, y, z), unit length.
    """
    w, x, y, z = quaternion.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def matrix_to_quaternion(matrix: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 4"]:
    """Return the unit quaternion of a rotation matrix, w >= 0.

    Shepperd's method: of four equivalent formulas take the one with the largest pivot, so that nothing
    small is divided by, at any angle.

    Args:
        matrix: rotation matrix.
    """
    (a, b, c), (d, e, f), (g, h, k) = (row.unbind(-1) for row in matrix.unbind(-2))
    rows = [
        [1 + a + e + k, h - f, c - g, d - b],
        [h - f, 1 + a - e - k, b + d, c + g],
        [c - g, b + d, 1 - a + e - k, f + h],
        [d - b, c + g, f + h, 1 - a - e + k],
    ]
    table = torch.stack([torch.stack(row, -1) for row in rows], -2)  # row i is 4 q_i times the whole quaternion
    pivot = table.diagonal(dim1=-2, dim2=-1).argmax(-1)
    row = table.gather(-2, pivot[..., None, None].expand(*pivot.shape, 1, 4)).squeeze(-2)
    quaternion = normalize_quaternion(row)
    return torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def axis_angle_to_matrix(axis_angle: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3 3"]:
    """Apply Rodrigues' formula, through the quaternion.

    Args:
        axis_angle: rotation vector [rad].
    """
    return quaternion_to_matrix(axis_angle_to_quaternion(axis_angle))


def matrix_to_axis_angle(matrix: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 3"]:
    """Return the logarithm of a rotation matrix; the angle is in [0, pi].

    Args:
        matrix: rotation matrix.
    """
    return quaternion_to_axis_angle(matrix_to_quaternion(matrix))


def multiply_quaternions(left: Float[Tensor, "*n 4"], right: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """Return the Hamilton product: the rotation `right` followed by `left`.

    Args:
        left: (w, x, y, z).
        right: (w, x, y, z).
    """
    a, b, c, d = left.unbind(-1)
    e, f, g, h = right.unbind(-1)
    parts = [
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ]
    return torch.stack(parts, -1)


def six_d_to_matrix(six_d: Float[Tensor, "*n 6"]) -> Float[Tensor, "*n 3 3"]:
    """Return the rotation of a 6D vector (Zhou et al. 2019): two columns, made orthonormal by Gram-Schmidt.

    Args:
        six_d: the matrix's first two columns, one after the other.
    """
    first = torch.nn.functional.normalize(six_d[..., :3], dim=-1)
    second = six_d[..., 3:] - (first * six_d[..., 3:]).sum(-1, keepdim=True) * first
    second = torch.nn.functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], -1)


def in_hemisphere_of(quaternion: Float[Tensor, "*n 4"], reference: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """Return the one of q and -q (the same rotation) that is nearer to the reference.

    Args:
        quaternion: q, (w, x, y, z).
        reference: (w, x, y, z).
    """
    return torch.where((quaternion * reference).sum(-1, keepdim=True) < 0, -quaternion, quaternion)
