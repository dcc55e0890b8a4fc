"""The optimisation: Adam through the stages of a schedule, keeping the best iterate."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import torch

from hfb.body.height import as_tall
from hfb.body.model import Body
from hfb.config import FitConfig, Stage
from hfb.determinism import one_torch_thread
from hfb.fit.alternatives import Alternatives
from hfb.fit.clip_person import ClipPerson, as_person
from hfb.fit.comparison import beside_the_fit
from hfb.fit.confidence import joint_features, shipped_confidence
from hfb.fit.directions import search_directions
from hfb.fit.settle import settle
from hfb.fit.variables import Variables, start_variables
from hfb.initialize.first_body import FirstBody
from hfb.initialize.joint_evidence import JointEvidence, look_for_joints
from hfb.losses.texture import TexelNeighbours, texel_neighbours
from hfb.motion.sampled import SampledMotion, sample_motion
from hfb.motion.trajectory import Trajectory
from hfb.objective import Objective
from hfb.observation import Observation
from hfb.priors.motion_prior import MotionPrior, load_motion_prior
from hfb.priors.pose import PosePrior
from hfb.render.rasterizer import make_rasterizer
from hfb.render.texture import fill_texture_gutter, texel_faces, visible_texels
from hfb.rotations import axis_angle_to_matrix
from hfb.shapes import Array, Bool, Float, Tensor

_GAIN = 1e-3
"""Share by which the loss of a stage must fall to count as a gain."""

Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class FitResult:
    """A fitted motion and how it was found.

    Attributes:
        texture: linear light, the atlas' gutter filled.
        trajectory: the best iterate's polynomials.
        history: one value per iteration for every unweighted term and the weighted ``total``.
        best_iteration: the iteration that was kept, counted through all stages.
        seconds: wall time of the fit alone.
        alternatives: the directions in which it may have run, where they were searched.
        joint_features: what the motion's ``joint_radius_mm`` was computed from.
    """

    motion: SampledMotion
    texture: Float[Tensor, "A A 3"]
    trajectory: Trajectory
    history: dict[str, list[float]]
    best_iteration: int
    seconds: float
    alternatives: Alternatives | None = None
    joint_features: dict[str, Float[Array, "R 24"]] = field(default_factory=dict)

    @property
    def loss(self) -> float:
        """The kept iterate's; 0 where none was asked for."""
        return self.history["total"][self.best_iteration] if self.history else 0.0


def fit(
    observation: Observation,
    first_bodies: Sequence[FirstBody],
    body: Body,
    config: FitConfig,
    seed: int,
    pose_prior: PosePrior,
    on_progress: Progress | None = None,
    motion_prior: MotionPrior | None = None,
    person: ClipPerson | None = None,
) -> FitResult:
    """Minimise eq. (11) over motion, shape and texture, from one static body per frame.

    Args:
        motion_prior: what knows in which direction people move; the shipped one when not given.
        person: shape and texture that are known and held fixed; the first bodies must have that shape.
        on_progress: called after every iteration with (iterations done, of how many, total loss).

    Raises:
        InputError: all mattes are empty.
        FloatingPointError: the loss is no longer a number; the message names the first term that is not.
    """
    if len(first_bodies) != observation.mattes.shape[0]:
        raise ValueError(f"{len(first_bodies)} first bodies for {observation.mattes.shape[0]} frames")
    started = time.perf_counter()
    if config.height_m is not None and person is None:
        first_bodies = [as_person(one, as_tall(one.betas, body, config.height_m), body) for one in first_bodies]
    variables = start_variables(first_bodies, observation, config, torch.Generator().manual_seed(seed), person)
    everywhere = _objective(
        observation, first_bodies, body, config, pose_prior, motion_prior or load_motion_prior(None)
    )
    with one_torch_thread():
        if config.settle > 0:
            settle(variables, everywhere, config)
        descent = _descend(variables, everywhere, config, on_progress)
        best = descent.best.in_metres(body)
        result = _result(best, observation, body, config, descent.history, descent.best_iteration)
        if descent.history and (config.directions.search or person is not None):
            coarse = replace(descent.objective, observation=everywhere.observation.resized(config.directions.size_px))
            if config.directions.search:
                result = _directed(result, best, first_bodies, coarse, descent.objective, config)
            else:  # a window of a clip: its neighbours tell the directions
                told = config.height_m is not None
                result = _with_radius(result, joint_features(result.motion, None, best, first_bodies, coarse, told))
    return replace(result, seconds=time.perf_counter() - started)


