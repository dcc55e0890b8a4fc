"""Loss terms of a caller's own, added to eq. (11) with a weight each."""

from collections.abc import Callable
from dataclasses import dataclass

from hfb.body.model import ShapedBody
from hfb.errors import InputError
from hfb.motion.trajectory import Trajectory
from hfb.rendering.observation import Observation
from hfb.typing import Float, Tensor


@dataclass(frozen=True)
class TermInputs:
    """The variables of one evaluation of the objective, in camera coordinates; gradients flow through all tensors.

    Attributes:
        trajectory: polynomials of the motion [m].
        betas: shape coefficients.
        shaped: the body with these betas; ``shaped.pose`` gives vertices.
        rotations: of every joint at every sub-frame, the root first.
        translations: SMPL's translation at every sub-frame [m].
        joints: joint positions at every sub-frame [m].
        observation: frames, plate, mattes and camera at the stage's image size.
    """

    trajectory: Trajectory
    betas: Float[Tensor, "10"]
    shaped: ShapedBody
    rotations: Float[Tensor, "T S 24 3 3"]
    translations: Float[Tensor, "T S 3"]
    joints: Float[Tensor, "T S 24 3"]
    observation: Observation


@dataclass(frozen=True)
class OwnTerm:
    """A term of the caller's own.

    Attributes:
        name: in histories and errors; none of `hfb.config.Weights`.
        function: returns the unweighted term, a differentiable scalar >= 0.
        weight: its factor in the sum, the same in every stage and in the warm-up.
    """

    name: str
    function: Callable[[TermInputs], Tensor]
    weight: float = 1.0

    def __call__(self, inputs: TermInputs) -> Float[Tensor, ""]:
        """Return the unweighted term.

        Args:
            inputs: the variables.

        Raises:
            InputError: the function returns anything but a scalar tensor.
        """
        value = self.function(inputs)
        if not isinstance(value, Tensor) or value.ndim != 0 or not value.is_floating_point():
            found = f"a tensor of shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            raise InputError(f"the extra term {self.name!r} returned {found}: return a scalar tensor, such as a mean()")
        return value.to(inputs.betas.dtype)
