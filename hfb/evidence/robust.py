"""Distance from what a network saw, in units of how sure it was; not in the paper."""

from hfb.typing import Float, Tensor


def evidence_loss(off: Float[Tensor, "*n"], share: Float[Tensor, "axes"] | None = None) -> Float[Tensor, ""]:
    """Mean of sqrt(1 + x^2) - 1 over all coordinates: quadratic where the claim holds, linear where it may be wrong.

    Args:
        off: differences from the claim, divided by its own scale.
        share: of the word of every coordinate along the last axis; all of it when not given.
    """
    far = (1 + off * off).sqrt() - 1
    return far.mean() if share is None else (far * share).mean()
