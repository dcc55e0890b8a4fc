"""The image stages of the schedule: Adam at rising image sizes, with refined evidence between them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from hfb.body.model import Body
from hfb.config import FitConfig, Stage
from hfb.fitting.refine import InitialEvidence, refine_stage_inputs
from hfb.fitting.stage_clock import StageClock
from hfb.fitting.variables import Variables, cosine_decay, learning_rates
from hfb.kernels.adam import Adam
from hfb.objective.objective import Objective
from hfb.objective.weights import StageKind, stage_weights
from hfb.rendering.observation import Observation
from hfb.rendering.texels import visible_texels
from hfb.typing import Bool, Tensor

MIN_GAIN = 1e-3
"""Relative decrease of a stage's loss that counts as a gain."""

_FEWEST_SUBFRAMES = 4
"""As many as a motion of the third degree has coefficients."""


@dataclass(frozen=True)
class StagesResult:
    """Best iterate of the last stage, and the objective it was measured by.

    Attributes:
        best: variables of the best iterate.
        best_iteration: counted through all stages.
        first_best: best iteration of the first stage.
        history: one value per iteration of every term and the weighted `total`.
        objective: at the last stage's size.
        observation: the last stage's observation at full size, with the mattes that it used.
    """

    best: Variables
    best_iteration: int
    first_best: int
    history: dict[str, list[float]]
    objective: Objective
    observation: Observation


def run_stages(
    variables: Variables,
    initial: InitialEvidence,
    objective: Objective,
    config: FitConfig,
    clock: StageClock,
    count: int | None = None,
) -> StagesResult:
    """Run every stage from the best iterate of the last one, refining the evidence in between.

    Args:
        variables: start values; changed in place.
        initial: predictions from before the first stage.
        objective: at full size, with these predictions.
        config: options of the fit.
        clock: times the stages `stage_1`, `refine_2`, `stage_2` ...
        count: number of stages to run; all when not given.

    Raises:
        FloatingPointError: the loss is not finite; the message names the terms.
    """
    history: dict[str, list[float]] = {}
    best, best_iteration, first_best, done, staged = variables.copy(), 0, 0, 0, objective
    # One optimiser for all stages: the first steps of a fresh one, without gradient statistics, undo progress.
    optimizer = Adam(variables.leaves(), config.adam_epsilon)
    for number, stage in enumerate(image_stages(config)[:count], 1):
        if number > 1:
            with clock.stage(f"refine_{number}"):
                full_size = is_full_size(stage, config)
                objective = refine_stage_inputs(initial, objective, variables, config, full_size=full_size)
        with clock.stage(f"stage_{number}"):
            staged = stage_objective(objective, variables, config, stage)
            best_loss = gain_loss = math.inf  # losses of different image sizes do not compare
            waited, left = 0, stage.iterations
            for loss, terms in _iterations(staged, variables, optimizer, config, stage):
                for name, value in {"total": loss, **terms}.items():
                    history.setdefault(name, []).append(value)
                if loss < best_loss:
                    best.copy_from_(variables)
                    best_loss, best_iteration = loss, done
                done, left = done + 1, left - 1
                clock.advance(1, loss)
                gain_loss, waited = (loss, 0) if loss < (1 - MIN_GAIN) * gain_loss else (gain_loss, waited + 1)
                if 0 < config.patience <= waited:
                    clock.skip(left)
                    break
            variables.copy_from_(best)
        first_best = best_iteration if number == 1 else first_best
    return StagesResult(best, best_iteration, first_best, history, staged, objective.observation)


def for_frames(config: FitConfig, frames: int) -> FitConfig:
    """Return the options with the stages of so many frames, see `hfb.config.MultiFrame`.

    Args:
        config: options of the fit.
        frames: number of frames that are fitted together.
    """
    several = config.multi_frame

    def scaled(stage: Stage) -> Stage:
        iterations, rate = round(several.iterations * stage.iterations), several.learning_rate * stage.learning_rate
        return stage.model_copy(update={"iterations": iterations, "learning_rate": rate})

    return config if frames == 1 else config.model_copy(update={"stages": tuple(map(scaled, config.stages))})


def image_stages(config: FitConfig) -> list[Stage]:
    """Return the stages that have iterations.

    Args:
        config: options of the fit.
    """
    return [stage for stage in config.stages if stage.iterations > 0]


def is_full_size(stage: Stage, config: FitConfig) -> bool:
    """Return whether a stage has the last one's image size.

    Args:
        stage: a stage of the schedule.
        config: options of the fit.
    """
    return stage.size_px == image_stages(config)[-1].size_px


def stage_objective(objective: Objective, variables: Variables, config: FitConfig, stage: Stage) -> Objective:
    """Return the objective at a stage's image size, with its weights and the texels that are visible at its beginning.

    Args:
        objective: at full size.
        variables: the fit, for the visible texels.
        config: options of the fit.
        stage: a stage of the schedule.
    """
    seen = objective.observation.resized(stage.size_px)
    kind: StageKind = "full" if is_full_size(stage, config) else "coarse"
    visible = _find_visible(variables, seen, objective.body, config) if objective.texels else None
    staged = objective.for_stage(seen, stage_weights(config, len(seen.mattes), kind), visible)
    return replace(staged, subframes=subframes_at(stage.size_px, config))


def subframes_at(size_px: int, config: FitConfig) -> int:
    """Return how many sub-frames to render at an image size: as dense in pixels as at the last stage's, at least four.

    Args:
        size_px: longer side of the region of interest [px].
        config: options of the fit.
    """
    share = size_px / image_stages(config)[-1].size_px
    return min(max(_FEWEST_SUBFRAMES, math.ceil(config.subframes * share)), config.subframes)


def _find_visible(variables: Variables, seen: Observation, body: Body, config: FitConfig) -> Bool[Tensor, "A A"]:
    """Return the visible texels; they change too slowly to be updated in every iteration."""
    vertices = variables.vertices(body, config.subframes).flatten(0, 1)
    return visible_texels(vertices, seen.camera, body.mesh, config.texture_px)


def _iterations(
    objective: Objective, variables: Variables, optimizer: Adam, config: FitConfig, stage: Stage
) -> Iterator[tuple[float, dict[str, float]]]:
    """Run Adam; yield the loss and its terms before each step."""
    for iteration in range(stage.iterations):
        decay = cosine_decay(iteration, stage.iterations) if stage.cosine else 1.0
        terms = objective.terms(variables.motion(objective.body), variables.betas, variables.texture)
        values = {name: value.item() for name, value in terms.items()}
        loss = objective.total_of_values(values)
        if not math.isfinite(loss):
            broken = [name for name, value in values.items() if not math.isfinite(value)]
            raise FloatingPointError(f"the loss is not a number any more at iteration {iteration}: {broken}")
        yield loss, values
        objective.backward(terms)
        optimizer.step(learning_rates(config, stage.learning_rate * decay))
        variables.project_(objective.body)
