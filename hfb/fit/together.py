"""Many fits as one problem, for a device that a single fit leaves idle.

Everything has one more dimension in front, the fits. `torch.func.vmap` gives the terms, written for one fit, all of
them at once; what is drawn is drawn together. No fit knows of the others: what it finds is what it finds alone, but for
the order of sums in matrix products.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch.func import vmap

from hfb.body.height import as_tall
from hfb.config import FitConfig, Stage
from hfb.fit.descent import GAIN, Descent, Progress, told_after, visible_at
from hfb.fit.settle import settle_by, settling
from hfb.fit.variables import Variables, parameter_groups
from hfb.formulas import readable_formulas
from hfb.losses.regularizers import background_loss
from hfb.motion.trajectory import Trajectory
from hfb.objective import Objective, mean_of_frames
from hfb.render.cuda import WarpRasterizer
from hfb.shapes import Bool, Float, Int, Tensor

_EVIDENCE = ("lenses", "middle", "scale", "path", "log_height", "height_scale")
_PROGRESS_EVERY = 5
"""Iterations between two looks at the loss: each makes the processor wait for the device."""


@dataclass(frozen=True)
class Leaves:
    """The free parameters of N fits on a device, as in `Variables`, and what their trajectories hold fixed."""

    rotation: Float[Tensor, "N T D1 24 4"]
    translation: Float[Tensor, "N T D1 4"]
    betas: Float[Tensor, "N 10"]
    texture: Float[Tensor, "N A A 3"]
    anchor: Float[Tensor, "N T 3"]
    reference: Float[Tensor, "N 10"] | None

    @staticmethod
    def of(variables: Sequence[Variables], device: torch.device) -> "Leaves":
        """Copies that an optimiser may change; known shapes and textures get no gradient."""

        def leaf(tensors: list[Tensor]) -> Tensor:
            stacked = torch.stack([one.detach() for one in tensors]).to(device)
            return stacked.requires_grad_(tensors[0].requires_grad)

        references = [one.reference for one in variables if one.reference is not None]
        return Leaves(
            leaf([one.trajectory.rotation for one in variables]),
            leaf([one.trajectory.translation for one in variables]),
            leaf([one.betas for one in variables]),
            leaf([one.texture for one in variables]),
            leaf([one.trajectory.anchor for one in variables]),
            leaf(references) if references else None,
        )

    def into(self, variables: Sequence[Variables]) -> None:
        """Write every fit's own into its variables."""
        with torch.no_grad():
            parts = (one.cpu() for one in (self.rotation, self.translation, self.betas, self.texture))
            for one, *found in zip(variables, *parts, strict=True):
                places = one.trajectory.rotation, one.trajectory.translation, one.betas, one.texture
                for place, value in zip(places, found, strict=True):
                    place.copy_(value)

    def groups(self, config: FitConfig, rate: float) -> list[dict]:
        """Adam's parameter groups."""
        return parameter_groups([self.rotation, self.translation], self.betas, self.texture, config, rate)

    def copy_where(self, better: Bool[Tensor, "N"], into: "Leaves") -> None:
        """Copy the fits that are marked."""
        with torch.no_grad():
            for part in ("rotation", "translation", "betas", "texture"):
                now, kept = getattr(self, part), getattr(into, part)
                kept.copy_(torch.where(better.view(-1, *(1,) * (now.ndim - 1)), now, kept))

    def copy(self) -> "Leaves":
        """A snapshot without gradients."""
        held = {one.name: getattr(self, one.name) for one in fields(self)}
        return Leaves(**{name: None if one is None else one.detach().clone() for name, one in held.items()})


