"""Our own pose mixture: training against known answers, the joint limits beside it, and its files."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import hfb
from hfb.datasets.motions.sources import open_motions
from hfb.errors import InputError
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.gmm import GmmPrior
from hfb.priors.load import load_pose_prior
from hfb.priors.mixture import MixturePrior, shipped_mixture, write_mixture
from hfb.training.priors.mixture_training import log_densities, mirrored_poses, train_mixture
from hfb.training.priors.training_spec import PoseTraining

KNEE = 3  # of joints 1 to 23: the left one, which bends about +x
DATA = Path(hfb.__file__).parent / "priors" / "data"


def two_habits(count: int, seed: int) -> np.ndarray:
    """Poses of two kinds: arms down (three quarters), or arms up."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(0, 0.05, (count, 23, 3))
    up = rng.random(count) < 0.25
    poses[:, 15, 2] += np.where(up, 1.0, -1.0)
    poses[:, 16, 2] -= np.where(up, 1.0, -1.0)
    return poses.reshape(count, 69)


def test_training_finds_the_habits() -> None:
    spec = PoseTraining(components=2, floor_deg=1)
    told: list[float] = []
    mixture = train_mixture(two_habits(800, 0), spec, 0, lambda n, most, likelihood: told.append(likelihood))
    order = np.argsort(mixture.weights)
    np.testing.assert_allclose(mixture.weights[order], [0.25, 0.75], atol=0.04)
    shoulder = mixture.means.reshape(2, 23, 3)[order, 15, 2]
    np.testing.assert_allclose(shoulder, [1, -1], atol=0.02)
    spread = np.sqrt(mixture.covariances[:, 10, 10])
    np.testing.assert_allclose(spread, np.hypot(0.05, np.radians(1)), rtol=0.1)
    assert mixture.history == told
    assert (np.diff(told) > -1e-6).all()


def test_the_likelihood_is_scipys() -> None:
    from scipy.stats import multivariate_normal

    poses = two_habits(200, 1)
    mixture = train_mixture(poses, PoseTraining(components=2, epochs=3), 0)
    expected = [
        multivariate_normal(mean, covariance).logpdf(poses) + np.log(weight)
        for mean, covariance, weight in zip(mixture.means, mixture.covariances, mixture.weights, strict=True)
    ]
    np.testing.assert_allclose(log_densities(poses, mixture), np.stack(expected, 1), rtol=1e-9)


def test_the_seed_decides_and_mirrors_are_alike() -> None:
    poses = two_habits(300, 2)
    spec = PoseTraining(components=3, epochs=5)
    first, second = train_mixture(poses, spec, 1), train_mixture(poses, spec, 1)
    np.testing.assert_array_equal(first.means, second.means)
    np.testing.assert_allclose(mirrored_poses(mirrored_poses(poses)), poses)


def test_joints_that_never_move_stay_finite() -> None:
    poses = np.zeros((50, 69))
    mixture = train_mixture(poses, PoseTraining(components=4, floor_deg=3), 0)
    assert np.isfinite(log_densities(poses, mixture)).all()
    np.testing.assert_allclose(np.diagonal(mixture.covariances, axis1=1, axis2=2), np.radians(3) ** 2, rtol=1e-6)
    with pytest.raises(ValueError, match="at least as many"):
        train_mixture(poses[:3], PoseTraining(components=4), 0)


def test_no_knee_bends_backwards() -> None:
    prior = shipped_mixture()
    poses = torch.zeros(3, 23, 3)
    poses[1, KNEE, 0], poses[2, KNEE, 0] = 0.6, -0.6
    straight, forwards, backwards = prior(poses)
    assert backwards > forwards + 30
    assert backwards > straight + 30
    torch.testing.assert_close(prior(poses), prior.mixture(poses) + AnatomicalPrior().limit_penalty(poses))


def test_its_size_is_that_of_the_other_priors() -> None:
    """One weight has to serve them all: a few tens for ordinary poses, of people it has not learned from."""
    poses = torch.from_numpy(np.concatenate([open_motions(None, 0).load(n).poses[::10, 1:] for n in (0, 13, 17, 34)]))
    ours, anatomical = shipped_mixture()(poses).median(), AnatomicalPrior()(poses).median()
    assert 5 < ours < 120
    assert ours < 6 * anatomical


def test_files(tmp_path: Path) -> None:
    mixture = train_mixture(two_habits(200, 3), PoseTraining(components=2, epochs=3), 0)
    path = tmp_path / "pose.safetensors"
    write_mixture(path, mixture.means, mixture.covariances, mixture.weights)
    prior = load_pose_prior(path)
    assert isinstance(prior, MixturePrior)
    poses = torch.from_numpy(two_habits(5, 4)).unflatten(1, (23, 3))
    bare = GmmPrior(mixture.means, mixture.covariances, mixture.weights, "test")
    torch.testing.assert_close(prior.mixture(poses), bare(poses), rtol=1e-4, atol=1e-3)
    assert isinstance(load_pose_prior(None, "mixture"), MixturePrior)
    assert isinstance(load_pose_prior(None), AnatomicalPrior)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="damaged"):
        load_pose_prior(path)


def test_gradients_are_the_slope() -> None:
    poses = (0.3 * torch.randn(4, 23, 3, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(shipped_mixture(), (poses,), eps=1e-6, rtol=1e-3)


def test_shipped_mixture_is_the_documented_one() -> None:
    import hashlib

    about = json.loads((DATA / "pose_mixture.json").read_text())
    assert hashlib.sha256((DATA / "pose_mixture.safetensors").read_bytes()).hexdigest() == about["sha256"]
    assert not any(name.split("_")[1] in ("09", "10", "13") for name in about["data"]["trained"])
