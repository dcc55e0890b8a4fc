"""Accuracy of a motion prior on held-out motions, by exposure time."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import torch

from hfb.priors.motion_columns import COLUMN_COUNT, LIMBS, at_instants, joint_places, mean_rest_joints, reversed_columns
from hfb.priors.motion_networks import Corrector, Discriminator
from hfb.training.priors.motion_corruption import corrupt, with_errors_of_a_fit
from hfb.typing import Array, Bool, Float, Tensor

EXPOSURES_S: tuple[float, ...] = (0.03, 0.06, 0.12, 0.25, 0.5)
"""Edges of the intervals of exposure time."""

_MOVING_M = 0.03
"""Joints with a shorter path during the exposure do not count: their direction hardly matters."""

_JOINTS = COLUMN_COUNT - 1
Measures = dict[str, float | None]


@torch.no_grad()
def measure_motion_prior(
    discriminator: Discriminator,
    corrector: Corrector,
    columns: Float[Tensor, "n 3 25 4"],
    exposure_s: Float[Array, "n"],
    seed: int,
) -> dict[str, Any]:
    """Measure accuracies on artificially reversed motions, and the gain of the correction.

    Args:
        discriminator: trained.
        corrector: trained.
        columns: motion in the body's own frame, see `motion_columns`.
        exposure_s: exposure of every motion.
        seed: of the random numbers.

    Returns:
        ``count``; ``all`` and ``by_exposure`` (a list, in the order of `EXPOSURES_S`) with

        - ``whole_body``: share of motions whose direction as a whole is known; ``whole_body_cross_entropy``;
        - ``joint``, and per limb: share of joints that move visibly whose direction is known, when the direction of
          every limb was drawn independently;
        - ``joint_cross_entropy``: of those (log 2 = 0.693 for a coin);
        - ``whole_body_estimated``, ``joint_estimated``, ``joint_estimated_cross_entropy``: the same of motions with the
          errors of a fit;
        - ``indicator``: share of entries classified correctly as realistic or unrealistic (reversed ones included),
          among motions corrupted as in training, each kind with the same weight;
        - ``coefficients_wrong``, ``coefficients_corrected``: mean L1 distance of C from the truth before and after G;
        - ``adversarial_true``, ``adversarial_reversed``: L_A of true motions, and of those with limbs reversed.
        None where there is nothing to measure.
    """
    generator = torch.Generator().manual_seed(seed)
    exposures = torch.from_numpy(exposure_s)
    every = torch.ones(len(columns), dtype=torch.bool)
    edges = list(pairwise(EXPOSURES_S))
    last = EXPOSURES_S[-1]
    bins = [(exposures >= low) & ((exposures < high) | (high == last)) for low, high in edges]
    values = _values(discriminator, corrector, columns, generator)

    def over(which: Bool[Tensor, "n"]) -> Measures:
        return {name: value(which) for name, value in values.items()}

    by_exposure = [
        {"from_s": low, "to_s": high, "count": int(inside.sum()), **over(inside)}
        for (low, high), inside in zip(edges, bins, strict=True)
    ]
    return {"count": len(columns), "all": over(every), "by_exposure": by_exposure}


def _values(
    discriminator: Discriminator, corrector: Corrector, columns: Tensor, generator: torch.Generator
) -> dict[str, Callable[[Tensor], float | None]]:
    """Return each measure as a function of a selection of motions."""
    rest = mean_rest_joints()
    u = torch.tensor([0.0, 1.0])
    rotations, translations = at_instants(columns, u)
    places = joint_places(rest, rotations.flatten(0, 1), translations.flatten(0, 1)).unflatten(0, (-1, 2))
    moving = (places[:, 1] - places[:, 0]).norm(dim=-1) > _MOVING_M

    whole = discriminator.odds(columns, rest)[1]
    backwards = torch.zeros(len(columns), COLUMN_COUNT, dtype=torch.bool)
    for members in LIMBS.values():
        backwards[:, list(members)] = torch.rand(len(columns), 1, generator=generator) < 0.5
    some = reversed_columns(columns, backwards)
    logits, unrealistic, _ = discriminator(some, rest)
    right, entropy = _against(discriminator.odds(some, rest)[0], backwards)
    estimated = with_errors_of_a_fit(columns, generator)
    logits_estimated = discriminator.odds(reversed_columns(estimated, backwards), rest)[0]
    distance_reversed = (corrector(some, logits, unrealistic) - some).abs().mean((1, 2, 3))
    seen = discriminator(columns, rest)
    distance_true = (corrector(columns, *seen[:2]) - columns).abs().mean((1, 2, 3))
    values = {
        "whole_body": _share(whole[:, None] < 0),
        "whole_body_cross_entropy": _share(torch.nn.functional.softplus(whole)[:, None]),
        "joint": _share(right, moving),
        "joint_cross_entropy": _share(entropy, moving),
        "whole_body_estimated": _share(discriminator(estimated, rest)[2][:, None] < 0),
        "joint_estimated": _share(_against(logits_estimated, backwards)[0], moving),
        "joint_estimated_cross_entropy": _share(_against(logits_estimated, backwards)[1], moving),
        "adversarial_true": _share(distance_true[:, None]),
        "adversarial_reversed": _share(distance_reversed[:, None]),
        **_with_corruption(discriminator, corrector, columns, generator),
    }
    for limb, members in LIMBS.items():
        joints = [column for column in members if column < _JOINTS]
        values[limb.replace(" ", "_")] = _share(right[:, joints], moving[:, joints])
    return values


def _against(logits: Tensor, backwards: Tensor) -> tuple[Tensor, Tensor]:
    """Return which joints' directions are known, and the cross entropies."""
    logits, backwards = logits[:, :_JOINTS], backwards[:, :_JOINTS]
    entropy = torch.nn.functional.binary_cross_entropy_with_logits(logits, backwards.to(logits), reduction="none")
    return (logits > 0) == backwards, entropy


def _with_corruption(
    discriminator: Discriminator, corrector: Corrector, columns: Tensor, generator: torch.Generator
) -> dict[str, Callable[[Tensor], float | None]]:
    """Return measures on motions corrupted as in training."""
    batch = corrupt(columns, generator)
    backwards, unrealistic, _ = discriminator(batch.columns, mean_rest_joints())
    corrected = corrector(batch.columns, backwards, unrealistic)
    wrong = batch.backwards | batch.unrealistic
    told = (torch.sigmoid(backwards) + torch.sigmoid(unrealistic) * torch.sigmoid(-backwards)) > 0.5
    right = told == wrong

    def balanced(which: Tensor) -> float | None:
        kinds = [right[which][wrong[which] == kind] for kind in (True, False)]
        return None if min(map(len, kinds)) == 0 else sum(float(kind.float().mean()) for kind in kinds) / 2

    return {
        "indicator": balanced,
        "coefficients_wrong": _share((batch.columns - batch.clean).abs().mean((1, 2, 3))[:, None]),
        "coefficients_corrected": _share((corrected - batch.clean).abs().mean((1, 2, 3))[:, None]),
    }


def _share(values: Tensor, counted: Tensor | None = None) -> Callable[[Tensor], float | None]:
    """Return the mean of the counted values as a function of a selection of motions."""

    def mean(which: Tensor) -> float | None:
        chosen = values[which] if counted is None else values[which][counted[which]]
        return float(chosen.float().mean()) if chosen.numel() else None

    return mean