class Together:
    """Objectives of one kind as one: same options, number of frames, timing and picture size.

    Args:
        objectives: of all fits, in the processor's memory. like: a fit's variables, for the kind of its trajectory.
        draws: whether pictures will be asked for.
    """

    def __init__(
        self, objectives: Sequence[Objective], like: Trajectory, rasterizer: WarpRasterizer, draws: bool = True
    ) -> None:
        self._rasterizer, self._kind, self._origin = rasterizer, like.kind, like.origin
        first, device = objectives[0], rasterizer.device

        def stacked(part: Callable[[Objective], Tensor]) -> Tensor:
            return torch.stack([part(one) for one in objectives]).to(device)

        self.template = replace(
            first, body=first.body.on(device), first=first.first.to(device), texels=None, visible=None
        )
        self._known: dict[str, Tensor] = {"first": stacked(lambda one: one.first)}
        if first.evidence is not None:
            for name in _EVIDENCE:
                self._known[name] = stacked(lambda one, name=name: getattr(one.evidence, name))  # type: ignore[misc]
        if draws:
            self._pictures = tuple(
                stacked(lambda one, name=name: getattr(one.observation, name))  # type: ignore[misc]
                for name in ("plate_linear", "frames_linear", "mattes")
            )
            self._cameras = [one.observation.camera for one in objectives for _ in one.first]
        self._surfaces = [(one.texels, one.visible) for one in objectives]

    def terms(self, leaves: Leaves) -> dict[str, Float[Tensor, "N"]]:
        """The unweighted terms of every fit, as `Objective.terms`."""
        with readable_formulas():
            vertices, of_body = vmap(self._vertices_and_terms)(*self._inputs(leaves))
            return self._picture_terms(vertices, leaves.texture) | self._surface_terms(leaves.texture) | of_body

    def body_terms(self, leaves: Leaves) -> dict[str, Float[Tensor, "N"]]:
        """Those that no picture is drawn for, as `Objective.body_terms`."""
        with readable_formulas():
            return vmap(self._body_terms)(*self._inputs(leaves))

    def _inputs(self, leaves: Leaves) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        names = ("rotation", "translation", "betas", "anchor") + ("reference",) * (leaves.reference is not None)
        return {name: getattr(leaves, name) for name in names}, self._known

    def _one(self, moving: dict[str, Tensor], known: dict[str, Tensor]) -> tuple[Objective, Trajectory, Tensor]:
        """One fit's objective, its motion in metres and its betas; inside `vmap`."""
        objective, betas = replace(self.template, first=known["first"]), moving["betas"]
        if objective.evidence is not None:
            told: dict[str, Any] = {name: known[name] for name in _EVIDENCE}
            objective = replace(objective, evidence=replace(objective.evidence, **told))
        trajectory = Trajectory(moving["rotation"], moving["translation"], moving["anchor"], self._kind, self._origin)
        nothing = betas.new_empty(0, 0, 3)
        return objective, Variables(trajectory, betas, nothing, moving.get("reference")).motion(objective.body), betas

    def _vertices_and_terms(self, moving: dict[str, Tensor], known: dict[str, Tensor]) -> tuple[Tensor, dict]:
        objective, motion, betas = self._one(moving, known)
        return objective.vertices_and_terms(motion, betas)

    def _body_terms(self, moving: dict[str, Tensor], known: dict[str, Tensor]) -> dict[str, Tensor]:
        objective, motion, betas = self._one(moving, known)
        return objective.body_terms(motion, betas, objective.body.shape(betas))

    def _picture_terms(
        self, vertices: Float[Tensor, "N T S V 3"], texture: Float[Tensor, "N A A 3"]
    ) -> dict[str, Float[Tensor, "N"]]:
        weights, (fits, frames, subframes) = self.template.weights, vertices.shape[:3]
        if weights.background > 0:
            cameras = [camera for camera in self._cameras for _ in range(subframes)]
            bodies = vertices.flatten(0, 2)[:, None]
        else:
            cameras, bodies = self._cameras, vertices.flatten(0, 1)
        coloured = weights.image + weights.background > 0
        drawn = self._rasterizer.render_pictures(
            bodies, texture if coloured else None, cameras, self.template.body.mesh
        )
        pictures = drawn.unflatten(0, (fits, frames, -1))  # in the last place every sub-frame, or their mean

        def compared(
            drawn: Float[Tensor, "T S H W 4"], plate: Float[Tensor, "H W 3"], *seen: Float[Tensor, "T ..."]
        ) -> dict[str, Tensor]:
            here = replace(self.template.observation, plate_linear=plate, frames_linear=seen[0], mattes=seen[1])
            objective, per_frame = replace(self.template, observation=here), []
            for frame, singles in enumerate(drawn.unbind()):
                background = {"background": background_loss(plate, singles)} if weights.background > 0 else {}
                per_frame.append(background | objective.compared(frame, singles.mean(0)))
            return mean_of_frames(per_frame)

        return vmap(compared)(pictures, *self._pictures)

    def _surface_terms(self, texture: Float[Tensor, "N A A 3"]) -> dict[str, Float[Tensor, "N"]]:
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