@dataclass(frozen=True)
class _Descent:
    """Where the stages led: the best iterate of the last one, and what it was measured by."""

    best: Variables
    best_iteration: int
    history: dict[str, list[float]]
    objective: Objective


def _objective(
    observation: Observation,
    first_bodies: Sequence[FirstBody],
    body: Body,
    config: FitConfig,
    pose_prior: PosePrior,
    motion_prior: MotionPrior,
) -> Objective:
    """Eq. (11) in the window around the mattes at its full size."""
    first = axis_angle_to_matrix(torch.stack([one.pose for one in first_bodies]).to(observation.mattes))
    looks = config.settle > 0 or config.weights.joints + config.weights.path + config.weights.height > 0
    return Objective(
        observation.cropped(*observation.region()),
        body,
        make_rasterizer(config.silhouette, config.rasterizer, config.threads),
        pose_prior,
        config.weights,
        config.subframes,
        first,
        _texels(body, config) if config.weights.texture > 0 else None,
        matte_scales=config.matte_scales,
        image_scales=config.image_scales,
        evidence=look_for_joints(observation, first_bodies, body) if looks else None,
        across=config.across,
        motion_prior=motion_prior,
    )


def _descend(variables: Variables, everywhere: Objective, config: FitConfig, on_progress: Progress | None) -> _Descent:
    """Every stage in turn, each from the best iterate of the one before; changes the variables in place."""
    stages = [stage for stage in config.stages if stage.iterations > 0]
    total = sum(stage.iterations for stage in stages)
    history: dict[str, list[float]] = {}
    best, best_iteration, done, skipped, objective = variables.copy(), 0, 0, 0, everywhere
    # One for all stages: a fresh one knows no gradient's size, its first steps undo what the stage before has found.
    optimizer = torch.optim.Adam(variables.groups(config, 0.0), eps=config.adam_epsilon, fused=True)
    claimed = everywhere.evidence
    for number, stage in enumerate(stages):
        if number > 0 and claimed is not None:
            full = stage.size_px == stages[-1].size_px
            everywhere = replace(everywhere, evidence=_told(claimed, variables, everywhere, config, full))
        seen = everywhere.observation.resized(stage.size_px)
        visible = _visible(variables, seen, everywhere.body, config) if everywhere.texels else None
        objective = replace(everywhere, observation=seen, visible=visible)
        best_loss = told_loss = math.inf  # losses of different picture sizes do not compare
        waited, ends = 0, done + stage.iterations
        for loss, terms, iterate in _iterations(objective, variables, optimizer, config, stage):
            for name, value in {"total": loss, **terms}.items():
                history.setdefault(name, []).append(value)
            if loss < best_loss:
                best, best_loss, best_iteration = iterate(), loss, done
            done += 1
            if on_progress:
                on_progress(done + skipped, total, loss)
            told_loss, waited = (loss, 0) if loss < (1 - _GAIN) * told_loss else (told_loss, waited + 1)
            if 0 < config.patience <= waited:
                skipped += ends - done
                break
        _restore(variables, best)
    return _Descent(best, best_iteration, history, objective)


def _told(
    claimed: JointEvidence, variables: Variables, everywhere: Objective, config: FitConfig, full: bool
) -> JointEvidence:
    """What the networks say of the joints after a stage: the lifting network sees more of them then, and before
    every stage of full size the fit's own picture is worth a look."""
    evidence = claimed
    if config.lifting > 0:
        evidence = evidence.lifted(variables.joints_at_middle(everywhere.body), config.lifting)
    if full and config.compare > 0:
        evidence = beside_the_fit(evidence, claimed, variables, everywhere, config.compare)
    return evidence


