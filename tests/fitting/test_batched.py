"""Many fits as one problem: the terms and gradients of each, and the fits themselves, are those of one fit alone."""

import dataclasses
from collections.abc import Sequence

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import FitConfig, Stage, Weights, preset
from hfb.errors import InputError
from hfb.fitting.clip.windows import ClipWindow, WindowScene, fit_windows
from hfb.fitting.fit import FitResult, Problem, fit_all
from hfb.fitting.identity import Identity
from hfb.fitting.variables import Variables, start_variables
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.objective.objective import Objective
from hfb.objective.texture import texel_neighbours
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.mixture import shipped_mixture
from hfb.priors.motion_prior import load_motion_prior
from hfb.priors.pose import PosePrior
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.texels import texel_faces
from tests.bench.jobs import with_pose_blend_shapes
from tests.fitting.scenes import true_evidence
from tests.scenes import Scene, moving_scene

pytest.importorskip("warp", reason="the Warp kernels need warp-lang (pip install '.[cuda]')")
from hfb.fitting.batched_objective import BatchedObjective, BatchedVariables
from hfb.rendering.warp import WarpRasterizer

DEVICES = ["warp", *(["cuda"] if torch.cuda.is_available() else [])]
BEST = preset("best").fit
EVERY_TERM = BEST.weights.model_copy(update={"texture": 0.1, "background": 0.01, "adversarial": 0.5})


def rasterizer_on(device: str) -> WarpRasterizer:
    return WarpRasterizer("cuda" if device == "cuda" else "cpu")


def scenes(frames: int, count: int = 3) -> list[Scene]:
    body = load_default_body()
    return [moving_scene(body, size_px=40, frames=frames, step_m=0.1 + 0.1 * number) for number in range(count)]


def objective_of(scene: Scene, weights: Weights, pose_prior: PosePrior, body_blends: bool) -> Objective:
    body = load_default_body()
    body = with_pose_blend_shapes(body) if body_blends else body
    first = axis_angle_to_matrix(torch.stack([one.pose for one in scene.middle]))
    texels = texel_neighbours(body.mesh, body.template, texel_faces(body.mesh, 8))
    return Objective(
        scene.observation,
        body,
        make_rasterizer(),
        pose_prior,
        weights,
        4,
        first,
        texels,
        matte_scales=3,
        image_scales=2,
        evidence=true_evidence(scene),
        xy_weight=0.2,
        motion_prior=load_motion_prior(None),
    )


def somewhere(scene: Scene, seed: int) -> Variables:
    """A start, disturbed, so that no term is at its minimum or at a kink."""
    generator = torch.Generator().manual_seed(seed)
    config = BEST.model_copy(update={"texture_px": 8})
    found = start_variables(scene.middle, scene.observation, config, generator)
    with torch.no_grad():
        for leaf in (found.trajectory.rotation, found.trajectory.translation, found.betas, found.texture):
            leaf += 0.03 * torch.randn(leaf.shape, generator=generator)
    return found


def alone(objective: Objective, variables: Variables) -> tuple[dict[str, float], list[torch.Tensor]]:
    terms = objective.terms(variables.motion(objective.body), variables.betas, variables.texture)
    objective.total(terms).backward()
    leaves = variables.trajectory.rotation, variables.trajectory.translation, variables.betas, variables.texture
    return {name: value.item() for name, value in terms.items()}, [
        leaf.grad for leaf in leaves if leaf.grad is not None
    ]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("frames", "weights", "prior", "blends"),
    [
        (1, EVERY_TERM, AnatomicalPrior(), False),
        (2, EVERY_TERM, AnatomicalPrior(), True),
        (1, BEST.weights, shipped_mixture(), True),
        (2, Weights(image=0, matte=1), AnatomicalPrior(), False),
    ],
    ids=["every term", "every term of two frames", "best, a mixture", "the outline alone"],
)
def test_terms_and_gradients_are_those_of_each_fit(
    frames: int, weights: Weights, prior: PosePrior, blends: bool, device: str
) -> None:
    seen = scenes(frames)
    objectives = [objective_of(scene, weights, prior, blends) for scene in seen]
    variables = [somewhere(scene, seed) for seed, scene in enumerate(seen)]
    rasterizer = rasterizer_on(device)
    leaves = BatchedVariables.stack(variables, rasterizer.device)
    group = BatchedObjective(objectives, variables, rasterizer)
    terms = group.terms(leaves)
    group.template.total(terms).sum().backward()
    for number, (objective, mine) in enumerate(zip(objectives, variables, strict=True)):
        expected, gradients = alone(objective, mine)
        assert {name: value[number].item() for name, value in terms.items()} == pytest.approx(
            expected, rel=1e-3, abs=1e-5
        )
        found = [leaf.grad for leaf in (leaves.rotation, leaves.translation, leaves.betas, leaves.texture)]
        for one, other in zip([each[number].cpu() for each in found if each is not None], gradients, strict=True):
            assert (one - other).norm() <= 2e-3 * other.norm()


