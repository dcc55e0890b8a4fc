"""Best rotations and similarities between joint clouds (Kabsch 1976, Umeyama 1991)."""

import numpy as np
import torch

from hfb.typing import Array, Bool, Float, Tensor


def best_rotation(source: Float[Array, "*s P 3"], target: Float[Array, "*s P 3"]) -> Float[Array, "*s 3 3"]:
    """Return the proper rotation R that minimises sum |R source - target|^2; no reflection, whatever the points.

    Both clouds are rotated about their origin: centre them first. With all points on a line or in one spot any of
    the equally good rotations is returned.

    Args:
        source: points to move.
        target: points to match, in the same order.
    """
    return nearest_rotation(np.swapaxes(target, -1, -2) @ source)


def nearest_rotation(product: Float[Array, "*s 3 3"]) -> Float[Array, "*s 3 3"]:
    """Return the proper rotation R that maximises trace(R^T product), the core of Kabsch's algorithm.

    Args:
        product: sum of target source^T over the points, centred.
    """
    left, _, right = np.linalg.svd(product)
    # Where the best orthogonal matrix is a mirror, flip the direction that costs least: the smallest singular value's.
    left[..., -1] *= np.sign(np.linalg.det(left @ right))[..., None]
    return left @ right


def nearest_rotations(product: Float[Tensor, "S 3 3"]) -> Float[Tensor, "S 3 3"]:
    """Return `nearest_rotation` of each, in torch, whose LAPACK differs from numpy's in last bits.

    Args:
        product: matrices, each near a rotation times anything positive.
    """
    left, _, right = torch.linalg.svd(product.double())
    mirror = torch.ones(len(product), 3, dtype=torch.float64)
    mirror[:, 2] = torch.linalg.det(left @ right)
    return (left @ torch.diag_embed(mirror) @ right).to(product)


def rotate_sequence(source: Float[Array, "R J 3"], target: Float[Array, "R J 3"]) -> Float[Array, "R J 3"]:
    """Turn the source by the ONE rotation about the origin that brings all its rows nearest to the target's.

    Args:
        source: points to move.
        target: points to match, in the same order.
    """
    rotation = best_rotation(source.reshape(-1, 3), target.reshape(-1, 3))
    return source @ rotation.T


def align_similarity(source: Float[Array, "R J 3"], target: Float[Array, "R J 3"]) -> Float[Array, "R J 3"]:
    """Move, turn and scale each row of the source to the target's (Procrustes, Umeyama 1991).

    A source shrunk to one point is moved onto the target's centre.

    Args:
        source: points to move.
        target: points to match, in the same order.
    """
    return align_known(source, target, np.ones(source.shape[:2], dtype=bool))


def align_known(
    source: Float[Array, "R J 3"], target: Float[Array, "R J 3"], known: Bool[Array, "R J"]
) -> Float[Array, "R J 3"]:
    """Apply `align_similarity` by the known joints of each row; the others move along with them.

    Unknown joints must be finite. The position of a row without a known joint is arbitrary.

    Args:
        source: points to move.
        target: points to match, in the same order.
        known: whether the target's joint is known.
    """
    weights = known[..., None].astype(source.dtype)
    count = np.maximum(weights.sum(1, keepdims=True), 1)
    source_centre, target_centre = (weights * source).sum(1, keepdims=True), (weights * target).sum(1, keepdims=True)
    source, target = source - source_centre / count, target - target_centre / count
    turned = source @ np.swapaxes(best_rotation(weights * source, weights * target), -1, -2)
    spread = (weights * source * source).sum((1, 2))
    scale = (weights * turned * target).sum((1, 2)) / np.where(spread > 0, spread, 1)
    return scale[:, None, None] * turned + target_centre / count
