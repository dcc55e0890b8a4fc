"""Distance from what a network saw, in units of how sure it was; not in the paper."""

from hfb.shapes import Float, Tensor


def evidence_loss(off: Float[Tensor, "*n"]) -> Float[Tensor, ""]:
    """Mean of sqrt(1 + x^2) - 1 over all coordinates: quadratic where the claim holds, linear where it may be wrong.

    Args:
        off: differences from the claim, divided by its own scale.
    """
    return ((1 + off * off).sqrt() - 1).mean()
