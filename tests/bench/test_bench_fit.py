"""How long the parts of a fit take: `make bench`. Never a bound: figures of one run compare with each other."""

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import Stage, preset
from hfb.fit.loop import fit
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rotations import axis_angle_to_matrix
from tests.scenes import moving_scene

pytestmark = pytest.mark.benchmark(min_rounds=3)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def test_pose_prior_8_subframes(benchmark) -> None:
    prior = AnatomicalPrior()
    poses = (0.1 * torch.randn(8, 23, 3, generator=torch.Generator().manual_seed(0))).requires_grad_()
    benchmark(lambda: prior(poses).sum().backward())


def test_skinning_8_bodies(benchmark) -> None:
    body = load_default_body()
    poses = (0.3 * torch.randn(8, 24, 3, generator=torch.Generator().manual_seed(0))).requires_grad_()
    betas = torch.zeros(10, requires_grad=True)

    def forward_and_backward() -> None:
        posed = body.shape(betas).pose(axis_angle_to_matrix(poses), torch.zeros(8, 3))
        posed.vertices.sum().backward()

    benchmark(forward_and_backward)


def test_twenty_iterations_at_256_px(benchmark) -> None:
    body = load_default_body()
    scene = moving_scene(body, size_px=256)
    config = preset("best").fit.model_copy(update={"stages": (Stage(size_px=256, iterations=20),)})
    benchmark.pedantic(
        lambda: fit(scene.observation, scene.middle, body, config, 0, AnatomicalPrior()), rounds=3, warmup_rounds=1
    )
