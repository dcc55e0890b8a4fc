"""Many fits as one problem: the terms and gradients of each, and the fits themselves, are those of one fit alone."""

from collections.abc import Sequence

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import FitConfig, Stage, Weights, preset
from hfb.fit.loop import FitResult, Problem, fit_all
from hfb.fit.variables import Variables, start_variables
from hfb.losses.texture import texel_neighbours
from hfb.objective import Objective
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.mixture import shipped_mixture
from hfb.priors.motion_prior import load_motion_prior
from hfb.priors.pose import PosePrior
from hfb.render.rasterizer import make_rasterizer
from hfb.render.texture import texel_faces
from hfb.rotations import axis_angle_to_matrix
from tests.bench.jobs import with_pose_blend_shapes
from tests.fit.scenes import true_evidence
from tests.scenes import Scene, moving_scene

pytest.importorskip("warp", reason="the Warp kernels need warp-lang (pip install 'hfb[cuda]')")
from hfb.fit.together import Leaves, Together
from hfb.render.cuda import WarpRasterizer

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
        scene.observation, body, make_rasterizer(), pose_prior, weights, 4, first, texels, matte_scales=3,
        image_scales=2, evidence=true_evidence(scene), across=0.2, motion_prior=load_motion_prior(None),
    )  # fmt: skip


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
    leaves = Leaves.of(variables, rasterizer.device)
    group = Together(objectives, variables, rasterizer)
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


def fits(device: str, config: FitConfig, seen: Sequence[Scene]) -> list[FitResult]:
    config = config.model_copy(update={"rasterizer": device, "texture_px": 8})
    problems = [Problem(scene.observation, scene.middle) for scene in seen]
    return fit_all(problems, load_default_body(), config, 0, AnatomicalPrior())


SHORT = BEST.model_copy(
    update={
        "settle": 4,
        "stages": (Stage(size_px=32, iterations=5), Stage(size_px=40, iterations=6, cosine=True)),
        "directions": BEST.directions.model_copy(update={"search": False}),
    }
)


@pytest.mark.parametrize("device", DEVICES)
def test_no_fit_knows_of_the_others(device: str) -> None:
    seen = scenes(1)
    for one, other in zip(fits(device, SHORT, seen), fits(device, SHORT, seen[:1] + seen[2:]), strict=False):
        assert one.history["total"] == pytest.approx(other.history["total"], rel=1e-3)
        break


@pytest.mark.parametrize("device", DEVICES)
def test_every_run_has_the_same_bits(device: str) -> None:
    first, again = (fits(device, SHORT, scenes(2)) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        assert one.history == other.history
        assert torch.equal(one.trajectory.rotation, other.trajectory.rotation)
        assert torch.equal(one.texture, other.texture)