def settle_together(
    variables: Sequence[Variables], objectives: Sequence[Objective], config: FitConfig, rasterizer: WarpRasterizer
) -> None:
    """As `hfb.fit.settle.settle`, of all fits at once."""
    leaves = Leaves.of(variables, rasterizer.device)
    group = Together([settling(one, config) for one in objectives], variables[0].trajectory, rasterizer, draws=False)

    def loss() -> Float[Tensor, ""]:
        return group.template.total(group.body_terms(leaves)).sum()

    settle_by(
        loss, [leaves.rotation, leaves.translation], leaves.betas, config, lambda: _keep_within(leaves, group, config)
    )
    leaves.into(variables)


def descend_together(
    variables: Sequence[Variables],
    objectives: Sequence[Objective],
    config: FitConfig,
    rasterizer: WarpRasterizer,
    on_progress: Progress | None,
) -> list[Descent]:
    """As `hfb.fit.descent.descend`, of all fits at once; changes the variables in place.

    Raises:
        ValueError: the fits are not of one kind.
        FloatingPointError: the loss of one is no longer a number.
    """
    stages = [stage for stage in config.stages if stage.iterations > 0]
    total, done = sum(stage.iterations for stage in stages), 0
    leaves, everywhere = Leaves.of(variables, rasterizer.device), list(objectives)
    optimizer = torch.optim.Adam(leaves.groups(config, 0.0), eps=config.adam_epsilon, fused=True)
    claims = [one.evidence for one in objectives]
    histories: list[dict[str, list[float]]] = [{} for _ in variables]
    best_iterations, offsets = [0] * len(variables), [0] * len(variables)
    for number, stage in enumerate(stages):
        if number > 0:
            full = stage.size_px == stages[-1].size_px
            everywhere = [
                one if claim is None else replace(one, evidence=told_after(claim, mine, one, config, full))
                for one, claim, mine in zip(everywhere, claims, variables, strict=True)
            ]
        seen = [one.observation.resized(stage.size_px) for one in everywhere]
        visible = [
            visible_at(mine, there, one.body, config) if one.texels else None
            for one, mine, there in zip(everywhere, variables, seen, strict=True)
        ]
        everywhere_seen = [
            replace(one, observation=there, visible=texels)
            for one, there, texels in zip(everywhere, seen, visible, strict=True)
        ]
        group = Together(everywhere_seen, variables[0].trajectory, rasterizer)

        def tell(iterations: int, loss: float, before: int = done) -> None:
            if on_progress:
                on_progress(before + iterations, total, loss)

        kept = _stage(group, leaves, optimizer, config, stage, tell)
        done += stage.iterations
        for place, (history, iterations) in enumerate(zip(histories, kept.length, strict=True)):
            for name, row in zip((*kept.names, "total"), kept.values[:iterations, :, place].T.tolist(), strict=True):
                history.setdefault(name, []).extend(row)
            best_iterations[place] = offsets[place] + int(kept.iteration[place])
            offsets[place] += iterations
        kept.leaves.copy_where(torch.ones_like(kept.loss, dtype=torch.bool), leaves)
        leaves.into(variables)
        objectives = everywhere_seen
    return [
        Descent(mine.copy(), best, history, objective)
        for mine, best, history, objective in zip(variables, best_iterations, histories, objectives, strict=True)
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
    best, names, rows = leaves.copy(), (), []
    best_loss = told = torch.full_like(leaves.betas[:, 0].detach(), math.inf)
    best_at, waited = best_loss.long().zero_(), best_loss.long().zero_()
    length = waited.clone()
    for iteration in range(stage.iterations):
        share = 0.05 + 0.95 * (1 + math.cos(math.pi * iteration / stage.iterations)) / 2 if stage.cosine else 1.0
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
