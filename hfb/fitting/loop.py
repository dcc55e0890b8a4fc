"""A fit from its start to its result: what is free, the descent, the search for directions."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import torch

from hfb.body.height import as_tall
from hfb.body.model import Body
from hfb.config import FitConfig
from hfb.errors import InputError
from hfb.evidence.joint_evidence import look_for_joints
from hfb.fitting.alternatives import Alternatives
from hfb.fitting.clip_person import ClipPerson, as_person
from hfb.fitting.confidence import shipped_radius_mm
from hfb.fitting.descent import Descent, Progress, descend
from hfb.fitting.direction_trust import trusted
from hfb.fitting.directions import search_directions
from hfb.fitting.joint_features import joint_features
from hfb.fitting.settle import settle
from hfb.fitting.variables import Variables, start_variables
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.kernels.determinism import one_torch_thread
from hfb.motion.sampled import SampledMotion, sample_motion
from hfb.motion.static_pose import FirstBody
from hfb.motion.trajectory import Trajectory
from hfb.objective.objective import Objective
from hfb.objective.texture import TexelNeighbours, texel_neighbours
from hfb.priors.motion_prior import MotionPrior, load_motion_prior
from hfb.priors.pose import PosePrior
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.observation import Observation
from hfb.rendering.texels import fill_texture_gutter, texel_faces
from hfb.typing import Array, Float, Tensor

if TYPE_CHECKING:
    from hfb.rendering.warp import WarpRasterizer


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
    problem = Problem(observation, first_bodies, person)
    return fit_all([problem], body, config, seed, pose_prior, on_progress, motion_prior)[0]


@dataclass(frozen=True)
class Problem:
    """What is seen in one fit, where it starts, and who is seen, if that is known; see `fit`."""

    observation: Observation
    first_bodies: Sequence[FirstBody]
    person: ClipPerson | None = None


def fit_all(
    problems: Sequence[Problem],
    body: Body,
    config: FitConfig,
    seed: int,
    pose_prior: PosePrior,
    on_progress: Progress | None = None,
    motion_prior: MotionPrior | None = None,
    room: int = 1,
) -> list[FitResult]:
    """Several fits, each as `fit` makes it: one after another, or on a device as one problem.

    With ``config.rasterizer`` "cuda" or "warp" all fits are optimised together, each in a square window of its
    pictures; what the networks say and the search for directions are the processor's. All must have the same number of
    frames and the same timing, and the person known in all or none.

    Args:
        on_progress: called of every fit in turn, or of all at once with the mean of their losses.
        room: on a device, for how many fits: in a room of one size a fit has the same bits whoever is beside it.
        others: as of `fit`.

    Raises:
        InputError: as `fit`; or the device's memory is too small for so many at once.
        FloatingPointError: as `fit`.
        ValueError: the fits of a device are not of one kind.
    """
    started = time.perf_counter()
    together = config.rasterizer in ("cuda", "warp")
    prior = motion_prior or load_motion_prior(None)

    def begun(problem: Problem) -> _Begun:
        return _begun(problem, body, config, seed, pose_prior, prior, square=together)

    with one_torch_thread():
        if together:
            results = _fit_together(problems, begun, body, config, on_progress, room)
        else:
            results = [_fit_alone(begun(one), body, config, on_progress) for one in problems]
    return [replace(one, seconds=(time.perf_counter() - started) / len(problems)) for one in results]


@dataclass(frozen=True)
class _Begun:
    """A fit at its start; its first bodies have the known height."""

    problem: Problem
    first_bodies: Sequence[FirstBody]
    variables: Variables
    everywhere: Objective


def _begun(
    problem: Problem,
    body: Body,
    config: FitConfig,
    seed: int,
    pose_prior: PosePrior,
    motion_prior: MotionPrior,
    square: bool,
) -> _Begun:
    seen, first_bodies = problem.observation, problem.first_bodies
    if len(first_bodies) != seen.mattes.shape[0]:
        raise ValueError(f"{len(first_bodies)} first bodies for {seen.mattes.shape[0]} frames")
    if config.height_m is not None and problem.person is None:
        first_bodies = [as_person(one, as_tall(one.betas, body, config.height_m), body) for one in first_bodies]
    generator = torch.Generator().manual_seed(seed)
    variables = start_variables(first_bodies, seen, config, generator, problem.person)
    return _Begun(
        problem, first_bodies, variables, _objective(seen, first_bodies, body, config, pose_prior, motion_prior, square)
    )


def _fit_alone(begun: _Begun, body: Body, config: FitConfig, on_progress: Progress | None) -> FitResult:
    if config.settle > 0:
        settle(begun.variables, begun.everywhere, config)
    return _finished(begun, descend(begun.variables, begun.everywhere, config, on_progress), body, config)


def _fit_together(
    problems: Sequence[Problem],
    begin: Callable[[Problem], _Begun],
    body: Body,
    config: FitConfig,
    on_progress: Progress | None,
    room: int,
) -> list[FitResult]:
    kinds = {
        (len(one.first_bodies), one.observation.exposure_s, one.observation.interval_s, one.person is None)
        for one in problems
    }
    if len(kinds) > 1:
        raise ValueError(f"fits of several kinds (frames, exposure, interval, nobody known): {sorted(kinds)}")
    rasterizer = cast("WarpRasterizer", make_rasterizer(config.silhouette, config.rasterizer))
    from hfb.fitting import together  # needs Warp, which only some have

    begun = together.each_by_itself(begin, problems)
    variables, objectives = [one.variables for one in begun], [one.everywhere for one in begun]
    try:
        with together.without_the_warning_of_records():
            if config.settle > 0:
                together.settle_together(variables, objectives, config, rasterizer, room)
            descents = together.descend_together(variables, objectives, config, rasterizer, on_progress, room)
    except torch.OutOfMemoryError as error:
        raise InputError(
            f"the GPU's memory is too small for {max(room, len(problems))} fits at once: give a smaller --fit.at-once, "
            "or take --fit.rasterizer cpu"
        ) from error
    return together.each_by_itself(lambda one, descent: _finished(one, descent, body, config), begun, descents)


def _finished(begun: _Begun, descent: Descent, body: Body, config: FitConfig) -> FitResult:
    """The best iterate as a result, its directions searched or at least how far off each joint may be."""
    first_bodies, size_px = begun.first_bodies, config.directions.size_px
    best = descent.best.in_metres(body)
    result = _result(best, begun.problem.observation, body, config, descent.history, descent.best_iteration)
    if not descent.history or not (config.directions.search or begun.problem.person is not None):
        return result
    # Weighed as before the stages of full size: what the odds of directions were measured by.
    seen, weights = descent.seen.resized(size_px), begun.everywhere.weights
    coarse = replace(descent.objective, observation=seen, weights=weights)
    # How far a fit is from a matte tells how far off it is only of mattes that do not know the fit.
    before = replace(coarse, observation=begun.everywhere.observation.resized(size_px))
    if config.directions.search:
        return _directed(result, best, first_bodies, coarse, descent.objective, before, config)
    # a window of a clip: its neighbours tell the directions
    told = config.height_m is not None
    return _with_radius(result, joint_features(result.motion, None, best, first_bodies, before, told), first_bodies)


def _objective(
    observation: Observation,
    first_bodies: Sequence[FirstBody],
    body: Body,
    config: FitConfig,
    pose_prior: PosePrior,
    motion_prior: MotionPrior,
    square: bool,
) -> Objective:
    """Eq. (11) in the window around the mattes at its full size; drawn on the processor."""
    first = axis_angle_to_matrix(torch.stack([one.pose for one in first_bodies]).to(observation.mattes))
    weights = config.weights
    if config.motion_shared:
        weights = weights.model_copy(update={"motion": weights.motion / len(first_bodies)})
    if len(first_bodies) > 1:
        weights = weights.model_copy(update={"height": config.several.height * weights.height})
    looks = config.settle > 0 or weights.joints + weights.path + weights.height > 0
    return Objective(
        observation.cropped(*observation.region(square=square)),
        body,
        make_rasterizer(config.silhouette, "reference" if config.rasterizer == "reference" else "cpu", config.threads),
        pose_prior,
        weights,
        config.subframes,
        first,
        _texels(body, config) if weights.texture > 0 else None,
        matte_scales=config.matte_scales,
        image_scales=config.image_scales,
        evidence=look_for_joints(observation, first_bodies, body) if looks else None,
        across=config.across,
        motion_prior=motion_prior,
    )


def _with_radius(
    result: FitResult, features: dict[str, Float[Array, "R 24"]], first_bodies: Sequence[FirstBody]
) -> FitResult:
    """How far off each joint may be."""
    radius = shipped_radius_mm(features, result.motion.frame_index, [first.source for first in first_bodies])
    motion = replace(result.motion, joint_radius_mm=radius)
    return replace(result, motion=motion, joint_features=features)


def _directed(
    result: FitResult,
    best: Variables,
    first_bodies: Sequence[FirstBody],
    coarse: Objective,
    fine: Objective,
    before: Objective,
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
    features = joint_features(motion, alternatives, directed, first_bodies, before, told)
    said = trusted(alternatives, features, [first.source for first in first_bodies])
    shown = replace(result, motion=motion, trajectory=trajectory, alternatives=said)
    return _with_radius(shown, features, first_bodies)


def _texels(body: Body, config: FitConfig) -> TexelNeighbours:
    return texel_neighbours(body.mesh, body.template, texel_faces(body.mesh, config.texture_px))


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
