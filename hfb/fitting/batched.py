"""Warm-up and image stages of many fits at once on a device; see `hfb.fitting.warmup` and `hfb.fitting.stages`.

Fits do not influence each other: in batches of one size (`pad_batch`) a fit has the same bits whatever the others are.
"""

import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch

from hfb.config import FitConfig, Stage
from hfb.fitting.batched_objective import BatchedObjective, BatchedVariables
from hfb.fitting.refine import InitialEvidence, refine_stage_inputs
from hfb.fitting.stage_clock import StageClock
from hfb.fitting.stages import MIN_GAIN, StagesResult, image_stages, is_full_size, stage_objective
from hfb.fitting.variables import Variables, cosine_decay
from hfb.fitting.warmup import warmup_objective, warmup_rate
from hfb.objective.objective import Objective
from hfb.rendering.warp import WarpRasterizer
from hfb.typing import Float, Int, Tensor

R = TypeVar("R")
_PROGRESS_EVERY = 5
"""Iterations between two reads of the loss: each makes the processor wait for the device."""


@contextmanager
def ignore_graph_warning() -> Iterator[None]:
    """Ignore torch's warning that gradients of CUDA graphs come from another stream."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The AccumulateGrad node's stream does not match")
        yield


def map_threads(function: Callable[..., R], *arguments: Sequence[Any]) -> list[R]:
    """Map a function over fits in threads, for the steps that run on the CPU alone.

    Args:
        function: takes the arguments of one fit.
        *arguments: a sequence with an entry per fit, for each parameter.
    """
    with ThreadPoolExecutor(min(len(arguments[0]), os.cpu_count() or 1)) as pool:
        return list(pool.map(function, *arguments))


def pad_batch(fits: Sequence[R], batch_size: int) -> list[R]:
    """Pad a batch with its first fit up to `batch_size`.

    The size decides which kernel computes a matrix product, and so the order of its sums.

    Args:
        fits: at most `batch_size`.
        batch_size: batch size of the result.
    """
    return [*fits, *[fits[0]] * (batch_size - len(fits))]


@dataclass(frozen=True)
class Batch:
    """Fits that are optimised together.

    Attributes:
        variables: variables of every fit, changed in place.
        initial: predictions of every fit from before the first stage.
        objectives: objectives of every fit, with these predictions, in the CPU's memory.
        config: options of all fits.
        rasterizer: renders all fits.
        size: the batch is padded to this size.
    """

    variables: Sequence[Variables]
    initial: Sequence[InitialEvidence]
    objectives: Sequence[Objective]
    config: FitConfig
    rasterizer: WarpRasterizer
    size: int

    def stack(self) -> BatchedVariables:
        """Return the variables on the device, padded."""
        return BatchedVariables.stack(pad_batch(self.variables, self.size), self.rasterizer.device)

    def objective(self, objectives: Sequence[Objective], renders: bool = True) -> BatchedObjective:
        """Return some objectives of these fits as one, padded.

        Args:
            objectives: one per fit.
            renders: terms of images will be needed.
        """
        padded = pad_batch(objectives, self.size), pad_batch(self.variables, self.size)
        return BatchedObjective(*padded, self.rasterizer, renders)


def fit_skeletons(batch: Batch) -> None:
    """Fit all skeletons at once; see `hfb.fitting.warmup.fit_skeleton`.

    Args:
        batch: its variables are changed in place.
    """
    config, stacked = batch.config, batch.stack()
    group = batch.objective([warmup_objective(one, config) for one in batch.objectives], renders=False)
    moving = stacked.rotation, stacked.translation, stacked.betas
    optimizer = torch.optim.Adam(moving, eps=config.adam_epsilon, fused=True)
    for iteration in range(config.settle):
        optimizer.param_groups[0]["lr"] = warmup_rate(iteration, config)
        optimizer.zero_grad()
        group.template.total(group.body_terms(stacked)).sum().backward()
        optimizer.step()
        stacked.project_(group.template.body)
    stacked.copy_into(batch.variables)


def run_batched_stages(batch: Batch, clock: StageClock, count: int | None = None) -> list[StagesResult]:
    """Run every stage of all fits at once; see `hfb.fitting.stages.run_stages`.

    Args:
        batch: its variables are changed in place.
        clock: times and reports the stages.
        count: number of stages to run; all when not given.

    Raises:
        FloatingPointError: the loss of a fit is not finite.
    """
    config, variables, objectives = batch.config, batch.variables, list(batch.objectives)
    stacked, staged = batch.stack(), objectives
    optimizer = torch.optim.Adam(stacked.groups(config, 0.0), eps=config.adam_epsilon, fused=True)
    histories: list[dict[str, list[float]]] = [{} for _ in variables]
    best_iterations, first_bests, offsets = ([0] * len(variables) for _ in range(3))
    for number, stage in enumerate(image_stages(config)[:count], 1):
        if number > 1:
            with clock.stage(f"refine_{number}"):
                full_size = is_full_size(stage, config)

                def refine(
                    initial: InitialEvidence, objective: Objective, mine: Variables, full_size: bool = full_size
                ) -> Objective:
                    return refine_stage_inputs(initial, objective, mine, config, full_size=full_size)

                objectives = map_threads(refine, batch.initial, objectives, variables)
        with clock.stage(f"stage_{number}"):
            staged = [
                stage_objective(one, mine, config, stage) for one, mine in zip(objectives, variables, strict=True)
            ]
            kept = _run_stage(batch.objective(staged), stacked, optimizer, config, stage, clock)
            for place, (history, length) in enumerate(zip(histories, kept.lengths, strict=False)):
                values = kept.values[:length, :, place].T.tolist()
                for name, row in zip((*kept.names, "total"), values, strict=True):
                    history.setdefault(name, []).extend(row)
                best_iterations[place] = offsets[place] + int(kept.iteration[place])
                offsets[place] += length
            first_bests = list(best_iterations) if number == 1 else first_bests
            kept.variables.copy_rows(torch.ones_like(kept.loss, dtype=torch.bool), stacked)
            stacked.copy_into(variables)
    return [
        StagesResult(mine.copy(), best, first, history, objective, one.observation)
        for mine, best, first, history, objective, one in zip(
            variables, best_iterations, first_bests, histories, staged, objectives, strict=True
        )
    ]


@dataclass
class _BestIterates:
    """Best iterates of a stage, on the device, and the losses of all iterations.

    Attributes:
        loss: loss of every fit's best iterate.
        iteration: iteration of every fit's best iterate, counted from the stage's first.
        values: terms of every iteration in the order of `names`, the weighted sum last.
        lengths: number of iterations of every fit.
    """

    variables: BatchedVariables
    loss: Float[Tensor, "N"]
    iteration: Int[Tensor, "N"]
    names: tuple[str, ...]
    values: Float[Tensor, "i terms N"]
    lengths: list[int]


def _run_stage(
    group: BatchedObjective,
    variables: BatchedVariables,
    optimizer: torch.optim.Adam,
    config: FitConfig,
    stage: Stage,
    clock: StageClock,
) -> _BestIterates:
    """Run Adam on all fits; a fit whose patience is exhausted keeps its best iterate."""
    best, rows = variables.copy(), []
    names: tuple[str, ...] = ()
    best_loss = gain_loss = torch.full_like(variables.betas[:, 0].detach(), math.inf)
    best_at, waited, lengths = (torch.zeros_like(best_loss, dtype=torch.long) for _ in range(3))
    reported = 0
    for iteration in range(stage.iterations):
        decay = cosine_decay(iteration, stage.iterations) if stage.cosine else 1.0
        groups = variables.groups(config, stage.learning_rate * decay)
        for one, now in zip(optimizer.param_groups, groups, strict=True):
            one["lr"] = now["lr"]
        optimizer.zero_grad()
        terms = group.terms(variables)
        names, losses = tuple(terms), group.template.total(terms)
        with torch.no_grad():
            rows.append(torch.stack([*terms.values(), losses]).detach())
            goes_on = waited < config.patience if config.patience > 0 else torch.ones_like(waited, dtype=torch.bool)
            lengths += goes_on
            better = goes_on & (losses < best_loss)
            variables.copy_rows(better, best)
            best_loss, best_at = torch.where(better, losses, best_loss), torch.where(better, iteration, best_at)
            gains = losses < (1 - MIN_GAIN) * gain_loss
            gain_loss, waited = torch.where(gains, losses, gain_loss), torch.where(gains & goes_on, 0, waited + 1)
        if iteration % _PROGRESS_EVERY == 0 or iteration == stage.iterations - 1:
            clock.advance(iteration + 1 - reported, losses.detach().mean().item())
            reported = iteration + 1
            if config.patience > 0 and not bool((waited < config.patience).any()):
                break
        losses.sum().backward()
        optimizer.step()
        variables.project_(group.template.body)
    clock.skip(stage.iterations - reported)
    values = torch.stack(rows).cpu()
    _check_finite(values, names)
    return _BestIterates(best, best_loss, best_at.cpu(), names, values, lengths.tolist())


def _check_finite(values: Float[Tensor, "i terms N"], names: tuple[str, ...]) -> None:
    broken = (~values.isfinite()).nonzero()
    if len(broken):
        iteration, _, fit = broken[0].tolist()
        bad = [name for name, value in zip(names, values[iteration, :-1, fit], strict=True) if not value.isfinite()]
        raise FloatingPointError(f"the loss is not a number any more at iteration {iteration}: {bad}")
