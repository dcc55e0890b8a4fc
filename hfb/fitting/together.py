"""Many fits as one problem, for a device that a single fit leaves idle.

Everything has one more dimension in front, the fits. `torch.func.vmap` gives the terms, written for one fit, all of
them at once; what is drawn is drawn together. No fit knows of the others: in a room of one size (`filled`) it finds the
same bits whoever is beside it.
"""

import gc
import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import torch
from torch.func import vmap

from hfb.body.height import as_tall
from hfb.config import FitConfig, Stage
from hfb.fitting.comparison import Before
from hfb.fitting.descent import GAIN, Descent, Progress, looked_again, of_full_size, picture_factor, visible_at
from hfb.fitting.settle import settling, settling_rate
from hfb.fitting.variables import Variables, falling, rates
from hfb.kernels.dispatch import readable_formulas
from hfb.motion.trajectory import Trajectory
from hfb.objective.objective import Objective, mean_of_frames
from hfb.objective.regularizers import background_loss
from hfb.rendering.warp import WarpRasterizer
from hfb.typing import Bool, Float, Int, Tensor

R = TypeVar("R")
_EVIDENCE = ("lenses", "middle", "scale", "path", "log_height", "height_scale")
_PICTURES = ("plate_linear", "frames_linear", "mattes")
_PROGRESS_EVERY = 5
"""Iterations between two looks at the loss: each makes the processor wait for the device."""


@dataclass(frozen=True)
class Leaves:
    """The free parameters of N fits on a device, as in `Variables`."""

    rotation: Float[Tensor, "N T D1 24 4"]
    translation: Float[Tensor, "N T D1 4"]
    betas: Float[Tensor, "N 10"]
    texture: Float[Tensor, "N A A 3"]

    @staticmethod
    def of(variables: Sequence[Variables], device: torch.device) -> "Leaves":
        """Copies that an optimiser may change; known shapes and textures get no gradient."""

        def leaf(tensors: list[Tensor]) -> Tensor:
            stacked = torch.stack([one.detach() for one in tensors]).to(device)
            return stacked.requires_grad_(tensors[0].requires_grad)

        return Leaves(
            leaf([one.trajectory.rotation for one in variables]),
            leaf([one.trajectory.translation for one in variables]),
            leaf([one.betas for one in variables]),
            leaf([one.texture for one in variables]),
        )

    def into(self, variables: Sequence[Variables]) -> None:
        """Write every fit's own into its variables; what only filled the room is left."""
        with torch.no_grad():
            parts = (one.cpu() for one in (self.rotation, self.translation, self.betas, self.texture))
            for one, *found in zip(variables, *parts, strict=False):
                places = one.trajectory.rotation, one.trajectory.translation, one.betas, one.texture
                for place, value in zip(places, found, strict=True):
                    place.copy_(value)

    def groups(self, config: FitConfig, rate: float) -> list[dict]:
        """Adam's parameter groups with their learning rates, where motion has this one."""
        leaves = self.rotation, self.translation, self.betas, self.texture
        return [{"params": [leaf], "lr": one} for leaf, one in zip(leaves, rates(config, rate), strict=True)]

    def copy_where(self, better: Bool[Tensor, "N"], into: "Leaves") -> None:
        """Copy the fits that are marked."""
        with torch.no_grad():
            for part in fields(self):
                now, kept = getattr(self, part.name), getattr(into, part.name)
                kept.copy_(torch.where(better.view(-1, *(1,) * (now.ndim - 1)), now, kept))

    def copy(self) -> "Leaves":
        """A snapshot without gradients."""
        return Leaves(*(getattr(self, one.name).detach().clone() for one in fields(self)))


class _Graphed:
    """A function of tensors to a tuple of tensors; on a GPU its launches, there and back, are recorded and replayed.

    Hundreds of small launches take the processor longer than the device. Results are overwritten by the next call.
    """

    def __init__(self, function: Callable[..., tuple[Tensor, ...]], records: bool = True) -> None:
        self._function: Callable[..., Any] = function
        self._records = records

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        if inputs[0].is_cuda and self._records:
            samples = tuple(one.detach().clone().requires_grad_(one.requires_grad) for one in inputs)
            with _nothing_thrown_away():
                self._function = torch.cuda.make_graphed_callables(self._function, samples, allow_unused_input=True)
            self._records = False
        return self._function(*inputs)


@contextmanager
def _nothing_thrown_away() -> Iterator[None]:
    """An earlier record that is thrown away while another is made breaks it."""
    collects = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


