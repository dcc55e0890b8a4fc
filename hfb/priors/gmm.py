"""SMPLify's pose prior (Bogo et al. 2016): a mixture of Gaussians over body poses."""

import numpy as np
import torch

from hfb.errors import InputError
from hfb.typing import Array, Float, Tensor

_POSE_SIZE = 69


class GmmPrior:
    """prior = min_k 1/2 (theta - mu_k)' inv(Sigma_k) (theta - mu_k) - log w_k + 1/2 log(|Sigma_k| / min |Sigma|).

    It approximates the sum of a mixture by its largest term, as in SMPLify's eq. (3): cheap, and without exponentials
    that vanish. The constant 69/2 log(2 pi) is left out and the determinants are relative to the smallest, as in
    SMPLify: every part is then >= 0.

    Args:
        means: mu_k, axis-angle of joints 1 to 23 [rad].
        covariances: Sigma_k.
        weights: w_k; they are normalised to sum to one.
        source: the file's name in messages.

    Raises:
        InputError: the sizes do not belong to SMPL's 69 angles, or a covariance is not positive definite.
    """

    def __init__(
        self, means: Float[Array, "..."], covariances: Float[Array, "..."], weights: Float[Array, "..."], source: str
    ) -> None:
        components = len(weights)
        if means.shape != (components, _POSE_SIZE) or covariances.shape != (components, _POSE_SIZE, _POSE_SIZE):
            raise InputError(
                f"{source}: a pose mixture over SMPL's {_POSE_SIZE} angles has means (k, {_POSE_SIZE}) and covariances "
                f"(k, {_POSE_SIZE}, {_POSE_SIZE}), this has {means.shape} and {covariances.shape}; give gmm_08.pkl"
            )
        try:
            lower = np.linalg.cholesky(covariances.astype(np.float64))
        except np.linalg.LinAlgError:
            lower = np.full_like(covariances, np.nan)
        finite = all(np.isfinite(part).all() for part in (lower, means, weights))
        if not finite or (weights <= 0).any():
            raise InputError(f"{source}: this pose mixture is damaged (not a distribution); download it again")
        half_log_determinants = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1)
        offsets = half_log_determinants - half_log_determinants.min() - np.log(weights / weights.sum())
        self.means = torch.from_numpy(means.astype(np.float64))
        self._whitening = torch.from_numpy(np.linalg.inv(lower))
        self._offsets = torch.from_numpy(offsets)
        self._copies: dict[tuple[torch.device, torch.dtype], tuple[Tensor, ...]] = {}

    def __call__(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """See `PosePrior`; the gradient is that of the nearest component."""
        poses = axis_angle.flatten(1)
        means, whitening, offsets = self._parts(poses.device, poses.dtype)
        whitened = torch.einsum("kij,skj->ski", whitening, poses[:, None] - means)
        return ((whitened * whitened).sum(-1) / 2 + offsets).amin(-1)

    def _parts(self, device: torch.device, dtype: torch.dtype) -> tuple[Tensor, ...]:
        """Return means, whitening and offsets in the pose's precision and device; copied to a device once."""
        key = device, dtype
        if key not in self._copies:
            self._copies[key] = tuple(part.to(device, dtype) for part in (self.means, self._whitening, self._offsets))
        return self._copies[key]
