"""The schedule of a fit: initial evidence, warm-up, image stages with refined evidence, directions, confidence."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, cast

import torch

from hfb.body.height import as_tall, height_m
from hfb.body.model import Body
from hfb.config import FitConfig
from hfb.errors import InputError
from hfb.fitting.alternatives import Alternatives
from hfb.fitting.confidence import shipped_radius_mm
from hfb.fitting.direction_trust import trusted
from hfb.fitting.directions import search_directions
from hfb.fitting.front_choice import (
    CLEAR_LOG_ODDS,
    FitLoss,
    FrontChoice,
    front_log_odds,
    loss_log_ratio,
    turn_between_deg,
)
from hfb.fitting.identity import Identity
from hfb.fitting.joint_features import joint_features
from hfb.fitting.refine import InitialEvidence, predict_initial_evidence, seen_by_network
from hfb.fitting.stage_clock import Progress, StageClock
from hfb.fitting.stages import StagesResult, for_frames, image_stages, run_stages, subframes_at
from hfb.fitting.variables import Variables, start_variables
from hfb.fitting.warmup import fit_skeleton
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.kernels.determinism import one_torch_thread
from hfb.motion.sampled import SampledMotion, sample_motion
from hfb.motion.static_pose import FirstBody, OtherFront, rescale_first_body
from hfb.motion.trajectory import Trajectory
from hfb.objective.objective import Objective
from hfb.objective.own_term import OwnTerm
from hfb.objective.texture import TexelNeighbours, texel_neighbours
from hfb.objective.weights import base_weights
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
    """A fitted motion and facts about the fit.

    Attributes:
        motion: poses, translations and joints of every sub-frame.
        texture: linear light, the atlas' gutter filled.
        trajectory: polynomials of the best iterate, in metres.
        mattes: mattes of the last stage, in the frames' size.
        history: one value per iteration for every unweighted term and the weighted ``total``.
        best_iteration: the iteration that was kept, counted through all stages.
        seconds: wall time of the fit.
        stage_seconds: wall time per stage of the schedule, in its order; of a batch, for all of its fits.
        alternatives: other directions of the motion, where they were searched.
        joint_features: features that the motion's ``joint_radius_mm`` was computed from.
        front: which front was kept, where both were fitted.
    """

    motion: SampledMotion
    texture: Float[Tensor, "A A 3"]
    trajectory: Trajectory
    mattes: Float[Tensor, "T H W"]
    history: dict[str, list[float]]
    best_iteration: int
    seconds: float = 0.0
    stage_seconds: dict[str, float] = field(default_factory=dict)
    alternatives: Alternatives | None = None
    joint_features: dict[str, Float[Array, "R 24"]] = field(default_factory=dict)
    front: FrontChoice | None = None

    @property
    def loss(self) -> float:
        """Weighted loss of the kept iterate; 0 without iterations."""
        return self.history["total"][self.best_iteration] if self.history else 0.0


@dataclass(frozen=True)
class Problem:
    """The input of one fit.

    Attributes:
        observation: frames, plate and mattes.
        first_bodies: one static body per frame.
        identity: known shape and texture, held fixed; the first bodies must have that shape.
        other_front: bodies that face the other way, which are fitted too; None where the front is sure.
    """

    observation: Observation
    first_bodies: Sequence[FirstBody]
    identity: Identity | None = None
    other_front: OtherFront | None = None

    def mirrored(self) -> "Problem":
        """Return the problem that begins from the other front."""
        assert self.other_front is not None
        return replace(self, first_bodies=self.other_front.bodies, other_front=None)


def fit(
    observation: Observation,
    first_bodies: Sequence[FirstBody],
    body: Body,
    config: FitConfig,
    seed: int,
    pose_prior: PosePrior,
    *,
    on_progress: Progress | None = None,
    motion_prior: MotionPrior | None = None,
    identity: Identity | None = None,
    other_front: OtherFront | None = None,
    own_terms: Sequence[OwnTerm] = (),
) -> FitResult:
    """Minimise eq. (11) over motion, shape and texture, from one static body per frame.

    Args:
        observation: frames, plate and mattes.
        first_bodies: one static body per frame.
        body: the body model.
        config: options of the fit.
        seed: seed of the first velocity's direction.
        pose_prior: prior of the pose, L_P of eq. (6).
        on_progress: called at the beginning of every stage and after every iteration; see `Progress`.
        motion_prior: prior of the motion, for the directions; the shipped one when not given.
        identity: known shape and texture, held fixed; the first bodies must have that shape.
        other_front: see `Problem`.
        own_terms: further terms of the loss, on the processor only.

    Raises:
        InputError: all mattes are empty, or terms of the caller's own are given for a fit on a device.
        FloatingPointError: the loss is not finite; the message names the first such terms.
    """
    problem = Problem(observation, first_bodies, identity, other_front)
    return fit_all(
        [problem],
        body,
        config,
        seed,
        pose_prior,
        on_progress=on_progress,
        motion_prior=motion_prior,
        own_terms=own_terms,
    )[0]


def fit_all(
    problems: Sequence[Problem],
    body: Body,
    config: FitConfig,
    seed: int,
    pose_prior: PosePrior,
    *,
    on_progress: Progress | None = None,
    motion_prior: MotionPrior | None = None,
    batch_size: int = 1,
    own_terms: Sequence[OwnTerm] = (),
) -> list[FitResult]:
    """Fit several problems, each as `fit` does: one after another, or on a device as one batch.

    With ``config.rasterizer`` "cuda" or "warp" the stages of all fits run together, each in a square window of its
    frames; networks and the search for directions run on the processor. All problems must have the same number of
    frames and the same timing, and the identity known in all or none.

    Args:
        problems: observation, first bodies and, where known, identity of each.
        body: the body model.
        config: options of all fits.
        seed: seed of the first velocity's direction.
        pose_prior: prior of the pose, L_P of eq. (6).
        on_progress: as of `fit`; of a batch with the mean loss.
        motion_prior: as of `fit`.
        batch_size: on a device a batch is padded to this size, so that results do not depend on the other fits in it.
        own_terms: as of `fit`.

    Raises:
        InputError: as `fit`; or the device's memory is too small for the batch.
        FloatingPointError: as `fit`.
        ValueError: the problems of a batch differ in kind.
    """
    started = time.perf_counter()
    schedule = _Schedule(body, config, seed, pose_prior, motion_prior or load_motion_prior(None), tuple(own_terms))
    if own_terms and schedule.batched:
        raise InputError("extra terms are computed on the processor only: take the rasterizer cpu")
    groups = [problems] if schedule.batched else [[one] for one in problems]
    with one_torch_thread():
        results = [one for group in groups for one in _fit_together(group, schedule, on_progress, batch_size)]
    return [replace(one, seconds=(time.perf_counter() - started) / len(problems)) for one in results]


def _fit_together(
    problems: Sequence[Problem], schedule: "_Schedule", on_progress: Progress | None, batch_size: int
) -> list[FitResult]:
    """Fit one problem, or a batch; the other front of the doubtful ones only as far as that is needed."""
    schedule = replace(schedule, config=for_frames(schedule.config, len(problems[0].first_bodies)))
    run = _run_batch if schedule.batched else _run_one
    doubtful = [place for place, one in enumerate(problems) if one.other_front is not None]
    iterations = sum(stage.iterations for stage in image_stages(schedule.config))
    clock = StageClock(iterations * (2 if doubtful else 1), on_progress)
    fitted = run(problems, schedule, clock, batch_size)
    others: list[_Fitted | None] = [None] * len(problems)
    if doubtful:
        with clock.stage("other_front"):
            for only_first in (True, False):
                mirrored, inner = [problems[place].mirrored() for place in doubtful], clock.inner("other front: ")
                found = run(mirrored, schedule, inner, batch_size, only_first) if mirrored else []
                for place, one in zip(doubtful, found, strict=True):
                    others[place] = one
                doubtful = [one for one in doubtful if schedule.needs_more(fitted[one], others[one])]
        clock.skip(iterations)
    with clock.stage("directions"):
        results = schedule.finish_all(fitted, others)
    return [replace(one, stage_seconds=clock.seconds) for one in results]


def _run_one(
    problems: Sequence[Problem], schedule: "_Schedule", clock: StageClock, _batch_size: int, only_first: bool = False
) -> list["_Fitted"]:
    """Everything up to the last image stage, or to the first."""
    config = schedule.config
    with clock.stage("evidence"):
        (start,) = map(schedule.start, problems)
    if config.settle > 0:
        with clock.stage("warm_up"):
            fit_skeleton(start.variables, start.objective, config)
    count = 1 if only_first else None
    stages = run_stages(start.variables, start.initial, start.objective, config, clock, count)
    return [_Fitted(start, stages, only_first)]


def _run_batch(
    problems: Sequence[Problem], schedule: "_Schedule", clock: StageClock, batch_size: int, only_first: bool = False
) -> list["_Fitted"]:
    """As `_run_one`, of problems that go together on a device."""
    kinds = {(len(one.first_bodies), *one.observation.timing, one.identity is None) for one in problems}
    if len(kinds) > 1:
        told = sorted(map(str, kinds))
        raise ValueError(f"fits of several kinds (frames, exposure, interval, row clock, nobody known): {told}")
    from hfb.fitting.batched import Batch, fit_skeletons, ignore_graph_warning, map_threads, run_batched_stages

    config = schedule.config
    rasterizer = cast("WarpRasterizer", make_rasterizer(config.silhouette, config.rasterizer))
    with clock.stage("evidence"):
        starts = map_threads(schedule.start, problems)
    parts = ([one.variables for one in starts], [one.initial for one in starts], [one.objective for one in starts])
    try:
        batch = Batch(*parts, config, rasterizer, batch_size)
        with ignore_graph_warning():
            if config.settle > 0:
                with clock.stage("warm_up"):
                    fit_skeletons(batch)
            stages = run_batched_stages(batch, clock, 1 if only_first else None)
    except torch.OutOfMemoryError as error:
        raise InputError(
            f"the GPU's memory is too small for {max(batch_size, len(problems))} fits at once: give a smaller "
            "--fit.batch-size, or take --fit.rasterizer cpu"
        ) from error
    return [_Fitted(start, one, only_first) for start, one in zip(starts, stages, strict=True)]


@dataclass(frozen=True)
class _Start:
    """A problem before its first stage; its first bodies have the known height."""

    problem: Problem
    first_bodies: Sequence[FirstBody]
    variables: Variables
    initial: InitialEvidence
    objective: Objective


@dataclass(frozen=True)
class _Fitted:
    """A problem after its last stage, or after its first."""

    start: _Start
    stages: StagesResult
    only_first: bool = False

    def loss(self, first: bool) -> FitLoss:
        """Losses of the best iterate, of the first stage or of all; 0 without iterations."""
        best = self.stages.first_best if first else self.stages.best_iteration
        total, matte = (
            values[best] if (values := self.stages.history.get(name)) else 0.0 for name in ("total", "matte")
        )
        return FitLoss(total, matte)


@dataclass(frozen=True)
class _Schedule:
    """The first and the last steps of every fit with the same options."""

    body: Body
    config: FitConfig
    seed: int
    pose_prior: PosePrior
    motion_prior: MotionPrior
    own_terms: tuple[OwnTerm, ...] = ()

    @property
    def batched(self) -> bool:
        """Whether fits run as one batch on a device."""
        return self.config.rasterizer in ("cuda", "warp")

    def start(self, problem: Problem) -> _Start:
        """Start values, the networks' predictions, and the objective that compares with them."""
        body, config = self.body, self.config
        seen, first_bodies = problem.observation, problem.first_bodies
        if len(first_bodies) != seen.mattes.shape[0]:
            raise ValueError(f"{len(first_bodies)} first bodies for {seen.mattes.shape[0]} frames")
        kept_m = self._kept_height_m(first_bodies)
        if kept_m is not None and problem.identity is None:
            first_bodies = [rescale_first_body(one, as_tall(one.betas, body, kept_m), body) for one in first_bodies]
        generator = torch.Generator().manual_seed(self.seed)
        variables = start_variables(first_bodies, seen, config, generator, problem.identity, kept_m)
        initial = predict_initial_evidence(seen, first_bodies, body, config, square=self.batched)
        return _Start(problem, first_bodies, variables, initial, self._objective(initial, first_bodies))

    def _kept_height_m(self, first_bodies: Sequence[FirstBody]) -> float | None:
        """Return the height that is told, else the mean height of bodies that a pose network saw."""
        if self.config.height_m is not None or not self.config.keep_height or not seen_by_network(first_bodies):
            return self.config.height_m
        return height_m(self.body, torch.stack([one.betas for one in first_bodies])).mean().item()

    def _objective(self, initial: InitialEvidence, first_bodies: Sequence[FirstBody]) -> Objective:
        """Return eq. (11) at full size, rendered on the CPU."""
        config, body = self.config, self.body
        poses = torch.stack([one.pose for one in first_bodies]).to(initial.observation.mattes)
        weights = base_weights(config, len(first_bodies))
        backend: Literal["reference", "cpu"] = "reference" if config.rasterizer == "reference" else "cpu"
        return Objective(
            initial.observation,
            body,
            make_rasterizer(config.silhouette, backend, config.threads, config.dibr_sharpness),
            self.pose_prior,
            weights,
            config.subframes,
            axis_angle_to_matrix(poses),
            _texel_neighbours(body, config) if weights.texture > 0 else None,
            matte_scales=config.matte_scales,
            image_scales=config.image_scales,
            evidence=initial.joints,
            xy_weight=config.xy_weight,
            motion_prior=self.motion_prior,
            own_terms=self.own_terms,
        )

    def finish(self, fitted: _Fitted, other: _Fitted | None = None) -> FitResult:
        """Keep one front; search the directions of its best iterate and find the radius of every joint.

        Args:
            fitted: from the first bodies as found.
            other: from the other front, where it was fitted.
        """
        if other is None:
            return self._complete(fitted)
        turned = fitted.start.problem.other_front
        assert turned is not None
        loss_ratio, log_odds = _front_odds(fitted, other)
        kept, left = (fitted, other) if log_odds >= 0 else (other, fitted)
        result, rest = self._complete(kept), self._result(left).motion
        turn_deg = turn_between_deg(result.motion, rest)
        front = FrontChoice(log_odds, loss_ratio, turned.doubt, rest, turn_deg)
        alternatives = result.alternatives
        if alternatives is not None:
            alternatives = replace(alternatives, other_front=front.as_alternative())
        return replace(result, front=front, alternatives=alternatives)

    def finish_all(self, fitted: list[_Fitted], others: list[_Fitted | None]) -> list[FitResult]:
        """Finish fits that ran together, see `finish`.

        Args:
            fitted: from the first bodies as found.
            others: from the other fronts, where they were fitted.
        """
        if not self.batched:
            return list(map(self.finish, fitted, others))
        from hfb.fitting.batched import map_threads

        return map_threads(self.finish, fitted, others)

    def needs_more(self, fitted: _Fitted, other: _Fitted | None) -> bool:
        """Whether the first stage of the other front leaves it open which is right.

        Args:
            fitted: from the first bodies as found.
            other: from the other front, its first stage alone.
        """
        turned = fitted.start.problem.other_front
        assert turned is not None
        assert other is not None
        return turned.to_the_end or _front_odds(fitted, other)[1] <= CLEAR_LOG_ODDS

    def _complete(self, fitted: _Fitted) -> FitResult:
        start, stages = fitted.start, fitted.stages
        config, problem = self.config, start.problem
        best = stages.best.in_metres(self.body)
        result = self._result(fitted)
        if not stages.history or not (config.directions.search or problem.identity is not None):
            return result
        # The odds of directions were calibrated with the weights of before the stages of full size.
        size_px = config.directions.size_px
        coarse = replace(
            stages.objective, observation=stages.observation.resized(size_px), weights=start.objective.weights
        )
        # Radii are calibrated with the initial mattes: refined ones share the fit's errors.
        initial = replace(coarse, observation=start.initial.observation.resized(size_px))
        alternatives = None
        if config.directions.search:  # in a clip the neighbouring windows determine the directions
            few = replace(coarse, subframes=subframes_at(size_px, config))
            trajectory, alternatives = search_directions(best, few, stages.objective, config.directions)
            best = replace(best, trajectory=trajectory)
            chosen = alternatives.chosen
            motion = replace(
                result.motion,
                poses=alternatives.poses[chosen],
                trans=alternatives.trans[chosen],
                joints=alternatives.joints[chosen],
            )
            result = replace(result, motion=motion, trajectory=trajectory)
        features = joint_features(
            result.motion,
            alternatives,
            best,
            first_bodies=start.first_bodies,
            coarse=initial,
            height_told=config.height_m is not None,
        )
        sources = [first.source for first in start.first_bodies]
        radius = shipped_radius_mm(features, result.motion.frame_index, sources)
        if alternatives is not None:
            alternatives = trusted(alternatives, features, sources)
        motion = replace(result.motion, joint_radius_mm=radius)
        return replace(result, motion=motion, joint_features=features, alternatives=alternatives)

    def _result(self, fitted: _Fitted) -> FitResult:
        body, config, stages, seen = self.body, self.config, fitted.stages, fitted.start.problem.observation
        best = stages.best.in_metres(body)
        with torch.no_grad():
            shaped = body.shape(best.betas)
        motion = sample_motion(
            best.trajectory,
            shaped,
            best.betas,
            config.subframes,
            seen.exposure_s,
            seen.interval_s,
            seen.camera.matrix(),
        )
        texture = fill_texture_gutter(best.texture, texel_faces(body.mesh, config.texture_px))
        left, top, *_ = seen.region(square=self.batched)
        mattes = paste_mattes(seen.mattes, stages.observation.mattes, left, top)
        return FitResult(motion, texture, best.trajectory, mattes, stages.history, stages.best_iteration)


