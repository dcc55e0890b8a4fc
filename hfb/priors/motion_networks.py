"""The two networks of the adversarial motion prior: the discriminator D and the correction-generator G."""

import numpy as np
import torch
from torch import nn

from hfb.body.skeleton import JOINT_COUNT
from hfb.kernels.dispatch import constant
from hfb.priors.motion_columns import COLUMN_COUNT, at_instants, joint_places
from hfb.typing import Float, Tensor

FEATURES_PER_JOINT = 19
FEATURE_COUNT = JOINT_COUNT * FEATURES_PER_JOINT + 2
_COEFFICIENT_COUNT = 3 * COLUMN_COUNT * 4
_STILL_M, _STILL_RAD = 0.002, 0.01
"""Motions smaller than these per exposure count as this large: nothing is divided by zero."""


def motion_features(columns: Float[Tensor, "T 3 25 4"], rest: Float[Tensor, "24 3"]) -> Float[Tensor, "T 458"]:
    """Return the input of D: per joint its rotation at mid-exposure and its position and motion in the body's frame.

    First and second differences of rotations and of joint positions are divided by their root mean square over the
    body, since distances depend on the exposure time. That scale is given as two features of its own.

    Args:
        columns: motion in the body's own frame, see `motion_columns`.
        rest: joints of the person's rest pose [m].
    """
    u = constant((0.0, 0.5, 1.0), columns.dtype, columns.device)
    rotations, translations = at_instants(columns, u)
    places = joint_places(rest, rotations.flatten(0, 1), translations.flatten(0, 1)).unflatten(0, (-1, 3))
    places = places - places[:, 1:2, :1]
    turn, bend = _tangent(columns[:, 0, :JOINT_COUNT], columns[:, 1:, :JOINT_COUNT]).unbind(1)
    steps, curves = places[:, 2] - places[:, 0], places[:, 2] - 2 * places[:, 1] + places[:, 0]
    turned = _root_mean_square(turn) + _STILL_RAD
    moved = _root_mean_square(steps) + _STILL_M
    parts = [columns[:, 0, :JOINT_COUNT], turn / turned, bend / turned, places[:, 1], steps / moved, curves / moved]
    scales = torch.cat([turned, moved], -1).flatten(1).log()
    return torch.cat([torch.cat(parts, -1).flatten(1), scales], -1)


def _tangent(middle: Float[Tensor, "T J 4"], change: Float[Tensor, "T 2 J 4"]) -> Float[Tensor, "T 2 J 3"]:
    """Return coefficients of a quaternion as rotation vectors [rad] in the joint's own frame: 2 (q^-1 c)."""
    w, xyz = middle[:, None, :, :1], middle[:, None, :, 1:]
    v, abc = change[..., :1], change[..., 1:]
    return 2 * (w * abc - v * xyz - torch.linalg.cross(xyz.expand_as(abc), abc))


def _root_mean_square(vectors: Float[Tensor, "T J 3"]) -> Float[Tensor, "T 1 1"]:
    return ((vectors * vectors).sum(-1).mean(-1)[:, None, None] + 1e-12).sqrt()


def _signs_when_reversed() -> Float[Tensor, "458"]:
    """Return the signs by which reversing the whole body changes its features: first differences are negated.

    Made by numpy: on torch's device `meta`, where sizes are counted, a concatenation imports torch's compiler.
    """
    signs = np.ones((JOINT_COUNT, FEATURES_PER_JOINT), np.float32)
    signs[:, [4, 5, 6, 13, 14, 15]] = -1
    return torch.from_numpy(np.append(signs, np.ones(2, np.float32)))


