"""From stage to stage: nothing that was found is undone, and a stage that gains nothing ends."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import DirectionsConfig, FitConfig, MultiFrame, Stage, Weights, preset
from hfb.evidence import depth_fusion, joint_evidence, lifting_network
from hfb.fitting import fit as schedule
from hfb.fitting import joint_features as features
from hfb.fitting import refine, stages
from hfb.fitting.fit import FitResult, fit
from hfb.fitting.identity import Identity
from hfb.fitting.variables import Variables
from hfb.matting import network
from hfb.motion.static_pose import FirstBody
from hfb.objective.objective import Objective
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.observation import Observation
from hfb.typing import Array, Float
from tests.scenes import Scene, moving_scene


def run(*stages: Stage, patience: int = 0) -> tuple[FitResult, list[tuple[int, int]]]:
    """A fit from the true middle pose, and the progress it told."""
    body, told = load_default_body(), []
    scene = moving_scene(body, size_px=48)
    config = FitConfig(stages=stages, subframes=3, texture_px=16, origin=0.5, patience=patience)

    def on_progress(done: int, total: int, note: str) -> None:
        if "loss" in note:
            told.append((done, total))

    result = fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior(), on_progress=on_progress)
    return result, told


def simulated(scene: Scene) -> list[FirstBody]:
    """The true middle pose as the kind of start from which joints are corrected."""
    return [replace(one, source="simulated") for one in scene.middle]


def first_losses(frames: int, iterations: int, settle: int, **options: Any) -> list[float]:
    """Of a fit that settles and has one stage, from the true middle pose."""
    body = load_default_body()
    scene, stage = moving_scene(body, size_px=48, frames=frames), Stage(size_px=48, iterations=iterations)
    config = FitConfig(stages=(stage,), subframes=3, texture_px=16, settle=settle, **options)
    return fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior()).history["total"]


def test_a_stage_goes_on_where_the_last_one_ended() -> None:
    """A fresh optimiser would leave it: its first steps are as large as its rate, wherever the gradient is small."""
    stage = Stage(size_px=48, iterations=25, learning_rate=0.003)
    losses = run(stage, stage)[0].history["total"]
    assert losses[24] < 0.7 * losses[0]
    assert max(losses[25:]) <= 1.01 * min(losses[:25])


def test_what_was_asked_before_the_descent_is_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gradients that somebody left when it begins."""
    losses, fit_skeleton = first_losses(1, 3, 5), schedule.fit_skeleton

    def fit_and_leave(variables: Variables, *others: Any) -> None:
        fit_skeleton(variables, *others)
        for leaf in variables.leaves():
            leaf.grad = torch.ones_like(leaf)

    monkeypatch.setattr(schedule, "fit_skeleton", fit_and_leave)
    assert first_losses(1, 3, 5) == losses


@pytest.mark.parametrize("frames", [1, 2])
def test_pictures_that_share_a_texture_count_more_at_full_size(frames: int) -> None:
    """But not in the search for directions afterwards: their odds were measured without."""
    body = load_default_body()
    scene = moving_scene(body, size_px=48, frames=frames)
    coarse, whole = Stage(size_px=32, iterations=3), Stage(size_px=48, iterations=3)

    def result(weight: float, factor: float, *stages: Stage) -> FitResult:
        config = FitConfig(
            stages=stages,
            subframes=3,
            texture_px=16,
            multi_frame=MultiFrame(image=factor),
            weights=Weights(image=weight, boundary=0),
            directions=DirectionsConfig(search=True, limbs=False, refits=0),
        )
        return fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior())

    plain, more = (result(2, factor, coarse, whole) for factor in (1, 5))
    losses = plain.history["total"], more.history["total"]
    assert losses[0][:3] == losses[1][:3]
    assert (losses[0][3] == losses[1][3]) == (frames == 1)
    assert result(2, 5, whole, whole).history == result(2 if frames == 1 else 10, 1, whole, whole).history
    for one in (plain, more):
        assert one.alternatives is not None
        scores = one.alternatives.scores
        assert scores["loss"] == pytest.approx(2 * scores["image"] + scores["matte"], rel=1e-5)


@pytest.mark.parametrize("frames", [1, 2])
def test_the_height_of_several_frames_has_a_factor_of_its_own(frames: int) -> None:
    def losses(height: float, factor: float) -> list[float]:
        return first_losses(frames, 2, 2, weights=Weights(height=height), multi_frame=MultiFrame(height=factor))

    more = losses(0.5, 3)
    assert more == losses(0.5 if frames == 1 else 1.5, 1)
    assert (more == losses(0.5, 1)) == (frames == 1)


def test_a_stage_without_gain_ends_by_its_patience() -> None:
    still, moving = (Stage(size_px=48, iterations=20, learning_rate=rate) for rate in (1e-9, 0.003))
    result, told = run(still, moving, patience=4)
    assert len(result.history["total"]) == len(told) < 40
    assert told[4] == (5, 40)  # the first loss is a gain, then four are none
    assert told[5] == (21, 40)
    assert result.history["total"][result.best_iteration] == min(result.history["total"])
    assert len(run(still)[0].history["total"]) == 20  # without patience a stage takes its time