def _front_odds(fitted: _Fitted, other: _Fitted) -> tuple[float, float]:
    """Return the ratio of losses, of the first stage where the other front has no more, and the log odds "as found"."""
    turned = fitted.start.problem.other_front
    assert turned is not None
    ratio = loss_log_ratio(fitted.loss(other.only_first), other.loss(other.only_first))
    return ratio, front_log_odds(ratio, turned.doubt, [one.source for one in fitted.start.problem.first_bodies])


def _texel_neighbours(body: Body, config: FitConfig) -> TexelNeighbours:
    return texel_neighbours(body.mesh, body.template, texel_faces(body.mesh, config.texture_px))


def paste_mattes(
    whole: Float[Tensor, "T H W"], window: Float[Tensor, "T h w"], left: int, top: int
) -> Float[Tensor, "T H W"]:
    """Copy of whole mattes with those of a window in place, see `Observation.cropped`.

    Args:
        whole: mattes of whole frames.
        window: mattes of the window, which may reach outside the frames.
        left: left edge of the window [px].
        top: top edge of the window [px].
    """
    (height, width), (rows, columns) = whole.shape[1:], window.shape[1:]
    pasted = whole.clone()
    up, down, west, east = max(top, 0), min(top + rows, height), max(left, 0), min(left + columns, width)
    pasted[:, up:down, west:east] = window[:, up - top : down - top, west - left : east - left]
    return pasted
