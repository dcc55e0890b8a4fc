"""VPoser: the two published layouts with generated weights, against torch's own layers."""

import pytest
import torch
from torch import nn

from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.priors.vposer import VPoserPrior


def _randomized(module: nn.Module, seed: int) -> nn.Module:
    """Weights and batch-norm statistics away from their neutral values, in evaluation mode."""
    generator = torch.Generator().manual_seed(seed)
    for layer in module.modules():
        if isinstance(layer, nn.Linear):
            layer.weight.data = torch.randn(layer.weight.shape, generator=generator) / layer.in_features**0.5
            layer.bias.data = 0.1 * torch.randn(layer.bias.shape, generator=generator)
        if isinstance(layer, nn.BatchNorm1d):
            for tensor in (layer.weight.data, layer.running_var, layer.bias.data, layer.running_mean):
                tensor.copy_(0.2 + torch.rand(tensor.shape, generator=generator))
    return module.eval().double()


class Version2(nn.Module):
    """The layers of VPoser v2 under their published names (32 hidden units instead of 512)."""

    def __init__(self, hidden: int = 32, latent: int = 8) -> None:
        super().__init__()
        self.encoder_net = nn.Sequential(
            nn.Flatten(),
            nn.BatchNorm1d(63),
            nn.Linear(63, hidden),
            nn.LeakyReLU(),
            nn.BatchNorm1d(hidden),
            nn.Dropout(0.1),
            nn.Linear(hidden, hidden),
            nn.Linear(hidden, hidden),
            nn.ModuleDict({"mu": nn.Linear(hidden, latent), "logvar": nn.Linear(hidden, latent)}),
        )
        self.decoder_net = nn.Sequential(
            nn.Linear(latent, hidden),
            nn.LeakyReLU(),
            nn.Dropout(0.1),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, 126),
        )

    def encode(self, pose):
        return self.encoder_net[8]["mu"](self.encoder_net[:8](pose))

    def decode(self, latent):
        return self.decoder_net(latent)


class Version1(nn.Module):
    """The layers of VPoser v1 under their published names."""

    def __init__(self, inputs: int = 63, hidden: int = 32, latent: int = 8) -> None:
        super().__init__()
        self.bodyprior_enc_bn1, self.bodyprior_enc_fc1 = nn.BatchNorm1d(inputs), nn.Linear(inputs, hidden)
        self.bodyprior_enc_bn2, self.bodyprior_enc_fc2 = nn.BatchNorm1d(hidden), nn.Linear(hidden, hidden)
        self.bodyprior_enc_mu, self.bodyprior_enc_logvar = nn.Linear(hidden, latent), nn.Linear(hidden, latent)
        self.bodyprior_dec_fc1, self.bodyprior_dec_fc2 = nn.Linear(latent, hidden), nn.Linear(hidden, hidden)
        self.bodyprior_dec_out = nn.Linear(hidden, 126)

    def encode(self, pose):
        leaky = nn.LeakyReLU(0.2)
        hidden = leaky(self.bodyprior_enc_fc1(self.bodyprior_enc_bn1(pose)))
        return self.bodyprior_enc_mu(leaky(self.bodyprior_enc_fc2(self.bodyprior_enc_bn2(hidden))))

    def decode(self, latent):
        leaky = nn.LeakyReLU(0.2)
        return self.bodyprior_dec_out(leaky(self.bodyprior_dec_fc2(leaky(self.bodyprior_dec_fc1(latent)))))


def make_vposer(version: int, **sizes: int) -> nn.Module:
    """A VPoser with generated weights."""
    return _randomized(Version1(**sizes) if version == 1 else Version2(**sizes), version)


def _poses(count: int = 5) -> torch.Tensor:
    return 0.4 * torch.randn(count, 23, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(7))


@pytest.mark.parametrize("version", [1, 2])
def test_the_latent_means_norm_as_torchs_own_layers_give_it(version):
    module, poses = make_vposer(version), _poses()
    prior = VPoserPrior.from_state({f"vp_model.{name}": value for name, value in module.state_dict().items()}, "test")
    assert prior.version == f"VPoser v{version}"
    expected = module.encode(poses[:, :21].flatten(1))
    torch.testing.assert_close(prior.encode(poses[:, :21]), expected, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(prior(poses), (expected**2).sum(1), rtol=1e-5, atol=1e-5)


def test_a_version_1_that_takes_matrices():
    module, poses = make_vposer(1, inputs=189), _poses()
    prior = VPoserPrior.from_state(module.state_dict(), "test")
    expected = module.encode(axis_angle_to_matrix(poses[:, :21]).flatten(1))
    torch.testing.assert_close(prior.encode(poses[:, :21]), expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("version", [1, 2])
def test_the_decoder_gives_rotations_whose_first_columns_lead(version):
    module = make_vposer(version)
    prior = VPoserPrior.from_state(module.state_dict(), "test")
    latent = torch.randn(4, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(8))
    matrices = prior.decode(latent)
    columns = module.decode(latent).unflatten(1, (21, 3, 2))
    torch.testing.assert_close(matrices @ matrices.mT, torch.eye(3, dtype=torch.float64).expand_as(matrices))
    assert (torch.linalg.det(matrices) > 0).all()
    torch.testing.assert_close(matrices[..., 0], nn.functional.normalize(columns[..., 0], dim=-1), rtol=1e-4, atol=1e-4)


def test_gradients_match_finite_differences_and_leave_the_hands_alone():
    prior = VPoserPrior.from_state(make_vposer(2).state_dict(), "test")
    poses = _poses(2).requires_grad_()
    assert torch.autograd.gradcheck(prior, (poses,))
    prior(poses).sum().backward()
    assert poses.grad[:, 21:].abs().max() == 0
    assert poses.grad[:, :21].abs().min() > 0


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda state: {}, "no VPoser encoder"),
        (lambda state: {k: v for k, v in state.items() if "decoder_net.3" not in k}, "lacks 'decoder_net.3"),
        (lambda state: state | {"encoder_net.2.bias": torch.zeros(3)}, "damaged"),
        (lambda state: state | {"encoder_net.4.running_var": torch.full((32,), torch.nan)}, "damaged"),
        (lambda state: state | {"decoder_net.0.weight": torch.zeros(32, 9)}, "do not fit"),
        (
            lambda state: state | {"decoder_net.5.weight": torch.zeros(9, 32), "decoder_net.5.bias": torch.zeros(9)},
            "21",
        ),
    ],
)
def test_damaged_checkpoints_are_refused_with_a_sentence(damage, sentence):
    with pytest.raises(InputError, match=sentence):
        VPoserPrior.from_state(damage(make_vposer(2).state_dict()), "test")
