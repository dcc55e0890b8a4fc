"""Training of the pose mixture: expectation and maximisation (Dempster, Laird & Rubin 1977) over recorded poses."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from hfb.body.skeleton import MIRROR
from hfb.training.priors.training_spec import PoseTraining
from hfb.typing import Array, Float

POSE_SIZE = 69
_LEAST_GAIN = 1e-4
"""Iterations end when the mean log likelihood of a pose grows by less."""

# (iteration, of how many at most, mean log likelihood)
OnIteration = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Mixture:
    """Gaussians over SMPL's 69 angles [rad], and the mean log likelihood of the training poses per iteration."""

    means: Float[Array, "k 69"]
    covariances: Float[Array, "k 69 69"]
    weights: Float[Array, "k"]
    history: list[float]


def mirrored_poses(poses: Float[Array, "n 69"]) -> Float[Array, "n 69"]:
    """Mirror poses: left and right are exchanged.

    Args:
        poses: axis-angle below the root [rad].
    """
    order = [joint - 1 for joint in MIRROR[1:]]
    return (poses.reshape(-1, 23, 3)[:, order] * [1.0, -1.0, -1.0]).reshape(-1, POSE_SIZE)


def train_mixture(
    poses: Float[Array, "n 69"], spec: PoseTraining, seed: int, on_iteration: OnIteration | None = None
) -> Mixture:
    """Fit a mixture to poses and their mirror images; the same seed gives the same mixture.

    Every covariance gets the floor's variance added, in every iteration: joints that a recording never moves (toes,
    fingers) would otherwise be held with infinite force, and a Gaussian could collapse onto a few poses. That suits
    poses with a noise of that size; the likelihood of the poses themselves ends a little below its peak.

    Args:
        poses: axis-angle of joints 1 to 23 [rad].
        spec: components and iterations.
        seed: of the random numbers.
        on_iteration: called with the iterations done and their total.

    Raises:
        ValueError: fewer poses than Gaussians.
    """
    if len(poses) < spec.components:
        raise ValueError(f"{spec.components} Gaussians need at least as many poses, not {len(poses)}")
    everything = np.concatenate([poses, mirrored_poses(poses)])
    floor = np.radians(spec.floor_deg) ** 2 * np.eye(POSE_SIZE)
    shares = _nearest(everything, _spread_out(everything, spec.components, np.random.default_rng(seed)))
    history: list[float] = []
    mixture = _maximised(everything, shares, floor, history)
    for iteration in range(spec.epochs):
        joint = log_densities(everything, mixture)
        total = logsumexp(joint, axis=1)
        history.append(float(total.mean()))
        if on_iteration:
            on_iteration(iteration + 1, spec.epochs, history[-1])
        if len(history) > 1 and history[-1] - history[-2] < _LEAST_GAIN:
            break
        mixture = _maximised(everything, np.exp(joint - total[:, None]), floor, history)
    return mixture


def log_densities(poses: Float[Array, "n 69"], mixture: Mixture) -> Float[Array, "n k"]:
    """Return log(w_k N(pose; mu_k, Sigma_k)) of every pose and Gaussian; logsumexp gives a pose's log likelihood.

    Args:
        poses: axis-angle below the root [rad].
        mixture: trained or shipped.
    """
    columns = []
    for mean, covariance, weight in zip(mixture.means, mixture.covariances, mixture.weights, strict=True):
        lower = np.linalg.cholesky(covariance)
        whitened = np.linalg.solve(lower, (poses - mean).T)
        normaliser = np.log(np.diagonal(lower)).sum() + POSE_SIZE / 2 * np.log(2 * np.pi)
        columns.append(np.log(max(weight, 1e-300)) - normaliser - (whitened * whitened).sum(0) / 2)
    return np.stack(columns, 1)


def _maximised(
    poses: Float[Array, "n 69"], shares: Float[Array, "n k"], floor: Float[Array, "69 69"], history: list[float]
) -> Mixture:
    """Return the mixture of highest likelihood for these shares; an empty component keeps a little of everything."""
    shares = shares + 1e-9
    counts = shares.sum(0)
    means = shares.T @ poses / counts[:, None]
    covariances = []
    for mean, share, count in zip(means, shares.T, counts, strict=True):
        off = poses - mean
        covariances.append((off * share[:, None]).T @ off / count + floor)
    return Mixture(means, np.stack(covariances), counts / counts.sum(), history)


def _spread_out(poses: Float[Array, "n 69"], count: int, generator: np.random.Generator) -> Float[Array, "k 69"]:
    """Choose first centres far from each other: k-means++ (Arthur & Vassilvitskii 2007)."""
    centres = [poses[generator.integers(len(poses))]]
    distance = ((poses - centres[0]) ** 2).sum(1)
    while len(centres) < count:
        total = distance.sum()
        odds = distance / total if total > 0 else np.full(len(poses), 1 / len(poses))
        centres.append(poses[generator.choice(len(poses), p=odds)])
        distance = np.minimum(distance, ((poses - centres[-1]) ** 2).sum(1))
    return np.stack(centres)


def _nearest(poses: Float[Array, "n 69"], centres: Float[Array, "k 69"], rounds: int = 10) -> Float[Array, "n k"]:
    """Return shares of one for the nearest centre, after a few rounds of k-means."""
    for _ in range(rounds):
        distances = (poses**2).sum(1)[:, None] - 2 * poses @ centres.T + (centres**2).sum(1)
        shares = (distances.argmin(1)[:, None] == np.arange(len(centres))).astype(float)
        filled = shares.sum(0) > 0
        centres = np.where(filled[:, None], shares.T @ poses / np.maximum(shares.sum(0), 1)[:, None], centres)
    return shares
