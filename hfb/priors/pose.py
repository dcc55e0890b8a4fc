"""The protocol of pose priors."""

from typing import Protocol, runtime_checkable

from hfb.typing import Float, Tensor


@runtime_checkable
class PosePrior(Protocol):
    """The improbability of a body pose.

    All priors here are of one size: a few tens for an ordinary pose (each is about half a squared Mahalanobis
    norm over the pose's degrees of freedom), so one weight serves them all.
    """

    def __call__(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """Return a number >= 0 per pose, lower for likelier poses; differentiable.

        Args:
            axis_angle: joints below the root [rad].
        """
        ...
