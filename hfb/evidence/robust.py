"""The robust loss of predictions, in units of their error scale; not in the paper."""

from hfb.typing import Float, Tensor


def evidence_loss(off: Float[Tensor, "*n"], share: Float[Tensor, "axes"] | None = None) -> Float[Tensor, ""]:
    """Return the mean of sqrt(1 + x^2) - 1 over all coordinates: quadratic near the prediction, linear far from it.

    Args:
        off: differences from the prediction, divided by its error scale.
        share: factor of every coordinate of the last axis; 1 when not given.
    """
    far = (1 + off * off).sqrt() - 1
    return far.mean() if share is None else (far * share).mean()
