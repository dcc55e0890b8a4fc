"""The static body that every fit starts from."""

from dataclasses import dataclass

from hfb.shapes import Float, Tensor


@dataclass(frozen=True)
class FirstBody:
    """One body for one frame, in camera coordinates.

    Attributes:
        pose: axis-angle per joint [rad], the root first; the root rotates the rest body into the camera's frame.
        translation: added to the posed vertices, as in SMPL [m].
        betas: shape coefficients of the body model in use.
        source: which estimator made it, e.g. ``"mediapipe"`` or ``"matte"``.
    """

    pose: Float[Tensor, "24 3"]
    translation: Float[Tensor, "3"]
    betas: Float[Tensor, "10"]
    source: str