def _with_radius(result: FitResult, features: dict[str, Float[Array, "R 24"]]) -> FitResult:
    """How far off each joint may be."""
    motion = replace(result.motion, joint_radius_mm=shipped_confidence().radius_mm(features))
    return replace(result, motion=motion, joint_features=features)


def _directed(
    result: FitResult,
    best: Variables,
    first_bodies: Sequence[FirstBody],
    coarse: Objective,
    fine: Objective,
    config: FitConfig,
) -> FitResult:
    """The result in its likeliest directions, with what else it may be and how far off each joint may be."""
    trajectory, alternatives = search_directions(best, coarse, fine, config.directions)
    chosen = alternatives.chosen
    motion = replace(
        result.motion, poses=alternatives.poses[chosen], trans=alternatives.trans[chosen],
        joints=alternatives.joints[chosen],
    )  # fmt: skip
    directed, told = replace(best, trajectory=trajectory), config.height_m is not None
    features = joint_features(motion, alternatives, directed, first_bodies, coarse, told)
    shown = replace(result, motion=motion, trajectory=trajectory, alternatives=alternatives)
    return _with_radius(shown, features)


def _iterations(
    objective: Objective, variables: Variables, optimizer: torch.optim.Adam, config: FitConfig, stage: Stage
) -> Iterator[tuple[float, dict[str, float], Callable[[], Variables]]]:
    """One stage of Adam; yields the loss, its terms and a way to copy the iterate they belong to."""
    for iteration in range(stage.iterations):
        share = 0.05 + 0.95 * (1 + math.cos(math.pi * iteration / stage.iterations)) / 2 if stage.cosine else 1.0
        for group, now in zip(
            optimizer.param_groups, variables.groups(config, stage.learning_rate * share), strict=True
        ):
            group["lr"] = now["lr"]
        optimizer.zero_grad()
        terms = objective.terms(variables.motion(objective.body), variables.betas, variables.texture)
        loss = objective.total(terms)
        values = {name: value.item() for name, value in terms.items()}
        if not math.isfinite(loss.item()):
            broken = [name for name, value in values.items() if not math.isfinite(value)]
            raise FloatingPointError(f"the loss is not a number any more at iteration {iteration}: {broken}")
        yield loss.item(), values, variables.copy
        loss.backward()
        optimizer.step()
        variables.keep_within(config, objective.body)


def _restore(variables: Variables, best: Variables) -> None:
    with torch.no_grad():
        variables.trajectory.rotation.copy_(best.trajectory.rotation)
        variables.trajectory.translation.copy_(best.trajectory.translation)
        variables.betas.copy_(best.betas)
        variables.texture.copy_(best.texture)


def _texels(body: Body, config: FitConfig) -> TexelNeighbours:
    return texel_neighbours(body.mesh, body.template, texel_faces(body.mesh, config.texture_px))


def _visible(variables: Variables, seen: Observation, body: Body, config: FitConfig) -> Bool[Tensor, "A A"]:
    """Texels the camera sees when a stage begins: visibility changes too slowly to be worth every iteration."""
    vertices = variables.vertices(body, config.subframes).flatten(0, 1)
    return visible_texels(vertices, seen.camera, body.mesh, config.texture_px)


def _result(
    best: Variables,
    observation: Observation,
    body: Body,
    config: FitConfig,
    history: dict[str, list[float]],
    best_iteration: int,
) -> FitResult:
    with torch.no_grad():
        shaped = body.shape(best.betas)
    motion = sample_motion(
        best.trajectory, shaped, best.betas, config.subframes, observation.exposure_s, observation.interval_s,
        observation.camera.matrix(),
    )  # fmt: skip
    texture = fill_texture_gutter(best.texture, texel_faces(body.mesh, config.texture_px))
    return FitResult(motion, texture, best.trajectory, history, best_iteration, 0.0)