def test_the_fits_own_picture_is_looked_at_before_every_stage_of_full_size_but_a_first() -> None:
    body, coarse, stage = load_default_body(), Stage(size_px=32, iterations=3), Stage(size_px=48, iterations=3)
    scene = moving_scene(body, size_px=48)
    weights = Weights(joints=3, height=0.04)

    def losses(compare: float, *stages: Stage) -> list[float]:
        config = FitConfig(stages=stages, subframes=3, texture_px=16, origin=0.5, weights=weights, compare=compare)
        return fit(scene.observation, simulated(scene), body, config, 0, AnatomicalPrior()).history["total"]

    def first_change(*stages: Stage) -> int | None:
        both = zip(losses(0, *stages), losses(0.75, *stages), strict=True)
        return next((number for number, (without, with_it) in enumerate(both) if without != with_it), None)

    assert first_change(stage, coarse, coarse, stage) == 9
    assert first_change(coarse, stage, stage) == 3
    assert first_change(stage, stage) == 3
    assert first_change(stage) is None


def test_before_every_such_stage_the_mattes_are_found_again_from_the_first_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    body, coarse, stage = load_default_body(), Stage(size_px=32, iterations=3), Stage(size_px=48, iterations=3)
    scene = moving_scene(body, size_px=48)
    given, found, ends = [], [], []
    refine_mattes, run_stages = refine.refine_mattes, stages.run_stages

    def kept_mattes(blurred: torch.Tensor, initial: refine.InitialEvidence) -> Observation:
        again = refine_mattes(blurred, initial)
        given.append(initial.observation.mattes)
        found.append(again.mattes)
        return again

    def kept_result(*told: Any) -> stages.StagesResult:
        ends.append(run_stages(*told))
        return ends[-1]

    def losses(again: bool) -> list[float]:
        schedule = (stage, coarse, stage, stage)
        config = FitConfig(stages=schedule, subframes=3, texture_px=16, origin=0.5, matte_again=again)
        return fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior()).history["total"]

    monkeypatch.setattr(refine, "refine_mattes", kept_mattes)
    monkeypatch.setattr(schedule, "run_stages", kept_result)
    without = losses(False)
    assert not given
    both = zip(without, losses(True), strict=True)
    assert next(number for number, (one, other) in enumerate(both) if one != other) == 6
    assert len(given) == 2
    assert torch.equal(given[0], given[1])
    assert not torch.equal(found[1], given[1])
    assert torch.equal(ends[-1].observation.mattes, found[-1])  # later steps use them, too
    assert ends[-1].observation.mattes.shape == ends[0].observation.mattes.shape


@pytest.mark.parametrize("frames", [1, 2])
def test_a_fit_returns_the_mattes_of_its_last_stage(frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """As large as the frames: the window's mattes in place, the initial ones around it."""
    body, stage = load_default_body(), Stage(size_px=48, iterations=2)
    seen, ends = moving_scene(body, size_px=64, frames=frames).observation, []
    scene = moving_scene(body, size_px=64, frames=frames)
    run_stages = stages.run_stages

    def kept_result(*told: Any) -> stages.StagesResult:
        ends.append(run_stages(*told))
        return ends[-1]

    def mattes(again: bool) -> torch.Tensor:
        config = FitConfig(stages=(stage, stage), subframes=3, texture_px=16, origin=0.5, matte_again=again)
        return fit(seen, scene.middle, body, config, 0, AnatomicalPrior()).mattes

    monkeypatch.setattr(schedule, "run_stages", kept_result)
    assert torch.equal(mattes(False), seen.mattes)
    refined = mattes(True)
    assert not torch.equal(refined, seen.mattes)
    whole = replace(seen, mattes=refined).cropped(*seen.region())
    inside = replace(seen, mattes=torch.ones_like(refined)).cropped(*seen.region()).mattes > 0
    assert torch.equal(whole.mattes[inside], ends[-1].observation.mattes[inside])


def test_every_network_runs_in_a_timed_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint, lifting, fusion and matting networks run in the evidence and refine stages and nowhere else.

    All refine before every stage of full size but a first; the lifting network knows the fit's depths at any size.
    """
    body, coarse, stage = load_default_body(), Stage(size_px=32, iterations=1), Stage(size_px=48, iterations=2)
    scene, told, calls = moving_scene(body, size_px=48), [""], []
    networks = {
        "joint": (joint_evidence, "shipped_joint_network"),
        "lifting": (lifting_network, "shipped_lifting_network"),
        "fusion": (depth_fusion, "shipped_depth_fusion"),
        "matting": (network, "shipped_third"),
    }

    def watch(name: str, load: Callable[[], Any]) -> Callable[[], Any]:
        def loaded() -> Any:
            calls.append((told[-1].split(",")[0], name))
            return load()

        return loaded

    for name, (module, function) in networks.items():
        monkeypatch.setattr(module, function, watch(name, getattr(module, function)))
    best = preset("best").fit
    config = best.model_copy(
        update={"stages": (stage, coarse, stage, stage), "subframes": 3, "texture_px": 16, "settle": 2}
    )
    result = fit(
        scene.observation,
        simulated(scene),
        body,
        config,
        0,
        AnatomicalPrior(),
        on_progress=lambda done, total, note: told.append(note),
    )
    refined = {(when, name) for when in ("refine 3", "refine 4") for name in networks}
    assert set(calls) == {("evidence", "joint"), ("refine 2", "lifting"), *refined}
    later = [f"{kind}_{number}" for number in (2, 3, 4) for kind in ("refine", "stage")]
    names = ["evidence", "warm_up", "stage_1", *later, "directions"]
    assert list(result.stage_seconds) == names
    assert all(seconds > 0 for seconds in result.stage_seconds.values())
    assert 0.5 * result.seconds < sum(result.stage_seconds.values()) <= result.seconds


def test_radii_are_told_by_the_mattes_from_before_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A matte that was found beside the fit agrees with it in its errors: radii would be too narrow."""
    body, told = load_default_body(), []

    def joint_features(*given: Any, coarse: Objective, **more: Any) -> dict[str, Float[Array, "R 24"]]:
        told.append(coarse.observation.mattes)
        return features.joint_features(*given, coarse=coarse, **more)

    scene = moving_scene(body, size_px=64, frames=2, instants=5)
    stage, search = Stage(size_px=48, iterations=2), DirectionsConfig(size_px=64)
    config = FitConfig(stages=(stage, stage), subframes=3, texture_px=16, matte_again=True, directions=search)
    person = Identity(scene.middle[0].betas, torch.full((16, 16, 3), 0.4))
    monkeypatch.setattr(schedule, "joint_features", joint_features)
    fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior(), identity=person)
    seen = scene.observation
    assert torch.equal(told[0], seen.cropped(*seen.region()).resized(64).mattes)