class _Gated(nn.Module):
    """silu(A x) * (B x): products of features, since "both run the same way" is a product of two directions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.both = nn.Linear(inputs, 2 * outputs)

    def forward(self, x: Float[Tensor, "T c"]) -> Float[Tensor, "T d"]:
        gate, value = self.both(x).chunk(2, -1)
        return nn.functional.silu(gate) * value


class _Residual(nn.Module):
    """x + linear(dropout(gated(norm(x))))."""

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.step = nn.Sequential(
            nn.LayerNorm(width), _Gated(width, width // 2), nn.Dropout(dropout), nn.Linear(width // 2, width)
        )

    def forward(self, x: Float[Tensor, "T c"]) -> Float[Tensor, "T c"]:
        return x + self.step(x)


def _trunk(inputs: int, width: int, depth: int, dropout: float) -> nn.Sequential:
    """Build fully connected layers with skip connections."""
    first = nn.Sequential(_Gated(inputs, width), nn.Dropout(dropout))
    return nn.Sequential(first, *[_Residual(width, dropout) for _ in range(depth - 1)], nn.LayerNorm(width))


class Discriminator(nn.Module):
    """D: for every column of C the log odds that it runs backwards in time, and that it is unrealistic otherwise.

    The paper's indicator has an entry per entry of C. A column runs backwards as a whole, so one number per column
    holds for all of its entries. By construction, from the motion and its reverse, reversing the whole body negates
    every output of the first kind and keeps those of the second kind.

    Args:
        width: width of the hidden layers.
        depth: number of hidden layers.
        dropout: dropout rate in training.
    """

    mean: Tensor
    spread: Tensor
    signs: Tensor
    temperature: Tensor

    def __init__(self, width: int, depth: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(FEATURE_COUNT))
        self.register_buffer("spread", torch.ones(FEATURE_COUNT))
        self.register_buffer("signs", _signs_when_reversed(), persistent=False)
        self.register_buffer("temperature", torch.ones(2))
        self.body = _trunk(FEATURE_COUNT, width, depth, dropout)
        self.exit = nn.Linear(width, 2 * COLUMN_COUNT + 1)

    def forward(
        self, columns: Float[Tensor, "T 3 25 4"], rest: Float[Tensor, "24 3"]
    ) -> tuple[Float[Tensor, "T 25"], Float[Tensor, "T 25"], Float[Tensor, "T"]]:
        """Log odds: each column reversed; each column unrealistic otherwise; the whole body reversed.

        Args:
            columns: motion in the body's own frame, see `motion_columns`.
            rest: joints of the rest pose [m].
        """
        features = motion_features(columns, rest)
        both = torch.cat([features, features * self.signs])
        forwards, backwards = self.exit(self.body((both - self.mean) / self.spread)).chunk(2)
        odd, even = forwards - backwards, forwards + backwards
        return odd[:, :COLUMN_COUNT], even[:, COLUMN_COUNT:-1], odd[:, -1]

    def odds(
        self, columns: Float[Tensor, "T 3 25 4"], rest: Float[Tensor, "24 3"]
    ) -> tuple[Float[Tensor, "T 25"], Float[Tensor, "T"]]:
        """Log odds that each column, and the whole body, runs backwards, as sure as they may be about strangers.

        Networks are overconfident about people and activities outside of their training data, so their log odds are
        divided by a temperature. The corrector G uses them as they are.

        Args:
            columns: motion in the body's own frame, see `motion_columns`.
            rest: joints of the rest pose [m].
        """
        backwards, _, whole = self(columns, rest)
        return backwards / self.temperature[0], whole / self.temperature[1]


class Corrector(nn.Module):
    """G: realistic coefficients from given ones and the indicator.

    It reverses columns by a gate, c1 -> (1 - 2 gate) c1, and adds a correction to every entry.

    Args:
        width: width of the hidden layers.
        depth: number of hidden layers.
        dropout: dropout rate in training.
    """

    mean: Tensor
    spread: Tensor

    def __init__(self, width: int, depth: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(3, COLUMN_COUNT, 4))
        self.register_buffer("spread", torch.ones(3, COLUMN_COUNT, 4))
        self.body = _trunk(_COEFFICIENT_COUNT + 2 * COLUMN_COUNT, width, depth, dropout)
        self.exit = nn.Linear(width, COLUMN_COUNT + _COEFFICIENT_COUNT)
        nn.init.zeros_(self.exit.weight)
        nn.init.zeros_(self.exit.bias)
        self.decisive = nn.Parameter(torch.ones(()))

    def forward(
        self, columns: Float[Tensor, "T 3 25 4"], backwards: Float[Tensor, "T 25"], unrealistic: Float[Tensor, "T 25"]
    ) -> Float[Tensor, "T 3 25 4"]:
        """Return the corrected C; the indicator is given as D's log odds.

        Args:
            columns: motion in the body's own frame, see `motion_columns`.
            backwards: log odds that each column runs backwards.
            unrealistic: log odds that the motion is not a person's.
        """
        seen = ((columns - self.mean) / self.spread).flatten(1)
        indicator = torch.cat([torch.sigmoid(backwards), torch.sigmoid(unrealistic)], -1)
        out = self.exit(self.body(torch.cat([seen, indicator], -1)))
        gate = torch.sigmoid(self.decisive * backwards + out[:, :COLUMN_COUNT])[:, None, :, None]
        turned = torch.cat([columns[:, :1], columns[:, 1:2] * (1 - 2 * gate), columns[:, 2:]], 1)
        return turned + out[:, COLUMN_COUNT:].unflatten(1, (3, COLUMN_COUNT, 4)) * self.spread
