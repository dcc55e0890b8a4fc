"""VPoser as a pose prior (Pavlakos et al. 2019, SMPL-X): the squared norm of a pose's latent mean.

Written from the published architecture; the weights are licensed and come from the user. Version 1 and version 2
checkpoints differ in their names and in two details of the encoder, see `_LAYOUTS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import torch

from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix, six_d_to_matrix
from hfb.typing import Float, Tensor

BODY_JOINTS = 21
"""VPoser knows SMPL's joints 1 to 21; the two hands are not part of it."""

_BATCH_NORM_EPSILON = 1e-5


@dataclass(frozen=True)
class _Layout:
    """Names of a version's layers; each encoder layer is (batch norm before it or "", linear, slope after it)."""

    encoder: tuple[tuple[str, str, float], ...]
    decoder: tuple[tuple[str, str, float], ...]


_LAYOUTS = {
    "VPoser v2": _Layout(
        encoder=(
            ("encoder_net.1", "encoder_net.2", 0.01),
            ("encoder_net.4", "encoder_net.6", 1.0),
            ("", "encoder_net.7", 1.0),
            ("", "encoder_net.8.mu", 1.0),
        ),
        decoder=(("", "decoder_net.0", 0.01), ("", "decoder_net.3", 0.01), ("", "decoder_net.5", 1.0)),
    ),
    "VPoser v1": _Layout(
        encoder=(
            ("bodyprior_enc_bn1", "bodyprior_enc_fc1", 0.2),
            ("bodyprior_enc_bn2", "bodyprior_enc_fc2", 0.2),
            ("", "bodyprior_enc_mu", 1.0),
        ),
        decoder=(("", "bodyprior_dec_fc1", 0.2), ("", "bodyprior_dec_fc2", 0.2), ("", "bodyprior_dec_out", 1.0)),
    ),
}


@dataclass(frozen=True, eq=False)
class _Dense:
    """y = leaky(W x + b); a slope of 1 is no non-linearity."""

    weight: Float[Tensor, "out in"]
    bias: Float[Tensor, "out"]
    slope: float

    def __call__(self, x: Float[Tensor, "S in"]) -> Float[Tensor, "S out"]:
        y = torch.nn.functional.linear(x, *_placed(self, x.device, x.dtype))
        return y if self.slope == 1 else torch.nn.functional.leaky_relu(y, self.slope)


class VPoserPrior:
    """prior(theta) = |mu(theta)|_2^2, the latent mean's squared norm: VPoser's latent space is a unit Gaussian.

    Dropout is off and batch norms use their running statistics, as at any time but training.

    Args:
        version: version of the checkpoint.
        encoder: layers of the encoder.
        decoder: layers of the decoder.
    """

    def __init__(self, version: str, encoder: tuple[_Dense, ...], decoder: tuple[_Dense, ...]) -> None:
        self.version = version
        self._encoder, self._decoder = encoder, decoder

    @classmethod
    def from_state(cls, state: Mapping[str, Tensor], source: str) -> "VPoserPrior":
        """Build from a checkpoint's tensors by name.

        Args:
            state: with or without a prefix such as ``vp_model.`` before the names.
            source: the file's name in messages.

        Raises:
            InputError: neither version's layers, or layers that do not fit together.
        """
        for version, layout in _LAYOUTS.items():
            first = f"{layout.encoder[0][1]}.weight"
            prefix = next((name.removesuffix(first) for name in state if name.endswith(first)), None)
            if prefix is not None:
                encoder = tuple(_dense(state, prefix, layer, source) for layer in layout.encoder)
                decoder = tuple(_dense(state, prefix, layer, source) for layer in layout.decoder)
                _check_sizes(encoder, decoder, source)
                return cls(version, encoder, decoder)
        raise InputError(f"{source}: no VPoser encoder in it; give a VPoser v1 or v2 snapshot (.pt, .ckpt)")

    def __call__(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """See `PosePrior`; the two hands get no gradient."""
        return (self.encode(axis_angle[:, :BODY_JOINTS]) ** 2).sum(-1)

    def encode(self, axis_angle: Float[Tensor, "S 21 3"]) -> Float[Tensor, "S L"]:
        """Return the latent mean mu of a pose.

        Args:
            axis_angle: joints below the root [rad].
        """
        matrices = self._encoder[0].weight.shape[1] == 9 * BODY_JOINTS
        x = (axis_angle_to_matrix(axis_angle) if matrices else axis_angle).flatten(1)
        for layer in self._encoder:
            x = layer(x)
        return x

    def decode(self, latent: Float[Tensor, "S L"]) -> Float[Tensor, "S 21 3 3"]:
        """Return the pose of a latent vector, as rotation matrices.

        Args:
            latent: code of every pose.
        """
        x = latent
        for layer in self._decoder:
            x = layer(x)
        # VPoser writes the first two columns of a matrix row by row.
        return six_d_to_matrix(x.unflatten(1, (BODY_JOINTS, 3, 2)).transpose(-1, -2).flatten(-2))


@lru_cache(maxsize=64)
def _placed(layer: _Dense, device: torch.device, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Return a layer's weight and bias in the pose's precision and device; copied to a device once."""
    return layer.weight.to(device, dtype), layer.bias.to(device, dtype)


def _dense(state: Mapping[str, Tensor], prefix: str, layer: tuple[str, str, float], source: str) -> _Dense:
    """Fold the batch norm before a linear layer into it: W (s x + t) + b = (W s) x + (W t + b)."""
    norm, linear, slope = layer

    def read(name: str) -> Tensor:
        if prefix + name not in state:
            raise InputError(f"{source}: the VPoser checkpoint lacks {prefix + name!r}; download it again")
        return state[prefix + name].detach().double()

    weight, bias = read(f"{linear}.weight"), read(f"{linear}.bias")
    fits = weight.ndim == 2 and bias.shape == weight.shape[:1]
    if norm and fits:
        variance = read(f"{norm}.running_var")
        scale = read(f"{norm}.weight") / (variance + _BATCH_NORM_EPSILON).sqrt()
        shift = read(f"{norm}.bias") - read(f"{norm}.running_mean") * scale
        fits = scale.shape == shift.shape == weight.shape[1:]
        if fits:
            weight, bias = weight * scale, bias + weight @ shift
    if not fits or not bool(torch.isfinite(weight).all() and torch.isfinite(bias).all()):
        raise InputError(f"{source}: VPoser's layer {prefix + linear!r} is damaged; download the checkpoint again")
    return _Dense(weight.float(), bias.float(), slope)


def _check_sizes(encoder: tuple[_Dense, ...], decoder: tuple[_Dense, ...], source: str) -> None:
    inputs, outputs = encoder[0].weight.shape[1], decoder[-1].weight.shape[0]
    chain = pairwise(encoder + decoder)
    if inputs not in (3 * BODY_JOINTS, 9 * BODY_JOINTS) or outputs != 6 * BODY_JOINTS:
        raise InputError(f"{source}: VPoser with {inputs} inputs and {outputs} outputs is none of {BODY_JOINTS} joints")
    if any(before.weight.shape[0] != after.weight.shape[1] for before, after in chain):
        raise InputError(f"{source}: VPoser's layers do not fit together; download the checkpoint again")