def fits(
    device: str, config: FitConfig, seen: Sequence[Scene], room: int = 1, prior: PosePrior | None = None
) -> list[FitResult]:
    config = config.model_copy(update={"rasterizer": device, "texture_px": 8})
    problems = [Problem(scene.observation, scene.middle) for scene in seen]
    return fit_all(problems, load_default_body(), config, 0, prior or AnatomicalPrior(), batch_size=room)


SHORT = BEST.model_copy(
    update={
        "settle": 2,
        "stages": (Stage(size_px=32, iterations=3), Stage(size_px=40, iterations=3, cosine=True)),
        "directions": BEST.directions.model_copy(update={"search": False}),
    }
)


@pytest.mark.parametrize("device", DEVICES)
def test_no_fit_knows_of_the_others(device: str) -> None:
    """In a room of one size, on a GPU to the bit: a processor computes the last few of many numbers otherwise."""
    first, second, third = fits(device, SHORT, scenes(1), room=3)
    (other,) = fits(device, SHORT, scenes(1)[1:2], room=3)
    last_bits = 1e-4 if device == "warp" else 0.0
    assert second.history["total"] == pytest.approx(other.history["total"], rel=last_bits, abs=0.0)
    assert torch.allclose(second.trajectory.rotation, other.trajectory.rotation, rtol=last_bits, atol=last_bits)
    assert torch.allclose(second.texture, other.texture, rtol=last_bits, atol=last_bits)
    assert len({first.loss, second.loss, third.loss}) == 3


@pytest.mark.parametrize("device", DEVICES)
def test_fits_are_those_of_the_processor(device: str) -> None:
    """Of frames whose window is a square already. What differs in the last bits, Adam enlarges from step to step.

    The second of three frames begins beside the way between the others: two frames begin where they meet exactly, which
    is the kink of the boundary's L1, and there the last bits say which sign the gradient has.
    """
    stage = Stage(size_px=40, iterations=8, learning_rate=0.002, cosine=True)
    config = SHORT.model_copy(update={"settle": 0, "stages": (stage,), "adam_epsilon": 1e-2})
    seen = [squared(beside_its_way(scene)) for scene in scenes(3, count=2)]
    for one, other in zip(fits(device, config, seen), fits("cpu", config, seen), strict=True):
        assert one.history["boundary"][0] > 0.05
        assert one.history["total"] == pytest.approx(other.history["total"], rel=1e-5)
        assert one.loss < 0.98 * one.history["total"][0]
        assert one.motion.joints == pytest.approx(other.motion.joints, abs=5e-3)


@pytest.mark.parametrize("device", DEVICES)
def test_settling_is_that_of_the_processor(device: str) -> None:
    config = SHORT.model_copy(update={"settle": 6, "stages": (Stage(size_px=40, iterations=1),)})
    seen = [squared(scene) for scene in scenes(1, count=2)]
    for one, other in zip(fits(device, config, seen), fits("cpu", config, seen), strict=True):
        assert one.history["total"] == pytest.approx(other.history["total"], rel=1e-3)


