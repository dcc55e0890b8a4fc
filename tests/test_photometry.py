"""sRGB and linear light: the standard's values, and that they are each other's inverse."""

import numpy as np
import pytest
import torch

from hfb.photometry import linear_to_srgb, srgb_to_linear

# Computed by hand from IEC 61966-2-1's two formulas.
_KNOWN = [(0.0, 0.0), (0.02, 0.02 / 12.92), (0.04045, 0.04045 / 12.92), (0.5, (0.555 / 1.055) ** 2.4), (1.0, 1.0)]


@pytest.mark.parametrize(("encoded", "linear"), _KNOWN)
def test_the_standards_values(encoded, linear):
    assert srgb_to_linear(np.array([encoded]))[0] == pytest.approx(linear, abs=1e-12)
    assert srgb_to_linear(torch.tensor([encoded], dtype=torch.float64)).item() == pytest.approx(linear, abs=1e-12)
    assert linear_to_srgb(np.array([linear]))[0] == pytest.approx(encoded, abs=1e-7)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_they_are_each_others_inverse_and_keep_the_type(dtype):
    values = np.linspace(0, 1, 4097, dtype=dtype)
    back = linear_to_srgb(srgb_to_linear(values))
    assert back.dtype == dtype
    assert np.abs(back - values).max() < 5e-7
    tensor = linear_to_srgb(srgb_to_linear(torch.from_numpy(values)))
    assert tensor.dtype == torch.from_numpy(values).dtype
    np.testing.assert_allclose(tensor.numpy(), back, atol=1e-6)


def test_half_the_light_reads_as_more_than_half():
    assert 255 * linear_to_srgb(np.array([0.5]))[0] == pytest.approx(188, abs=1)


@pytest.mark.parametrize("convert", [srgb_to_linear, linear_to_srgb])
def test_gradients_are_finite_and_right_at_and_beyond_both_ends(convert):
    values = torch.tensor([-0.1, 0.0, 1e-9, 0.002, 0.3, 1.0, 1.2], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(convert, (values,))
    convert(values).sum().backward()
    assert values.grad is not None
    assert torch.isfinite(values.grad).all()
    assert (values.grad > 0).all()
