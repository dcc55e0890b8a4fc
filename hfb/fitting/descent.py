"""The stages of a schedule: Adam, keeping the best iterate."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from hfb.body.model import Body
from hfb.config import FitConfig, Stage
from hfb.fitting.comparison import Before, beside_the_fit, drawn, matted_again
from hfb.fitting.variables import Variables, falling, rates
from hfb.kernels.adam import Adam
from hfb.objective.objective import Objective
from hfb.rendering.observation import Observation
from hfb.rendering.texels import visible_texels
from hfb.typing import Bool, Tensor

GAIN = 1e-3
"""Share by which the loss of a stage must fall to count as a gain."""

Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Descent:
    """Where the stages led: the best iterate of the last one, and what it was measured by.

    Attributes:
        objective: at the last stage's size. seen: the same observation at its full size.
    """

    best: Variables
    best_iteration: int
    history: dict[str, list[float]]
    objective: Objective
    seen: Observation


def descend(variables: Variables, everywhere: Objective, config: FitConfig, on_progress: Progress | None) -> Descent:
    """Every stage in turn, each from the best iterate of the one before; changes the variables in place."""
    stages = [stage for stage in config.stages if stage.iterations > 0]
    total = sum(stage.iterations for stage in stages)
    history: dict[str, list[float]] = {}
    best, best_iteration, done, skipped, objective = variables.copy(), 0, 0, 0, everywhere
    # One for all stages: a fresh one knows no gradient's size, its first steps undo what the stage before has found.
    optimizer = Adam(variables.leaves(), config.adam_epsilon)
    before = Before(everywhere.observation, everywhere.evidence)
    for number, stage in enumerate(stages):
        if number > 0:
            everywhere = looked_again(before, everywhere, variables, config, of_full_size(stage, config))
        seen = everywhere.observation.resized(stage.size_px)
        visible = visible_at(variables, seen, everywhere.body, config) if everywhere.texels else None
        objective = everywhere.of_stage(seen, visible, picture_factor(everywhere, config, stage))
        best_loss = told_loss = math.inf  # losses of different picture sizes do not compare
        waited, ends = 0, done + stage.iterations
        for loss, terms in _iterations(objective, variables, optimizer, config, stage):
            for name, value in {"total": loss, **terms}.items():
                history.setdefault(name, []).append(value)
            if loss < best_loss:
                best.take(variables)
                best_loss, best_iteration = loss, done
            done += 1
            if on_progress:
                on_progress(done + skipped, total, loss)
            told_loss, waited = (loss, 0) if loss < (1 - GAIN) * told_loss else (told_loss, waited + 1)
            if 0 < config.patience <= waited:
                skipped += ends - done
                break
        variables.take(best)
    return Descent(best, best_iteration, history, objective, everywhere.observation)


def looked_again(
    before: Before, everywhere: Objective, variables: Variables, config: FitConfig, full: bool
) -> Objective:
    """What the networks say after a stage: the lifting network sees more of the joints then, and before every stage of
    full size the fit's own picture is worth a look, for the mattes and for the joints.

    Args:
        everywhere: with what they said last.
    """
    evidence, seen = before.evidence, everywhere.observation
    if evidence is not None and config.lifting > 0:
        evidence = evidence.lifted(variables.joints_at_middle(everywhere.body), config.lifting)
    if not full or (config.compare == 0 and not config.matte_again):
        return replace(everywhere, evidence=evidence)
    blurred = drawn(variables, seen.camera, everywhere.body, everywhere.rasterizer, everywhere.subframes)
    if before.evidence is not None and evidence is not None and config.compare > 0:
        evidence = beside_the_fit(evidence, before.evidence, variables, everywhere, blurred, config)
    if config.matte_again:
        seen = matted_again(blurred, before)
    return replace(everywhere, evidence=evidence, observation=seen)


def picture_factor(objective: Objective, config: FitConfig, stage: Stage) -> float:
    """Of w_I in a stage: see `SeveralFrames`."""
    several = len(objective.observation.mattes) > 1
    return config.several.image if several and of_full_size(stage, config) else 1.0


def of_full_size(stage: Stage, config: FitConfig) -> bool:
    """Whether a stage has the last one's size."""
    return stage.size_px == [one for one in config.stages if one.iterations > 0][-1].size_px


def _iterations(
    objective: Objective, variables: Variables, optimizer: Adam, config: FitConfig, stage: Stage
) -> Iterator[tuple[float, dict[str, float]]]:
    """One stage of Adam; yields the loss and its terms before the step away from where they were found."""
    for iteration in range(stage.iterations):
        share = falling(iteration, stage.iterations) if stage.cosine else 1.0
        terms = objective.terms(variables.motion(objective.body), variables.betas, variables.texture)
        values = {name: value.item() for name, value in terms.items()}
        loss = objective.weighed(values)
        if not math.isfinite(loss):
            broken = [name for name, value in values.items() if not math.isfinite(value)]
            raise FloatingPointError(f"the loss is not a number any more at iteration {iteration}: {broken}")
        yield loss, values
        objective.pull(terms)
        optimizer.step(rates(config, stage.learning_rate * share))
        variables.keep_within(config, objective.body)


def visible_at(variables: Variables, seen: Observation, body: Body, config: FitConfig) -> Bool[Tensor, "A A"]:
    """Texels the camera sees when a stage begins: visibility changes too slowly to be worth every iteration."""
    vertices = variables.vertices(body, config.subframes).flatten(0, 1)
    return visible_texels(vertices, seen.camera, body.mesh, config.texture_px)
