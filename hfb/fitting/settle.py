"""Before any picture is drawn: move the skeleton to where the joint network saw the joints."""

from dataclasses import replace

from hfb.config import FitConfig, Weights
from hfb.fitting.variables import Variables, falling
from hfb.kernels.adam import Adam
from hfb.objective.objective import Objective

_RATE = 0.02
_JOINTS, _PATH = 1.0, 0.3


def settle(variables: Variables, objective: Objective, config: FitConfig) -> None:
    """Adam on pose, place, motion and shape by the terms that need no picture; changes the variables in place.

    A limb that lies wholly beside its place in the picture has no edge in common with it and is never pulled there by
    images; a body that errs by a metre neither.
    """
    skeleton, body, (*moving, _) = settling(objective), objective.body, variables.leaves()
    optimizer = Adam(moving, config.adam_epsilon)
    for iteration in range(config.settle):
        motion, shaped = variables.motion(body), body.shape(variables.betas)
        skeleton.pull(skeleton.body_terms(motion, variables.betas, shaped))
        optimizer.step([settling_rate(iteration, config)] * len(moving))
        variables.keep_within(config, body)


def settling_rate(iteration: int, config: FitConfig) -> float:
    """Learning rate of all that moves a skeleton."""
    return _RATE * falling(iteration, config.settle)


def settling(objective: Objective) -> Objective:
    """The objective with what counts before any picture is drawn."""
    held = objective.weights
    weights = Weights(
        image=0, matte=0, boundary=held.boundary, joints=_JOINTS, path=_PATH, height=held.height,
        pose=held.pose / 20, shape=held.shape, motion=held.motion / 10, start=held.start / 10,
    )  # fmt: skip
    return replace(objective, weights=weights, across=1.0, settling=True)
