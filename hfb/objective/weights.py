"""Weights of eq. (11) per preset and stage. `hfb.config` has the values; no other module multiplies one.

`python -m hfb.objective.weights` prints docs/reference/weights.md.
"""

from dataclasses import dataclass
from typing import Literal, get_args

from hfb.config import FitConfig, Weights, preset

StageKind = Literal["warm-up", "coarse", "full"]
"""Skeleton alone; images below the last stage's size; images at the last stage's size."""

WARM_UP_JOINTS, WARM_UP_PATH = 1.0, 0.3
WARM_UP_DIVISORS = {"pose": 20, "motion": 10, "start": 10}
"""Divisors of the regularisers' weights until the skeleton has moved to the network's joints."""

REFINED_HEIGHT_SCALE = 0.22
"""Factor of the height's standard deviation once render and image are compared: about 20 times its weight."""


@dataclass(frozen=True)
class StageWeights:
    """Weights of one stage.

    Attributes:
        terms: one factor per term of eq. (11).
        xy_weight: factor of the joint evidence across the view; along depth it is 1.
    """

    terms: Weights
    xy_weight: float


def base_weights(config: FitConfig, n_frames: int) -> Weights:
    """Return weights of a problem of `n_frames` frames, before a stage's own factors.

    The search for directions uses these in every case: its odds were calibrated with them.

    Args:
        config: options of the fit.
        n_frames: number of the problem's frames.
    """
    weights = config.weights
    changed = {}
    if config.motion_shared:
        changed["motion"] = weights.motion / n_frames
    if n_frames > 1:
        changed["height"] = config.multi_frame.height * weights.height
    return weights.model_copy(update=changed)


def stage_weights(config: FitConfig, n_frames: int, kind: StageKind) -> StageWeights:
    """Return weights of every term in one kind of stage.

    Args:
        config: options of the fit.
        n_frames: number of the problem's frames.
        kind: kind of stage.
    """
    weights = base_weights(config, n_frames)
    if kind == "warm-up":
        changed = {"image": 0.0, "matte": 0.0, "texture": 0.0, "background": 0.0, "adversarial": 0.0}
        changed |= {"joints": WARM_UP_JOINTS, "path": WARM_UP_PATH}
        changed |= {name: getattr(weights, name) / divisor for name, divisor in WARM_UP_DIVISORS.items()}
        return StageWeights(weights.model_copy(update=changed), 1.0)
    if kind == "full" and n_frames > 1:
        weights = weights.model_copy(update={"image": config.multi_frame.image * weights.image})
    return StageWeights(weights, config.xy_weight)


def weights_table() -> str:
    """Return every weight of both presets, per kind of stage and number of frames, as a Markdown table."""
    columns: list[tuple[Literal["paper", "best"], StageKind, int]] = [
        ("paper", "full", 1),
        ("paper", "full", 2),
        *(("best", kind, n_frames) for kind in get_args(StageKind) for n_frames in (1, 2)),
    ]
    of_columns = [stage_weights(preset(name).fit, n_frames, kind) for name, kind, n_frames in columns]
    heads = [f"{name}, {kind}, {'one frame' if n_frames == 1 else 'two frames'}" for name, kind, n_frames in columns]
    rows = [["term", "meaning", *heads], ["---"] * 2 + ["---:"] * len(heads)]
    for name, field in Weights.model_fields.items():
        rows.append([f"`{name}`", field.description or "", *(f"{getattr(one.terms, name):g}" for one in of_columns)])
    rows.append(["`xy_weight`", "factor of `joints` across the view", *(f"{one.xy_weight:g}" for one in of_columns)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


if __name__ == "__main__":
    print(weights_table(), end="")
