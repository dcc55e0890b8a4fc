"""The interface of methods: an observation in, a predicted motion out."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from hfb.datasets.case import Case
from hfb.evaluation.prediction import Prediction
from hfb.motion.static_pose import FirstBody
from hfb.rendering.observation import Observation


@runtime_checkable
class Method(Protocol):
    """A method that predicts case after case; every prediction is a function of its arguments alone."""

    name: str

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Predict the motion of one case.

        Args:
            case: gives the number by which other systems' results are looked up; only oracles, which are named so, read
                its truth.
            observation: the frames with estimated mattes.
            starts: the static estimate of every frame, the same for all methods.

        Raises:
            InputError: this case cannot be answered (nobody found, a network that fails).
            FloatingPointError: the optimisation or a network gives values that are not finite.
        """
        ...
