"""The warm-up stage: fit the skeleton to the predicted joints before any image is rendered."""

from dataclasses import replace

from hfb.config import FitConfig
from hfb.fitting.variables import Variables, cosine_decay
from hfb.kernels.adam import Adam
from hfb.objective.objective import Objective
from hfb.objective.weights import stage_weights

_RATE = 0.02


def fit_skeleton(variables: Variables, objective: Objective, config: FitConfig) -> None:
    """Minimise the terms that need no image over pose, place, motion and shape, with Adam.

    A limb whose rendering does not overlap its image has no gradient from it; neither has a body that is off by a
    metre.

    Args:
        variables: changed in place.
        objective: with the joint network's predictions.
        config: options of the fit.
    """
    skeleton, body, (*moving, _) = warmup_objective(objective, config), objective.body, variables.leaves()
    optimizer = Adam(moving, config.adam_epsilon)
    for iteration in range(config.settle):
        motion, shaped = variables.motion(body), body.shape(variables.betas)
        skeleton.backward(skeleton.body_terms(motion, variables.betas, shaped))
        optimizer.step([warmup_rate(iteration, config)] * len(moving))
        variables.project_(body)


def warmup_rate(iteration: int, config: FitConfig) -> float:
    """Return the learning rate of all variables of the skeleton.

    Args:
        iteration: number of the iteration, from 0 on.
        config: options of the fit.
    """
    return _RATE * cosine_decay(iteration, config.settle)


def warmup_objective(objective: Objective, config: FitConfig) -> Objective:
    """Return the objective with the warm-up's weights.

    Args:
        objective: at full size.
        config: options of the fit.
    """
    seen = objective.observation
    return replace(objective.for_stage(seen, stage_weights(config, len(seen.mattes), "warm-up")), warm_up=True)
