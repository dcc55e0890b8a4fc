"""Our own pose mixture: Gaussians over recorded poses, with the anatomical joint limits beside them."""

from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save

from hfb.io.atomic import write_bytes_atomic
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.gmm import GmmPrior
from hfb.typing import Array, Float, Tensor

LIMITS_KEY = "joint_limits"
"""An array of a mixture's file that stands for "keep the joint limits"; SMPLify's files have none."""


class MixturePrior:
    """prior = mixture + limits: the likeliest Gaussian's part as in `GmmPrior`, plus the excess of the joint limits.

    A mixture alone is smooth: a knee bent backwards by a few degrees is as near to its means as one bent forwards.

    Args:
        means: mu_k, axis-angle of joints 1 to 23 [rad].
        covariances: Sigma_k.
        weights: w_k; they are normalised to sum to one.
        source: the file's name in messages.

    Raises:
        InputError: as for `GmmPrior`.
    """

    def __init__(
        self, means: Float[Array, "..."], covariances: Float[Array, "..."], weights: Float[Array, "..."], source: str
    ) -> None:
        self.mixture = GmmPrior(means, covariances, weights, source)
        self._anatomy = AnatomicalPrior()

    def __call__(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """See `PosePrior`."""
        return self.mixture(axis_angle) + self._anatomy.limit_penalty(axis_angle)


def write_mixture(
    path: Path, means: Float[Array, "k 69"], covariances: Float[Array, "k 69 69"], weights: Float[Array, "k"]
) -> None:
    """Write a mixture that keeps the joint limits (safetensors, single precision), whole or not at all.

    Args:
        path: the file.
        means: means of the components.
        covariances: covariances of the components.
        weights: weights of the components.
    """
    arrays = {"means": means, "covariances": covariances, "weights": weights, LIMITS_KEY: np.ones(1)}
    write_bytes_atomic(path, save({name: np.ascontiguousarray(one, np.float32) for name, one in arrays.items()}))


@lru_cache(maxsize=1)
def shipped_mixture() -> MixturePrior:
    """Load the mixture of data/pose_mixture.safetensors; data/pose_mixture.json tells how it was fitted."""
    with resources.as_file(resources.files("hfb.priors") / "data" / "pose_mixture.safetensors") as path:
        arrays = {name: one.astype(np.float64) for name, one in load_file(path).items()}
    return MixturePrior(arrays["means"], arrays["covariances"], arrays["weights"], "the built-in pose mixture")
