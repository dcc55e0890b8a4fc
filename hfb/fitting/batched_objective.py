"""The objectives of many fits as one, for a device that a single fit would leave idle.

Every tensor has one more dimension in front, the fits. `torch.func.vmap` evaluates the terms, which are written for one
fit, for all of them; rendering is batched.
"""

import gc
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch.func import vmap

from hfb.body.height import as_tall
from hfb.body.model import Body
from hfb.config import FitConfig
from hfb.fitting.variables import Variables, learning_rates
from hfb.kernels.dispatch import readable_formulas
from hfb.motion.trajectory import Trajectory
from hfb.objective.objective import Objective, mean_of_frames
from hfb.objective.regularizers import background_loss
from hfb.rendering.warp import WarpRasterizer
from hfb.typing import Bool, Float, Tensor

_EVIDENCE = ("lenses", "middle", "scale", "path", "log_height", "height_scale")
_PICTURES = ("plate_linear", "frames_linear", "mattes")


@dataclass(frozen=True)
class BatchedVariables:
    """Free variables of N fits on a device, as in `Variables`."""

    rotation: Float[Tensor, "N T D1 24 4"]
    translation: Float[Tensor, "N T D1 4"]
    betas: Float[Tensor, "N 10"]
    texture: Float[Tensor, "N A A 3"]
    height_m: Float[Tensor, "N"]
    """NaN where the height is free."""

    @staticmethod
    def stack(variables: Sequence[Variables], device: torch.device) -> "BatchedVariables":
        """Stack copies of the fits' variables; known shapes and textures get no gradient.

        Args:
            variables: variables of every fit, in the CPU's memory.
            device: device of the copies.
        """

        def leaf(tensors: list[Tensor]) -> Tensor:
            stacked = torch.stack([one.detach() for one in tensors]).to(device)
            return stacked.requires_grad_(tensors[0].requires_grad)

        return BatchedVariables(
            leaf([one.trajectory.rotation for one in variables]),
            leaf([one.trajectory.translation for one in variables]),
            leaf([one.betas for one in variables]),
            leaf([one.texture for one in variables]),
            torch.tensor(
                [math.nan if one.height_m is None else one.height_m for one in variables],
                dtype=torch.float64,
                device=device,
            ),
        )

    def copy_into(self, variables: Sequence[Variables]) -> None:
        """Copy every fit's values into its variables; padding is dropped.

        Args:
            variables: variables of every fit, in the CPU's memory.
        """
        with torch.no_grad():
            parts = (one.cpu() for one in (self.rotation, self.translation, self.betas, self.texture))
            for one, *found in zip(variables, *parts, strict=False):
                places = one.trajectory.rotation, one.trajectory.translation, one.betas, one.texture
                for place, value in zip(places, found, strict=True):
                    place.copy_(value)

    def groups(self, config: FitConfig, rate: float) -> list[dict]:
        """Return the parameter groups of Adam.

        Args:
            config: options of the fit.
            rate: learning rate of the motion.
        """
        leaves = self.rotation, self.translation, self.betas, self.texture
        return [{"params": [leaf], "lr": one} for leaf, one in zip(leaves, learning_rates(config, rate), strict=True)]

    def copy_rows(self, chosen: Bool[Tensor, "N"], into: "BatchedVariables") -> None:
        """Copy the values of the chosen fits into others.

        Args:
            chosen: fits to copy.
            into: the destination.
        """
        with torch.no_grad():
            for part in fields(self):
                now, kept = getattr(self, part.name), getattr(into, part.name)
                kept.copy_(torch.where(chosen.view(-1, *(1,) * (now.ndim - 1)), now, kept))

    def project_(self, body: Body) -> None:
        """Project onto the constraints after a step; see `Variables.project_`.

        Args:
            body: the body model.
        """
        with torch.no_grad():
            self.texture.clamp_(0, 1)
            if self.betas.requires_grad:
                free = self.height_m.isnan()[:, None]
                self.betas.copy_(torch.where(free, self.betas, as_tall(self.betas, body, self.height_m)))

    def copy(self) -> "BatchedVariables":
        """Return a detached copy."""
        return BatchedVariables(*(getattr(self, one.name).detach().clone() for one in fields(self)))