@pytest.mark.parametrize("frames", [1, 2])
def test_frames_share_what_holds_their_motion(frames: int) -> None:
    """With w_C shared the motion is held by as much as with a part of it for each, while the skeleton settles, too."""

    def losses(motion: float, shared: bool) -> list[float]:
        return first_losses(frames, 3, 3, weights=Weights(motion=motion), motion_shared=shared)

    shared = losses(0.5, True)
    assert shared == losses(0.5 / frames, False)
    assert (shared == losses(0.5, False)) == (frames == 1)


def test_small_images_need_fewer_subframes() -> None:
    """As dense in pixels as at the last stage's size, but at least four, or all where there are fewer."""

    def counts(subframes: int) -> list[int]:
        config = preset("best").fit.model_copy(update={"subframes": subframes})
        return [stages.subframes_at(size_px, config) for size_px in (64, 128, 192, 256)]

    assert counts(8) == [4, 4, 6, 8]
    assert counts(17) == [5, 9, 13, 17]
    assert counts(3) == [3, 3, 3, 3]


def test_a_result_has_all_subframes_whatever_its_stages_rendered() -> None:
    small, large = Stage(size_px=16, iterations=2), Stage(size_px=48, iterations=2)
    scene, body = moving_scene(load_default_body(), size_px=48), load_default_body()

    def fitted(*stages: Stage) -> FitResult:
        config = FitConfig(stages=stages, subframes=9, texture_px=16, directions=DirectionsConfig(search=True))
        return fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior())

    found = fitted(small, large)
    assert found.motion.poses.shape[0] == 9
    assert found.alternatives is not None
    assert found.alternatives.poses.shape[1] == 9
    alike = fitted(small.model_copy(update={"size_px": 48}), large)
    assert found.history["total"][0] != alike.history["total"][0]


def test_several_frames_take_more_and_smaller_steps() -> None:
    """Images that share a texture converge further: with the steps of single ones pairs were 3 mm worse."""
    given = FitConfig(
        stages=(Stage(size_px=32, iterations=4, learning_rate=0.03), Stage(size_px=48, iterations=5, cosine=True)),
        multi_frame=MultiFrame(iterations=1.5, learning_rate=0.5),
    )
    assert stages.for_frames(given, 1) == given
    first, last = stages.for_frames(given, 2).stages
    assert (first.iterations, first.learning_rate) == (6, 0.015)
    assert (last.iterations, last.learning_rate, last.cosine) == (8, 0.005, True)

    def iterations(frames: int) -> int:
        scene = moving_scene(load_default_body(), size_px=48, frames=frames)
        config = given.model_copy(update={"subframes": 3, "texture_px": 16})
        return len(
            fit(scene.observation, scene.middle, load_default_body(), config, 0, AnatomicalPrior()).history["total"]
        )

    assert (iterations(1), iterations(2)) == (9, 14)
