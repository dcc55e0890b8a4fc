"""A caller's own matte, start, prior and loss terms change the fit, and are checked."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import hfb
from hfb.motion.static_pose import load_first_body
from tests.api.conftest import TINY
from tests.orchestration import Problem

QUICK: dict[str, Any] = TINY | {
    "directions": {"search": False},
    "settle": 0,
    "stages": [{"size_px": 32, "iterations": 8}],
}


def run(problem: Problem, **given: Any) -> hfb.Result:
    """A fit from the true middle pose: looking for a start takes longer than all the rest."""
    start = load_first_body(problem.first_body)
    return hfb.fit(problem.frame, problem.background, **QUICK | {"init": lambda *_: start} | given)


@pytest.fixture(scope="module")
def plain(problem: Problem) -> hfb.Result:
    return run(problem)


def test_a_term_pulls(problem: Problem, plain: hfb.Result, tmp_path: Path) -> None:
    """The larger the weight, the nearer the left wrist is to where the term wants it; history and figures name it."""
    aim = torch.tensor([0.0, -0.5, 4.0])

    def wrist_at_aim(seen: hfb.TermInputs) -> torch.Tensor:
        return (seen.joints[:, :, 20] - aim).square().sum(-1).mean()

    def distance(result: hfb.Result) -> float:
        return float(np.linalg.norm(result.joints[:, 20] - aim.numpy(), axis=-1).mean())

    zero, light, heavy = (run(problem, extra_terms={"wrist": (wrist_at_aim, weight)}) for weight in (0.0, 10.0, 1000.0))
    assert np.array_equal(zero.joints, plain.joints)
    assert distance(heavy) < distance(light) < distance(plain) - 1e-4
    folder = heavy.save(tmp_path / "saved")
    assert "wrist" in json.loads((folder / "curves.json").read_text())["losses"]
    assert hfb.load_result(folder).facts["own_parts"] == ["init", "wrist x 1000"]
    assert hfb.load_result(folder).report().is_file()


def test_a_term_gets_the_variables(problem: Problem) -> None:
    seen: list[hfb.TermInputs] = []

    def look(inputs: hfb.TermInputs) -> torch.Tensor:
        seen.append(inputs)
        return inputs.betas.square().mean()

    given = {"extra_terms": {"mine": look}, "settle": 1, "directions": TINY["directions"]}
    result = hfb.fit([problem.frame] * 2, problem.background, **QUICK | given)
    for one in seen:
        assert one.rotations.shape == (2, 2, 24, 3, 3)
        assert one.joints.shape == (2, 2, 24, 3)
        by_hand = one.shaped.joints_of(one.rotations.flatten(0, 1), one.translations.flatten(0, 1))
        assert torch.allclose(by_hand.reshape(2, 2, 24, 3), one.joints, atol=1e-5)
    assert {one.observation.mattes.shape[0] for one in seen} == {2}
    assert result.alternatives is not None
    assert "mine" in result.alternatives.scores


def test_an_own_prior(problem: Problem, plain: hfb.Result) -> None:
    """A prior that wants straight limbs straightens them."""

    class Straight:
        def __call__(self, axis_angle: torch.Tensor) -> torch.Tensor:
            return axis_angle.square().sum((1, 2))

    straight = run(problem, prior=Straight(), weights={"pose": 10.0})
    assert np.abs(straight.poses[:, 3:]).mean() < np.abs(plain.poses[:, 3:]).mean() - 1e-3
    assert isinstance(Straight(), hfb.PosePrior)


def test_an_own_matte(problem: Problem, plain: hfb.Result) -> None:
    """The fit uses it, and it is what the result shows."""
    alpha = np.zeros((96, 96), np.float32)
    alpha[30:70, 40:60] = 1
    result = run(problem, matting=lambda frame, plate: alpha)
    assert np.array_equal(result.mattes[0], alpha)
    assert not np.array_equal(result.joints, plain.joints)


def test_progress_is_told(problem: Problem) -> None:
    told: list[tuple[str, int, int | None]] = []
    run(problem, on_progress=lambda *step: told.append(step))
    assert {"pictures", "matte", "first body", "fit"} <= {label for label, _, _ in told}
    assert [done for label, done, total in told if label == "fit" and total][-1] == 8


def test_an_own_start(problem: Problem) -> None:
    start = load_first_body(problem.first_body)
    shifted = hfb.FirstBody(start.pose, start.translation + torch.tensor([0.3, 0.0, 0.0]), start.betas, "mine")
    result = run(problem, init=lambda *_: shifted, stages=[{"size_px": 32, "iterations": 0}])
    assert np.abs(result.trans[:, 0].mean() - float(shifted.translation[0])) < 0.05
    assert result.facts["first_bodies"] == ["mine"]
    found = hfb.first_body(problem.frame, problem.background, init=None, matting=lambda *_: plain_matte(problem))
    assert found.source == "matte" or found.source.startswith("media")


def plain_matte(problem: Problem) -> np.ndarray:
    return hfb.matte(problem.frame, problem.background)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"extra_terms": {"image": lambda seen: seen.betas.sum()}}, "has the name of a term of hfb"),
        ({"extra_terms": {"mine": (lambda seen: seen.betas.sum(), -1.0)}}, "a weight >= 0"),
        ({"extra_terms": {"mine": lambda seen: seen.betas}}, r"returned a tensor of shape \(10,\): return a scalar"),
        ({"extra_terms": {"mine": lambda seen: 1.0}}, "returned float: return a scalar tensor"),
        ({"extra_terms": {"mine": lambda seen: seen.betas.sum() * torch.nan}}, r"\['mine'\]: check terms and priors"),
        ({"extra_terms": {"mine": lambda seen: seen.betas.sum()}, "rasterizer": "warp"}, "on the processor only"),
        (
            {"prior": lambda poses: poses.sum()},
            r"the pose prior returned \(\) for 2 poses",
        ),
        ({"matting": lambda frame, plate: frame[:4, :4, 0]}, r"the matting returned the shape \(4, 4\)"),
        ({"matting": lambda frame, plate: frame[..., 0] * 0 + 2}, "the matting returned values outside"),
        ({"init": lambda *_: None}, "the start returned a NoneType"),
        (
            {"init": lambda *_: hfb.FirstBody(*(torch.full(n, torch.nan) for n in ((24, 3), (3,), (10,))), "x")},
            "finite",
        ),
    ],
)
def test_wrong_parts(problem: Problem, given: dict[str, Any], says: str) -> None:
    with pytest.raises(hfb.InputError, match=says):
        run(problem, **given)