class _Graphed:
    """A function from tensors to a tuple of tensors, replayed as a CUDA graph with its backward pass on a GPU.

    Hundreds of small launches take the CPU longer than the device. The next call overwrites the results.
    """

    def __init__(self, function: Callable[..., tuple[Tensor, ...]], captures: bool = True) -> None:
        self._function: Callable[..., Any] = function
        self._captures = captures

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        if inputs[0].is_cuda and self._captures:
            samples = tuple(one.detach().clone().requires_grad_(one.requires_grad) for one in inputs)
            with _no_garbage_collection():
                self._function = torch.cuda.make_graphed_callables(self._function, samples, allow_unused_input=True)
            self._captures = False
        return self._function(*inputs)


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Suspend garbage collection: destroying a CUDA graph while another is captured breaks the capture."""
    collects = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


class BatchedObjective:
    """Objectives with the same options, number of frames, timing and image size as one."""

    def __init__(
        self,
        objectives: Sequence[Objective],
        variables: Sequence[Variables],
        rasterizer: WarpRasterizer,
        renders: bool = True,
    ) -> None:
        """Stack the constants of all fits on the rasteriser's device.

        Args:
            objectives: one per fit, in the processor's memory.
            variables: one per fit; only their constants are kept.
            rasterizer: renders all fits.
            renders: terms of images will be needed.
        """
        first, device, self._rasterizer = objectives[0], rasterizer.device, rasterizer

        def stacked(parts: Sequence[Tensor]) -> Tensor:
            return torch.stack([one.detach() for one in parts]).to(device)

        self.template = replace(
            first, body=first.body.on(device), first=first.first.to(device), texels=None, visible=None
        )
        self._like = variables[0].trajectory
        self._known = {"first": stacked([one.first for one in objectives])}
        references = [one.reference for one in variables if one.reference is not None]
        if references:
            self._known["reference"] = stacked(references)
        claims = [one.evidence for one in objectives if one.evidence is not None]
        self._known |= {name: stacked([getattr(one, name) for one in claims]) for name in _EVIDENCE if claims}
        if renders:
            self._seen = {name: stacked([getattr(one.observation, name) for one in objectives]) for name in _PICTURES}
            self._cameras = [one.observation.camera for one in objectives for _ in one.first]
        self._surfaces = [(one.texels, one.visible) for one in objectives]
        self._names: dict[str, list[str]] = {}
        captures = first.weights.adversarial == 0  # graphs of the motion prior's networks are untested
        self._bodies, self._skeletons = _Graphed(self._all_bodies, captures), _Graphed(self._all_skeletons, captures)
        self._comparison = _Graphed(self._all_compared)

    def terms(self, variables: BatchedVariables) -> dict[str, Float[Tensor, "N"]]:
        """Return unweighted terms of every fit; see `Objective.terms`.

        Args:
            variables: variables of all fits, on the device.
        """
        with readable_formulas():
            vertices, *of_bodies = self._bodies(variables.rotation, variables.translation, variables.betas)
            of_images = self._comparison(self._render(vertices, variables.texture))
            terms = dict(zip(self._names["images"], of_images, strict=True)) | self._surface_terms(variables.texture)
            return terms | dict(zip(self._names["bodies"], of_bodies, strict=True))

    def body_terms(self, variables: BatchedVariables) -> dict[str, Float[Tensor, "N"]]:
        """Return terms of every fit that need no rendering; see `Objective.body_terms`.

        Args:
            variables: variables of all fits, on the device.
        """
        with readable_formulas():
            values = self._skeletons(variables.rotation, variables.translation, variables.betas)
            return dict(zip(self._names["bodies"], values, strict=True))

    def _all_bodies(self, *moving: Tensor) -> tuple[Tensor, ...]:
        """Return vertices (N, T, S, V, 3) of all fits, and the terms of body and motion."""

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
        """Return one fit's objective and its motion in metres; inside `vmap`."""
        objective = replace(self.template, first=known["first"])
        if objective.evidence is not None:
            told: dict[str, Any] = {name: known[name] for name in _EVIDENCE}
            objective = replace(objective, evidence=replace(objective.evidence, **told))
        trajectory = replace(self._like, rotation=rotation, translation=translation)
        variables = Variables(trajectory, betas, betas.new_empty(0, 0, 3), known.get("reference"))
        return objective, variables.motion(objective.body)

    def _render(
        self, vertices: Float[Tensor, "N T S V 3"], texture: Float[Tensor, "N A A 3"]
    ) -> Float[Tensor, "N T n H W 4"]:
        """Return mean image of every frame, or all of its sub-frames where the background term needs them."""
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
            for frame, images in enumerate(drawn.unbind()):
                terms = {}
                if self.template.weights.background > 0:
                    terms["background"] = background_loss(seen["plate_linear"], images)
                per_frame.append(terms | here.compare_mean(frame, images.mean(0)))
            return mean_of_frames(per_frame)

        terms = vmap(one)(drawn, self._seen)
        self._names["images"] = list(terms)
        return tuple(terms.values())

    def _surface_terms(self, texture: Float[Tensor, "N A A 3"]) -> dict[str, Float[Tensor, "N"]]:
        """Return terms of the texture, one fit at a time, on the CPU; the preset `best` has none."""
        if self.template.weights.texture <= 0 or self._surfaces[0][0] is None:
            return {}
        each = [
            replace(self.template, texels=texels, visible=visible).surface_terms(one)["texture"]
            for one, (texels, visible) in zip(texture.cpu(), self._surfaces, strict=True)
        ]
        return {"texture": torch.stack(each).to(texture.device)}
