"""SMPLify's mixture: against the density written out, and on damaged input."""

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from hfb.errors import InputError
from hfb.priors.gmm import GmmPrior


def make_mixture(components: int = 8, seed: int = 0) -> dict[str, np.ndarray]:
    """A mixture with the layout of gmm_08.pkl."""
    rng = np.random.default_rng(seed)
    factors = rng.normal(0, 0.2, (components, 69, 69)) * rng.uniform(0.5, 1.5, (components, 1, 1))
    weights = rng.uniform(0.5, 1.5, components)
    return {
        "means": rng.normal(0, 0.3, (components, 69)),
        "covars": factors @ factors.transpose(0, 2, 1) / 5 + 0.02 * np.eye(69),
        "weights": weights / weights.sum(),
    }


def test_it_is_the_likeliest_component_up_to_a_constant():
    mixture = make_mixture()
    prior = GmmPrior(mixture["means"], mixture["covars"], mixture["weights"], "test")
    poses = np.random.default_rng(1).normal(0, 0.3, (20, 69))
    poses[:8] = mixture["means"]
    densities = [
        multivariate_normal(mean, covariance).logpdf(poses) + np.log(weight)
        for mean, covariance, weight in zip(mixture["means"], mixture["covars"], mixture["weights"], strict=True)
    ]
    smallest = min(np.linalg.slogdet(covariance)[1] for covariance in mixture["covars"])
    constant = 69 / 2 * np.log(2 * np.pi) + smallest / 2
    value = prior(torch.from_numpy(poses).unflatten(1, (23, 3)))
    np.testing.assert_allclose(value.numpy(), -np.max(densities, 0) - constant, rtol=1e-9)
    assert (value > 0).all()
    single = prior(torch.from_numpy(poses).unflatten(1, (23, 3)).float())
    np.testing.assert_allclose(single.numpy(), value.numpy(), rtol=1e-3)


def test_gradients_match_finite_differences():
    mixture = make_mixture(3)
    prior = GmmPrior(mixture["means"], mixture["covars"], mixture["weights"], "test")
    poses = 0.3 * torch.randn(2, 23, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    assert torch.autograd.gradcheck(prior, (poses.requires_grad_(),))


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda m: m | {"means": m["means"][:, :63]}, "gmm_08.pkl"),
        (lambda m: m | {"covars": m["covars"][:3]}, "gmm_08.pkl"),
        (lambda m: m | {"covars": -m["covars"]}, "damaged"),
        (lambda m: m | {"means": np.full_like(m["means"], np.nan)}, "damaged"),
        (lambda m: m | {"weights": np.zeros(8)}, "damaged"),
    ],
)
def test_damaged_mixtures_are_refused_with_a_sentence(damage, sentence):
    mixture = damage(make_mixture())
    with pytest.raises(InputError, match=sentence):
        GmmPrior(mixture["means"], mixture["covars"], mixture["weights"], "test")