def beside_its_way(scene: Scene) -> Scene:
    """With a second of three first bodies that is off, by some centimetres and by some degrees in every joint."""
    first, second, third = scene.middle
    generator = torch.Generator().manual_seed(4)
    pose, translation = (
        one + 0.05 * torch.randn(one.shape, generator=generator) for one in (second.pose, second.translation)
    )
    return dataclasses.replace(
        scene, middle=[first, dataclasses.replace(second, pose=pose, translation=translation), third]
    )


def squared(scene: Scene) -> Scene:
    """With specks in the matte that make the window around it the whole picture, which is a square."""
    mattes = scene.observation.mattes.clone()
    mattes[:, 0, 0] = mattes[:, -1, -1] = 0.06
    return dataclasses.replace(scene, observation=dataclasses.replace(scene.observation, mattes=mattes))


@pytest.mark.parametrize("device", DEVICES)
def test_patience_ends_each_fit_by_itself(device: str) -> None:
    config = SHORT.model_copy(
        update={"settle": 0, "patience": 2, "stages": (Stage(size_px=24, iterations=40, learning_rate=0.1),)}
    )
    for one, other in zip(fits(device, config, scenes(1)), fits(device, config, scenes(1)[::-1])[::-1], strict=True):
        length = len(one.history["total"])
        assert 2 < length < 40
        assert one.best_iteration < length
        assert one.loss == min(one.history["total"])
        assert length == len(other.history["total"])


@pytest.mark.parametrize("device", DEVICES)
def test_a_broken_loss_is_named(device: str) -> None:
    class Broken:
        def __call__(self, axis_angle: torch.Tensor) -> torch.Tensor:
            return axis_angle.sum((1, 2)) * torch.nan

    with pytest.raises(FloatingPointError, match=r"iteration 0: \['pose'\]"):
        fits(device, SHORT.model_copy(update={"settle": 0}), scenes(1), prior=Broken())


def test_what_cannot_be_one_problem_is_said() -> None:
    with pytest.raises(ValueError, match=r"several kinds .*\(1, .*\(2, "):
        fits("warp", SHORT, [*scenes(1, count=1), *scenes(2, count=1)])


def test_a_device_without_memory_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """As torch says it, where the kernels' memory is asked for."""

    def full(*_: object, **__: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB")

    monkeypatch.setattr(WarpRasterizer, "render_pictures", full)
    with pytest.raises(InputError, match=r"too small for 3 fits at once: give a smaller --fit\.batch-size"):
        fits("warp", SHORT, scenes(1))


def test_windows_together_are_the_windows_alone() -> None:
    body, person = load_default_body(), Identity(torch.zeros(10), torch.full((8, 8, 3), 0.4))
    config = SHORT.model_copy(update={"rasterizer": "warp", "texture_px": 8, "batch_size": 2})
    slower = [
        dataclasses.replace(one, observation=dataclasses.replace(one.observation, interval_s=0.04))
        for one in scenes(1, count=1)
    ]
    several = [
        WindowScene(ClipWindow(tuple(range(at, at + len(scene.middle))), 0), scene.observation, scene.middle, person)
        for at, scene in zip((0, 2, 4, 6, 7), [*scenes(2), *scenes(1, count=1), *slower], strict=True)
    ]
    together = fit_windows(several, body, config, seed=0, pose_prior=AnatomicalPrior())
    assert [one.frames for one in together] == [(0, 1), (2, 3), (4, 5), (6,), (7,)]
    for scene, found in zip(several, together, strict=True):
        (alone,) = fit_windows([scene], body, config, seed=0, pose_prior=AnatomicalPrior())
        assert found.history["total"] == pytest.approx(alone.history["total"], rel=1e-4)
        assert torch.allclose(found.trajectory.rotation, alone.trajectory.rotation, rtol=1e-4, atol=1e-4)
        assert found.texture is None
        assert found.joint_radius_mm == pytest.approx(alone.joint_radius_mm, rel=1e-3)


@pytest.mark.parametrize("device", DEVICES)
def test_every_run_has_the_same_bits(device: str) -> None:
    first, again = (fits(device, SHORT, scenes(2)) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        assert one.loss == other.loss
        assert torch.equal(one.trajectory.rotation, other.trajectory.rotation)
        assert torch.equal(one.texture, other.texture)
