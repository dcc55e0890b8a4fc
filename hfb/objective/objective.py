"""The joint loss, eq. (11): terms and their weighted sum. `hfb.objective.weights` has the weights.

A term with weight zero is not computed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import torch

from hfb.body.model import Body, ShapedBody
from hfb.config import Weights
from hfb.evidence.joint_evidence import JointEvidence
from hfb.geometry.rotations import matrix_to_axis_angle
from hfb.kernels.dispatch import compiled, constant
from hfb.kernels.motion.motion_operators import rotation_vectors
from hfb.kernels.objective.image_losses import Target
from hfb.motion.clock import next_opening, subframe_clock
from hfb.motion.trajectory import Trajectory
from hfb.objective.boundary import boundary_loss
from hfb.objective.own_term import OwnTerm, TermInputs
from hfb.objective.pyramid import image_over_scales, matte_over_scales
from hfb.objective.regularizers import background_loss, motion_loss, pose_loss, shape_loss, start_loss
from hfb.objective.texture import TexelNeighbours, texture_smoothness
from hfb.objective.weights import StageWeights
from hfb.priors.motion_prior import MotionPrior
from hfb.priors.pose import PosePrior
from hfb.rendering.cpu import CpuRasterizer
from hfb.rendering.formation import see_by_rows
from hfb.rendering.observation import Observation
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Bool, Float, Tensor


@dataclass(frozen=True)
class Objective:
    """Loss of a body, its motion and its texture for one observation.

    Attributes:
        texels: texel neighbourhoods for L_S; needed only where its weight is positive.
        first: joint rotations of the first bodies, for the term `start`.
        visible: texels visible in some sub-frame, for L_S; every texel when not given.
        evidence: joints predicted by the joint network, for the terms `joints`, `path` and `height`.
        xy_weight: factor of the joint evidence across the view; along depth it is 1.
        motion_prior: for L_A, which is used for single frames only: neighbours tell the direction better.
        warm_up: compare paths with the network's likelier sign, for several frames too. Afterwards the sign of a single
            frame's path is free, and several frames tell each other's paths.
        own_terms: terms of the caller's own.
        matte_scales: number of scales of L_alpha and L_I, each half the size of the last.
        image_scales: number of scales of L_alpha and L_I, each half the size of the last.
    """

    observation: Observation
    body: Body
    rasterizer: Rasterizer
    pose_prior: PosePrior
    weights: Weights
    subframes: int
    first: Float[Tensor, "T 24 3 3"]
    texels: TexelNeighbours | None = None
    visible: Bool[Tensor, "A A"] | None = None
    matte_scales: int = 1
    image_scales: int = 1
    evidence: JointEvidence | None = None
    xy_weight: float = 1.0
    motion_prior: MotionPrior | None = None
    warm_up: bool = False
    own_terms: tuple[OwnTerm, ...] = ()

    def terms(
        self, trajectory: Trajectory, betas: Float[Tensor, "10"], texture: Float[Tensor, "A A 3"]
    ) -> dict[str, Float[Tensor, ""]]:
        """Return the unweighted terms with a positive weight, named as in `Weights`.

        Args:
            trajectory: polynomials of the motion [m].
            betas: shape coefficients.
            texture: linear light.
        """
        posed, of_body = self._posed(trajectory, betas)
        # A split of one frame would copy in the backward pass.
        vertices = posed.split(self.subframes) if len(posed) > self.subframes else (posed,)
        per_frame = [self._image_terms(frame, one, texture) for frame, one in enumerate(vertices)]
        return mean_of_frames(per_frame) | self.surface_terms(texture) | of_body

    def vertices_and_terms(
        self, trajectory: Trajectory, betas: Float[Tensor, "10"]
    ) -> tuple[Float[Tensor, "T S V 3"], dict[str, Float[Tensor, ""]]]:
        """Return vertices to render, camera coordinates [m], and the terms of body and motion.

        Args:
            trajectory: polynomials of the motion [m].
            betas: shape coefficients.
        """
        posed, terms = self._posed(trajectory, betas)
        return posed.unflatten(0, (-1, self.subframes)), terms

    def _posed(
        self, trajectory: Trajectory, betas: Float[Tensor, "10"]
    ) -> tuple[Float[Tensor, "n V 3"], dict[str, Float[Tensor, ""]]]:
        """Return vertices of every sub-frame, frame after frame, and the terms of body and motion."""
        shaped = self.body.shape(betas)
        course = trajectory.at(self._instants(betas.dtype))
        posed, joints = shaped.pose_frames(*course)
        if (camera := self.observation.camera).row_clock is not None:
            posed = see_by_rows(posed.unflatten(0, (-1, self.subframes)), camera).flatten(0, 1)
        return posed, self.body_terms(trajectory, betas, shaped, (*course, joints))

    def surface_terms(self, texture: Float[Tensor, "A A 3"]) -> dict[str, Float[Tensor, ""]]:
        """Return the term of the texture, L_S.

        Args:
            texture: linear light.
        """
        if self.weights.texture > 0 and self.texels is not None:
            return {"texture": texture_smoothness(texture, self.texels, self.visible)}
        return {}

    def _instants(self, dtype: torch.dtype) -> Float[Tensor, "S1"]:
        """Return times of the sub-frames, then the middle of the exposure."""
        return _instants(self.subframes, dtype, self.first.device)

    def body_terms(
        self,
        trajectory: Trajectory,
        betas: Float[Tensor, "10"],
        shaped: ShapedBody,
        course: tuple[Float[Tensor, "T S1 24 3 3"], Float[Tensor, "T S1 3"], Float[Tensor, "T S1 24 3"]] | None = None,
    ) -> dict[str, Float[Tensor, ""]]:
        """Return terms that need no rendering.

        Args:
            trajectory: polynomials of the motion [m].
            betas: shape coefficients.
            shaped: the body with these betas.
            course: rotations, translations and joints [m] at `_instants`; computed when not given.
        """
        weights, seen = self.weights, self.observation
        rotations, translations, *known = course or trajectory.at(self._instants(betas.dtype))
        frames = rotations.shape[0]
        terms: dict[str, Tensor] = {}
        whole = weights.path > 0 and (frames == 1 or self.warm_up)
        if self.evidence is not None and (weights.joints > 0 or whole):
            joints = known[0] if known else self._some_joints(shaped, rotations, translations, whole)
            terms["joints"] = self.evidence.middle_loss(joints, (self.xy_weight, self.xy_weight, 1.0))
            if whole:
                terms["path"] = self.evidence.path_loss(joints, both_ways=not self.warm_up)
        if weights.pose > 0:
            terms["pose"] = pose_loss(self.pose_prior, self._vectors(rotations))
        if weights.start > 0:
            terms["start"] = start_loss(rotations, self.first)
        if weights.height > 0 and self.evidence is not None:
            terms["height"] = self.evidence.height_loss(self.body, betas)
        if weights.shape > 0:
            terms["shape"] = shape_loss(betas)
        if weights.motion > 0:
            terms["motion"] = motion_loss(trajectory) / frames
        if weights.adversarial > 0 and frames == 1 and self.motion_prior is not None:
            terms["adversarial"] = self.motion_prior(trajectory, shaped)
        if weights.boundary > 0 and frames > 1:
            terms["boundary"] = boundary_loss(trajectory, shaped, next_opening(seen.exposure_s, seen.interval_s))
        if self.own_terms:
            places = rotations[:, :-1], translations[:, :-1]
            flat = (one.flatten(0, 1) for one in places)
            joints = known[0][:, :-1] if known else shaped.joints_of(*flat).unflatten(0, (frames, -1))
            inputs = TermInputs(trajectory, betas, shaped, *places, joints, seen)
            terms |= {one.name: one(inputs) for one in self.own_terms}
        return terms

    def _some_joints(
        self,
        shaped: ShapedBody,
        rotations: Float[Tensor, "T S1 24 3 3"],
        translations: Float[Tensor, "T S1 3"],
        whole: bool,
    ) -> Float[Tensor, "T n 24 3"]:
        """Return joints [m] at opening, closing and middle of the exposure, or in the middle alone."""
        some = (0, self.subframes - 1, self.subframes) if whole else (self.subframes,)
        index = constant(some, torch.long, rotations.device)
        places = rotations.index_select(1, index).flatten(0, 1), translations.index_select(1, index).flatten(0, 1)
        return shaped.joints_of(*places).unflatten(0, (-1, len(some)))

    def _vectors(self, rotations: Float[Tensor, "T S1 24 3 3"]) -> Float[Tensor, "n 23 3"]:
        """Return axis times angle [rad] below the root at every sub-frame."""
        if compiled(rotations):
            return rotation_vectors(rotations, self.subframes).flatten(0, 1)
        return matrix_to_axis_angle(rotations[:, :-1, 1:].flatten(0, 1))

    def _image_terms(self, frame: int, vertices: Float[Tensor, "S V 3"], texture: Tensor) -> dict[str, Tensor]:
        """Return image, matting and background terms of one frame."""
        weights, seen, mesh = self.weights, self.observation, self.body.mesh
        if weights.background > 0:  # the only term that needs each sub-frame by itself
            pictures = self.rasterizer.render(vertices, texture, seen.camera, mesh)
            background = background_loss(seen.plate_linear, pictures)
            return {"background": background} | self.compare_mean(frame, pictures.mean(0))
        if weights.image > 0 and isinstance(self.rasterizer, CpuRasterizer) and not torch.compiler.is_compiling():
            target = self._targets[frame]
            return self._named(*self.rasterizer.image_losses(vertices, texture, seen.camera, mesh, target))
        if weights.image > 0:
            return self.compare_mean(frame, self.rasterizer.render_mean(vertices, texture, seen.camera, mesh))
        alpha = self.rasterizer.silhouette_mean(vertices, seen.camera, mesh)
        return self.compare_mean(frame, torch.nn.functional.pad(alpha[..., None], (3, 0)))

    def compare_mean(self, frame: int, mean: Float[Tensor, "H W 4"]) -> dict[str, Float[Tensor, ""]]:
        """Return image and matting terms of a rendered frame: mean colour, premultiplied, and mean silhouette.

        Args:
            frame: number of the frame.
            mean: mean premultiplied colour and silhouette.
        """
        if compiled(mean) and not torch.compiler.is_compiling():
            return self._named(*self._targets[frame].losses(mean))
        seen, (image_scales, matte_scales) = self.observation, self._scales
        plate, picture, matte = seen.plate_linear, seen.frames_linear[frame], seen.mattes[frame]
        nothing = mean.new_zeros(())
        return self._named(
            image_over_scales(mean, plate, picture, matte, image_scales) if image_scales > 0 else nothing,
            matte_over_scales(mean[..., 3], matte, matte_scales) if matte_scales > 0 else nothing,
        )

    @property
    def _scales(self) -> tuple[int, int]:
        """Number of scales of the image and the matting loss: 0 without a weight."""
        weights = self.weights
        return self.image_scales if weights.image > 0 else 0, self.matte_scales if weights.matte > 0 else 0

    @cached_property
    def _targets(self) -> tuple[Target, ...]:
        """Every frame with its matte, for the compiled losses."""
        seen = self.observation
        pictures = zip(seen.frames_linear, seen.mattes, strict=True)
        return tuple(Target(seen.plate_linear, frame, matte, *self._scales) for frame, matte in pictures)

    def _named(self, image: Float[Tensor, ""], overlap: Float[Tensor, ""]) -> dict[str, Float[Tensor, ""]]:
        """Return those of both losses that have a weight."""
        weights = self.weights
        return ({"image": image} if weights.image > 0 else {}) | ({"matte": overlap} if weights.matte > 0 else {})

    def for_stage(
        self, observation: Observation, weights: StageWeights, visible: Bool[Tensor, "A A"] | None = None
    ) -> "Objective":
        """Return the objective of a stage: the observation at its size, and its weights.

        Args:
            observation: at the stage's size.
            weights: weights of the stage.
            visible: texels visible in some sub-frame; every texel when not given.
        """
        return replace(
            self, observation=observation, visible=visible, weights=weights.terms, xy_weight=weights.xy_weight
        )

    def total(self, terms: dict[str, Float[Tensor, "*n"]]) -> Float[Tensor, "*n"]:
        """Return the weighted sum of the terms; one value per fit where the terms have a batch dimension.

        Args:
            terms: unweighted, by name.
        """
        values = torch.stack(tuple(terms.values()))
        weights = constant(tuple(self._weight_of(name) for name in terms), values.dtype, values.device)
        return (values * weights.view(-1, *[1] * (values.ndim - 1))).sum(0)

    def total_of_values(self, values: dict[str, float]) -> float:
        """Return `total` of plain numbers.

        Args:
            values: unweighted terms by name.
        """
        return sum(self._weight_of(name) * value for name, value in values.items())

    def _weight_of(self, name: str) -> float:
        own = {one.name: one.weight for one in self.own_terms}
        return own[name] if name in own else float(getattr(self.weights, name))

    def backward(self, terms: dict[str, Float[Tensor, ""]]) -> None:
        """Accumulate the gradients of `total` in the free variables.

        Args:
            terms: unweighted, by name.
        """
        free = {name: term for name, term in terms.items() if term.requires_grad}
        weights = [constant(self._weight_of(name), one.dtype, one.device) for name, one in free.items()]
        _WeightedSum.apply(weights, *free.values()).backward()


class _WeightedSum(torch.autograd.Function):
    """One node for the gradients of a weighted sum; `torch.autograd.backward` with weights would import sympy."""

    @staticmethod
    def forward(ctx: Any, weights: list[Tensor], *terms: Tensor) -> Tensor:
        ctx.weights = weights
        return terms[0].new_zeros(())  # nobody reads the sum

    @staticmethod
    def backward(ctx: Any, *_: Tensor) -> tuple[Tensor | None, ...]:
        return (None, *ctx.weights)


@lru_cache
def _instants(subframes: int, dtype: torch.dtype, device: torch.device) -> Float[Tensor, "S1"]:
    """Return cached tensor of `Objective._instants`; read only."""
    return torch.tensor([*subframe_clock(subframes, dtype).tolist(), 0.5], dtype=dtype, device=device)


def mean_of_frames(per_frame: Sequence[dict[str, Float[Tensor, ""]]]) -> dict[str, Float[Tensor, ""]]:
    """Return the mean of every term over the frames.

    Args:
        per_frame: unweighted terms of every frame.
    """
    if len(per_frame) == 1:
        return per_frame[0]
    return {name: torch.stack([one[name] for one in per_frame]).mean() for name in per_frame[0]}
