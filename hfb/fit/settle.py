"""Before any picture is drawn: move the skeleton to where the joint network saw the joints."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from hfb.config import FitConfig, Weights
from hfb.fit.variables import Variables, falling
from hfb.objective import Objective
from hfb.shapes import Float, Tensor

_RATE, _SHAPE_RATE = 0.02, 1.0
_JOINTS, _PATH = 1.0, 0.3


def settle(variables: Variables, objective: Objective, config: FitConfig) -> None:
    """Adam on pose, place, motion and shape by the terms that need no picture; changes the variables in place.

    A limb that lies wholly beside its place in the picture has no edge in common with it and is never pulled there by
    images; a body that errs by a metre neither.
    """
    skeleton, trajectory = settling(objective), variables.trajectory

    def loss() -> Float[Tensor, ""]:
        shaped = objective.body.shape(variables.betas)
        motion = variables.motion(objective.body)
        return skeleton.total(skeleton.body_terms(motion, variables.betas, shaped))

    def keep_within() -> None:
        variables.keep_within(config, objective.body)

    settle_by(loss, [trajectory.rotation, trajectory.translation], variables.betas, config, keep_within)


def settling(objective: Objective) -> Objective:
    """The objective with what counts before any picture is drawn."""
    held = objective.weights
    weights = Weights(
        image=0, matte=0, boundary=held.boundary, joints=_JOINTS, path=_PATH, height=held.height,
        pose=held.pose / 20, shape=held.shape, motion=held.motion / 10, start=held.start / 10,
    )  # fmt: skip
    return replace(objective, weights=weights, across=1.0, settling=True)


def settle_by(
    loss: Callable[[], Float[Tensor, ""]],
    moving: Sequence[Tensor],
    betas: Tensor,
    config: FitConfig,
    keep_within: Callable[[], None],
) -> None:
    """Adam on the tensors that move the body and on its betas, in place; of one fit or of many that are summed."""
    groups = [{"params": list(moving), "lr": _RATE}, {"params": [betas], "lr": _RATE * _SHAPE_RATE}]
    optimizer = torch.optim.Adam(groups, eps=config.adam_epsilon, fused=True)
    for iteration in range(config.settle):
        share = falling(iteration, config.settle)
        optimizer.param_groups[0]["lr"], optimizer.param_groups[1]["lr"] = _RATE * share, _RATE * _SHAPE_RATE * share
        optimizer.zero_grad()
        loss().backward()
        optimizer.step()
        keep_within()
