"""Image formation, eq. (1) of the paper."""

from hfb.typing import Float, Tensor


def compose(foreground: Float[Tensor, "*t H W 4"], plate_linear: Float[Tensor, "H W 3"]) -> Float[Tensor, "*t H W 3"]:
    """Return I^ = (1 - mean R_S) B + mean(R_S R_F), in the light in which the sensor averages.

    Args:
        foreground: mean over the sub-frames of premultiplied colour and silhouette, as a rasteriser returns it.
        plate_linear: the clean background B.
    """
    return (1 - foreground[..., 3:]) * plate_linear + foreground[..., :3]
