"""sRGB and linear light, by IEC 61966-2-1.

A sensor averages linear light, image files hold sRGB. Blurring sRGB values instead of light is off by up to
48/255, and an alpha of 0.5 then reads as 0.705.
"""

from typing import Literal, overload

import numpy as np
import torch

from hfb.typing import Array, Float, Tensor

Transfer = Literal["srgb", "linear", "bt709", "gamma22"]
"""The transfer curve of stored values."""

_ENCODED_KNEE = 0.04045
_LINEAR_KNEE = 0.0031308


@overload
def srgb_to_linear(encoded: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]: ...
@overload
def srgb_to_linear(encoded: Float[Array, "*n"]) -> Float[Array, "*n"]: ...
def srgb_to_linear(encoded: Tensor | Array) -> Tensor | Array:
    """Decode sRGB values to linear light: c / 12.92 up to 0.04045, ((c + 0.055) / 1.055)^2.4 above.

    Values below 0 and above 1 follow the same two pieces; the type (torch or numpy, 32 or 64 bit) is kept.
    Differentiable with a finite gradient everywhere, 0 included.

    Args:
        encoded: sRGB.
    """
    # The power branch is evaluated above its knee only: the other branch's gradient would be NaN times zero.
    if isinstance(encoded, torch.Tensor):
        power = ((encoded.clamp_min(_ENCODED_KNEE) + 0.055) / 1.055) ** 2.4
        return torch.where(encoded <= _ENCODED_KNEE, encoded / 12.92, power)
    power_numpy = ((np.maximum(encoded, _ENCODED_KNEE) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= _ENCODED_KNEE, encoded / 12.92, power_numpy)


@overload
def linear_to_srgb(linear: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]: ...
@overload
def linear_to_srgb(linear: Float[Array, "*n"]) -> Float[Array, "*n"]: ...
def linear_to_srgb(linear: Tensor | Array) -> Tensor | Array:
    """Encode linear light as sRGB: 12.92 c up to 0.0031308, 1.055 c^(1/2.4) - 0.055 above.

    The inverse of `srgb_to_linear` but for the standard's own rounding of the two knees (below 1e-7).

    Args:
        linear: linear light.
    """
    if isinstance(linear, torch.Tensor):
        power = 1.055 * linear.clamp_min(_LINEAR_KNEE) ** (1 / 2.4) - 0.055
        return torch.where(linear <= _LINEAR_KNEE, linear * 12.92, power)
    power_numpy = 1.055 * np.maximum(linear, _LINEAR_KNEE) ** (1 / 2.4) - 0.055
    return np.where(linear <= _LINEAR_KNEE, linear * 12.92, power_numpy)


def as_srgb(stored: Float[Array, "*n"], transfer: Transfer) -> Float[Array, "*n"]:
    """Encode stored values as sRGB; those of ``srgb`` and ``linear`` stay as they are.

    ``bt709``: the camera's curve of ITU-R BT.709, 4.5 L below 0.018 and 1.099 L^0.45 - 0.099 above; ``gamma22``:
    L^(1/2.2).

    Args:
        stored: values of a file in [0, 1].
        transfer: the file's curve.
    """
    if transfer in ("srgb", "linear"):
        return stored
    if transfer == "gamma22":
        linear = np.maximum(stored, 0) ** 2.2
    else:
        linear = np.where(stored < 0.081, stored / 4.5, ((np.maximum(stored, 0.081) + 0.099) / 1.099) ** (1 / 0.45))
    return linear_to_srgb(linear).astype(stored.dtype)