class Together:
    """Objectives of one kind as one: same options, number of frames, timing and picture size.

    Args:
        objectives: of all fits, in the processor's memory. variables: theirs, for what a fit does not change of them.
        draws: whether pictures will be asked for.
    """

    def __init__(
        self,
        objectives: Sequence[Objective],
        variables: Sequence[Variables],
        rasterizer: WarpRasterizer,
        draws: bool = True,
    ) -> None:
        first, device, self._rasterizer = objectives[0], rasterizer.device, rasterizer

        def stacked(parts: Sequence[Tensor]) -> Tensor:
            return torch.stack([one.detach() for one in parts]).to(device)

        self.template = replace(
            first, body=first.body.on(device), first=first.first.to(device), texels=None, visible=None
        )
        self._like = variables[0].trajectory
        self._known = {
            "first": stacked([one.first for one in objectives]),
            "anchor": stacked([one.trajectory.anchor for one in variables]),
        }
        references = [one.reference for one in variables if one.reference is not None]
        if references:
            self._known["reference"] = stacked(references)
        claims = [one.evidence for one in objectives if one.evidence is not None]
        self._known |= {name: stacked([getattr(one, name) for one in claims]) for name in _EVIDENCE if claims}
        if draws:
            self._seen = {name: stacked([getattr(one.observation, name) for one in objectives]) for name in _PICTURES}
            self._cameras = [one.observation.camera for one in objectives for _ in one.first]
        self._surfaces = [(one.texels, one.visible) for one in objectives]
        self._names: dict[str, list[str]] = {}
        records = first.weights.adversarial == 0  # that prior's networks have not been seen to be recordable
        self._bodies, self._skeletons = _Graphed(self._all_bodies, records), _Graphed(self._all_skeletons, records)
        self._comparison = _Graphed(self._all_compared)

    def terms(self, leaves: Leaves) -> dict[str, Float[Tensor, "N"]]:
        """The unweighted terms of every fit, as `Objective.terms`."""
        with readable_formulas():
            vertices, *of_bodies = self._bodies(leaves.rotation, leaves.translation, leaves.betas)
            of_pictures = self._comparison(self._drawn(vertices, leaves.texture))
            told = dict(zip(self._names["pictures"], of_pictures, strict=True)) | self._surface_terms(leaves.texture)
            return told | dict(zip(self._names["bodies"], of_bodies, strict=True))

    def body_terms(self, leaves: Leaves) -> dict[str, Float[Tensor, "N"]]:
        """Those that no picture is drawn for, as `Objective.body_terms`."""
        with readable_formulas():
            values = self._skeletons(leaves.rotation, leaves.translation, leaves.betas)
            return dict(zip(self._names["bodies"], values, strict=True))

    def _all_bodies(self, *moving: Tensor) -> tuple[Tensor, ...]:
        """Vertices (N, T, S, V, 3) of all fits, and the terms of body and motion."""

        def one(known: dict[str, Tensor], *moving: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
            objective, motion = self._one(known, *moving)
            return objective.vertices_and_terms(motion, moving[2])

        vertices, terms = vmap(one)(self._known, *moving)
        self._names["bodies"] = list(terms)
        return vertices, *terms.values()

    def _all_skeletons(self, *moving: Tensor) -> tuple[Tensor, ...]:
        def one(known: dict[str, Tensor], *moving: Tensor) -> dict[str, Tensor]:
            objective, motion = self._one(known, *moving)
            return objective.body_terms(motion, moving[2], objective.body.shape(moving[2]))

        terms = vmap(one)(self._known, *moving)
        self._names["bodies"] = list(terms)
        return tuple(terms.values())

    def _one(
        self, known: dict[str, Tensor], rotation: Tensor, translation: Tensor, betas: Tensor
    ) -> tuple[Objective, Trajectory]:
        """One fit's objective and its motion in metres; inside `vmap`."""
        objective = replace(self.template, first=known["first"])
        if objective.evidence is not None:
            told: dict[str, Any] = {name: known[name] for name in _EVIDENCE}
            objective = replace(objective, evidence=replace(objective.evidence, **told))
        trajectory = replace(self._like, rotation=rotation, translation=translation, anchor=known["anchor"])
        variables = Variables(trajectory, betas, betas.new_empty(0, 0, 3), known.get("reference"))
        return objective, variables.motion(objective.body)

    def _drawn(
        self, vertices: Float[Tensor, "N T S V 3"], texture: Float[Tensor, "N A A 3"]
    ) -> Float[Tensor, "N T n H W 4"]:
        """Every frame's mean picture, or all of its sub-frames' where the background term needs them."""
        weights, (fits, frames, subframes) = self.template.weights, vertices.shape[:3]
        cameras, bodies = self._cameras, vertices.flatten(0, 1)
        if weights.background > 0:
            cameras, bodies = [one for one in cameras for _ in range(subframes)], vertices.flatten(0, 2)[:, None]
        coloured = texture if weights.image + weights.background > 0 else None
        drawn = self._rasterizer.render_pictures(bodies, coloured, cameras, self.template.body.mesh)
        return drawn.unflatten(0, (fits, frames, -1))

    def _all_compared(self, drawn: Float[Tensor, "N T n H W 4"]) -> tuple[Tensor, ...]:
        def one(drawn: Float[Tensor, "T n H W 4"], seen: dict[str, Tensor]) -> dict[str, Tensor]:
            shown: dict[str, Any] = {**seen}
            here, per_frame = replace(self.template, observation=replace(self.template.observation, **shown)), []
            for frame, pictures in enumerate(drawn.unbind()):
                terms = {}
                if self.template.weights.background > 0:
                    terms["background"] = background_loss(seen["plate_linear"], pictures)
                per_frame.append(terms | here.compared(frame, pictures.mean(0)))
            return mean_of_frames(per_frame)

        terms = vmap(one)(drawn, self._seen)
        self._names["pictures"] = list(terms)
        return tuple(terms.values())

    def _surface_terms(self, texture: Float[Tensor, "N A A 3"]) -> dict[str, Float[Tensor, "N"]]:
        """Those of the texture: a fit at a time, on the processor; `best` has none."""
        if self.template.weights.texture <= 0 or self._surfaces[0][0] is None:
            return {}
        each = [
            replace(self.template, texels=texels, visible=visible).surface_terms(one)["texture"]
            for one, (texels, visible) in zip(texture.cpu(), self._surfaces, strict=True)
        ]
        return {"texture": torch.stack(each).to(texture.device)}


@dataclass
class _Kept:
    """The best iterates of a stage, on the device, and what was measured on the way there.

    Attributes:
        loss, iteration: of the best iterate of every fit, the latter counted from the stage's first.
        values: of every iteration, the terms' values in the order of `names`, the weighted sum last.
        length: how many iterations each fit took part in.
    """

    leaves: Leaves
    loss: Float[Tensor, "N"]
    iteration: Int[Tensor, "N"]
    names: tuple[str, ...]
    values: Float[Tensor, "i terms N"]
    length: list[int]


@contextmanager
def without_the_warning_of_records() -> Iterator[None]:
    """torch says of recorded launches that their gradients come from another stream, which is how it makes them."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The AccumulateGrad node's stream does not match")
        yield


def each_by_itself(function: Callable[..., R], *arguments: Sequence[Any]) -> list[R]:
    """What only the processor does, of every fit: on all of its cores, since nobody else needs them meanwhile."""
    with ThreadPoolExecutor(min(len(arguments[0]), os.cpu_count() or 1)) as pool:
        return list(pool.map(function, *arguments))


def filled(fits: Sequence[R], room: int) -> list[R]:
    """The fits, and the first of them again where there is room for more.

    Which kernel makes a matrix product, and so the order of its sums, goes by the size: in a room of one size a fit has
    the same bits whoever is beside it.
    """
    return [*fits, *[fits[0]] * (room - len(fits))]


def settle_together(
    variables: Sequence[Variables],
    objectives: Sequence[Objective],
    config: FitConfig,
    rasterizer: WarpRasterizer,
    room: int = 1,
) -> None:
    """As `hfb.fitting.settle.settle`, of all fits at once."""
    leaves = Leaves.of(filled(variables, room), rasterizer.device)
    settled = [settling(one) for one in objectives]
    group = Together(filled(settled, room), filled(variables, room), rasterizer, draws=False)

    moving = leaves.rotation, leaves.translation, leaves.betas
    optimizer = torch.optim.Adam(moving, eps=config.adam_epsilon, fused=True)
    for iteration in range(config.settle):
        optimizer.param_groups[0]["lr"] = settling_rate(iteration, config)
        optimizer.zero_grad()
        group.template.total(group.body_terms(leaves)).sum().backward()
        optimizer.step()
        _keep_within(leaves, group, config)
    leaves.into(variables)


def descend_together(
    variables: Sequence[Variables],
    objectives: Sequence[Objective],
    config: FitConfig,
    rasterizer: WarpRasterizer,
    on_progress: Progress | None,
    room: int = 1,
) -> list[Descent]:
    """As `hfb.fitting.descent.descend`, of all fits at once; changes the variables in place.

    Raises:
        FloatingPointError: the loss of one is no longer a number.
    """
    stages = [stage for stage in config.stages if stage.iterations > 0]
    total, done = sum(stage.iterations for stage in stages), 0
    leaves, everywhere = Leaves.of(filled(variables, room), rasterizer.device), list(objectives)
    optimizer = torch.optim.Adam(leaves.groups(config, 0.0), eps=config.adam_epsilon, fused=True)
    begun = [Before(one.observation, one.evidence) for one in everywhere]
    histories: list[dict[str, list[float]]] = [{} for _ in variables]
    best_iterations, offsets = [0] * len(variables), [0] * len(variables)
    for number, stage in enumerate(stages):
        if number > 0:
            full = of_full_size(stage, config)

            def again(before: Before, now: Objective, mine: Variables, full: bool = full) -> Objective:
                return looked_again(before, now, mine, config, full)

            everywhere = each_by_itself(again, begun, everywhere, variables)
        seen = [one.observation.resized(stage.size_px) for one in everywhere]
        visible = [
            visible_at(mine, there, one.body, config) if one.texels else None
            for one, mine, there in zip(everywhere, variables, seen, strict=True)
        ]
        everywhere_seen = [
            one.of_stage(there, texels, picture_factor(one, config, stage))
            for one, there, texels in zip(everywhere, seen, visible, strict=True)
        ]
        group = Together(filled(everywhere_seen, room), filled(variables, room), rasterizer)

        def tell(iterations: int, loss: float, before: int = done) -> None:
            if on_progress:
                on_progress(before + iterations, total, loss)

        kept = _stage(group, leaves, optimizer, config, stage, tell)
        done += stage.iterations
        for place, (history, iterations) in enumerate(zip(histories, kept.length, strict=False)):
            for name, row in zip((*kept.names, "total"), kept.values[:iterations, :, place].T.tolist(), strict=True):
                history.setdefault(name, []).extend(row)
            best_iterations[place] = offsets[place] + int(kept.iteration[place])
            offsets[place] += iterations
        kept.leaves.copy_where(torch.ones_like(kept.loss, dtype=torch.bool), leaves)
        leaves.into(variables)
        objectives = everywhere_seen
    return [
        Descent(mine.copy(), best, history, objective, one.observation)
        for mine, best, history, objective, one in zip(
            variables, best_iterations, histories, objectives, everywhere, strict=True
        )
    ]


def _stage(
    group: Together,
    leaves: Leaves,
    optimizer: torch.optim.Adam,
    config: FitConfig,
    stage: Stage,
    tell: Callable[[int, float], None],
) -> _Kept:
    """Adam on all fits; a fit whose patience is at an end is kept as it was then."""
    best, rows = leaves.copy(), []
    names: tuple[str, ...] = ()
    best_loss = told = torch.full_like(leaves.betas[:, 0].detach(), math.inf)
    best_at, waited, length = (torch.zeros_like(best_loss, dtype=torch.long) for _ in range(3))
    for iteration in range(stage.iterations):
        share = falling(iteration, stage.iterations) if stage.cosine else 1.0
        for one, now in zip(optimizer.param_groups, leaves.groups(config, stage.learning_rate * share), strict=True):
            one["lr"] = now["lr"]
        optimizer.zero_grad()
        terms = group.terms(leaves)
        names, losses = tuple(terms), group.template.total(terms)
        with torch.no_grad():
            rows.append(torch.stack([*terms.values(), losses]).detach())
            goes_on = waited < config.patience if config.patience > 0 else torch.ones_like(waited, dtype=torch.bool)
            length += goes_on
            better = goes_on & (losses < best_loss)
            leaves.copy_where(better, best)
            best_loss, best_at = torch.where(better, losses, best_loss), torch.where(better, iteration, best_at)
            gains = losses < (1 - GAIN) * told
            told, waited = torch.where(gains, losses, told), torch.where(gains & goes_on, 0, waited + 1)
        if iteration % _PROGRESS_EVERY == 0 or iteration == stage.iterations - 1:
            tell(iteration + 1, losses.detach().mean().item())
            if config.patience > 0 and not bool((waited < config.patience).any()):
                break
        losses.sum().backward()
        optimizer.step()
        _keep_within(leaves, group, config)
    values = torch.stack(rows).cpu()
    _check(values, names)
    return _Kept(best, best_loss, best_at.cpu(), names, values, length.tolist())


def _check(values: Float[Tensor, "i terms N"], names: tuple[str, ...]) -> None:
    broken = (~values.isfinite()).nonzero()
    if len(broken):
        iteration, _, fit = broken[0].tolist()
        bad = [name for name, value in zip(names, values[iteration, :-1, fit], strict=True) if not value.isfinite()]
        raise FloatingPointError(f"the loss is not a number any more at iteration {iteration}: {bad}")


def _keep_within(leaves: Leaves, group: Together, config: FitConfig) -> None:
    """After a step, as `Variables.keep_within`."""
    with torch.no_grad():
        leaves.texture.clamp_(0, 1)
        if config.height_m is not None and leaves.betas.requires_grad:
            leaves.betas.copy_(as_tall(leaves.betas, group.template.body, config.height_m))
