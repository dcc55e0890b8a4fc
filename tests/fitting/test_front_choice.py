"""The front that a fit keeps: a start that faces the wrong way is turned, a right one stays."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import DirectionsConfig, InitConfig, Stage, preset
from hfb.datasets.example import write_example
from hfb.datasets.truth import Truth, load_truth
from hfb.fitting.alternatives import load_alternatives, save_alternatives
from hfb.fitting.fit import FitResult, fit
from hfb.fitting.front_choice import FitLoss, front_log_odds, loss_log_ratio, shipped_front_weights
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.fronts import find_other_front, mirrored_in_depth
from hfb.initialization.initializer import make_initializer
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.matting.methods import make_matting
from hfb.motion.sampled import SampledMotion
from hfb.motion.static_pose import FirstBody, OtherFront
from hfb.photometry import srgb_to_linear
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.observation import Observation

BODY = load_default_body()
SHORT = preset("best").fit.model_copy(
    update={
        "directions": DirectionsConfig(search=True, limbs=False, refits=0),
        "stages": (Stage(size_px=64, iterations=40), Stage(size_px=96, iterations=20, cosine=True)),
    }
)


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> tuple[Observation, FirstBody, Truth]:
    """The embedded example, its matte, and the first body that hfb finds by it."""
    paths = write_example(tmp_path_factory.mktemp("example"), 0)
    truth = load_truth(paths.truth)
    frame, plate = (
        srgb_to_linear(read_picture_srgb(path)).astype(np.float32) for path in (paths.frame, paths.background)
    )
    matte = make_matting(preset("best").matting)(frame, plate)
    camera = PinholeCamera.from_matrix(torch.from_numpy(truth.motion.K), *matte.shape)
    exposure_s = float(truth.motion.times_s[-1])
    frames, mattes = torch.from_numpy(frame)[None], torch.from_numpy(matte)[None]
    seen = Observation(frames, torch.from_numpy(plate), mattes, camera, exposure_s, exposure_s)
    found = make_initializer(InitConfig(method="matte"))(frame, plate, matte, camera, BODY)
    return seen, found, truth


def fitted(seen: Observation, first: FirstBody, other: OtherFront) -> FitResult:
    return fit(seen, [first], BODY, SHORT, 0, AnatomicalPrior(), other_front=other)


def chest(motion: SampledMotion) -> np.ndarray:
    """The chest's normal at mid-exposure."""
    joints = motion.joints[len(motion.joints) // 2]
    normal = np.cross(joints[16] - joints[17], joints[16] + joints[17] - joints[1] - joints[2])
    return normal / np.linalg.norm(normal)


def test_a_start_that_faces_the_wrong_way_is_turned(
    example: tuple[Observation, FirstBody, Truth], tmp_path: Path
) -> None:
    seen, found, truth = example
    turned = mirrored_in_depth(found)
    other = find_other_front(seen, [turned], BODY)
    assert other is not None
    assert other.doubt < 0
    result = fitted(seen, turned, other)
    assert result.front is not None
    assert result.front.mirrored
    assert result.front.probability > 0.5
    as_left = SHORT.model_copy(update={"directions": DirectionsConfig()})  # its directions are not searched
    alone = fit(seen, [turned], BODY, as_left, 0, AnatomicalPrior())
    assert chest(result.motion) @ chest(truth.motion) > 0.9
    assert chest(alone.motion) @ chest(truth.motion) < -0.5
    assert "other_front" in result.stage_seconds

    assert result.alternatives is not None
    save_alternatives(tmp_path / "alternatives.npz", result.alternatives, result.joint_features)
    read, _ = load_alternatives(tmp_path / "alternatives.npz")
    assert read.other_front is not None
    np.testing.assert_allclose(read.other_front.joints, alone.motion.joints, atol=1e-5)
    assert read.other_front.probability == pytest.approx(1 - result.front.probability)


def test_the_kept_fit_is_the_one_that_it_would_be_alone(example: tuple[Observation, FirstBody, Truth]) -> None:
    seen, found, _ = example
    both = fitted(seen, found, OtherFront((mirrored_in_depth(found),), doubt=0.8))
    alone = fit(seen, [found], BODY, SHORT, 0, AnatomicalPrior())
    assert both.front is not None
    assert not both.front.mirrored
    np.testing.assert_array_equal(both.motion.poses, alone.motion.poses)
    assert torch.equal(both.texture, alone.texture)


@pytest.mark.parametrize("to_the_end", [False, True])
def test_a_front_that_is_clearly_wrong_is_left_at_the_first_size(
    example: tuple[Observation, FirstBody, Truth], to_the_end: bool
) -> None:
    seen, found, _ = example
    first, told = dataclasses.replace(found, source="mediapipe"), []
    result = fit(
        seen, [first], BODY, SHORT, 0, AnatomicalPrior(),
        other_front=OtherFront((mirrored_in_depth(first),), 0.5, to_the_end),
        on_progress=lambda done, total, note: told.append((done / total, note)),
    )  # fmt: skip
    assert result.front is not None
    assert not result.front.mirrored
    assert result.front.probability > 0.88
    stages = {note.partition(",")[0] for _, note in told if note.startswith("other front: stage")}
    assert stages == ({"other front: stage 1", "other front: stage 2"} if to_the_end else {"other front: stage 1"})
    assert max(share for share, _ in told) == told[-1][0] == 1


def test_simulated_starts_have_one_front(example: tuple[Observation, FirstBody, Truth]) -> None:
    seen, found, _ = example
    assert find_other_front(seen, [dataclasses.replace(found, source="simulated")], BODY, sure=math.inf) is None


@pytest.mark.parametrize("kind", ["mediapipe", "matte", "simulated"])
def test_evidence_adds_up(kind: str) -> None:
    base = front_log_odds(0.0, 0.0, [kind])
    assert base >= 0  # without evidence the start stays as found
    assert front_log_odds(0.1, 0.0, [kind]) - base == pytest.approx(base - front_log_odds(-0.1, 0.0, [kind]))
    assert front_log_odds(0.1, 0.2, [kind]) > front_log_odds(0.1, 0.0, [kind]) > base
    mixed = front_log_odds(-0.2, 0.0, [kind, "matte"])
    assert mixed == pytest.approx((front_log_odds(-0.2, 0.0, [kind]) + front_log_odds(-0.2, 0.0, ["matte"])) / 2)
    assert shipped_front_weights("network").loss > 0


def test_losses_count_by_their_ratio_where_a_fit_explains_its_frames() -> None:
    good, worse, failed = FitLoss(1.2, 0.04), FitLoss(1.8, 0.06), FitLoss(40.0, 0.5)
    assert loss_log_ratio(good, worse) == pytest.approx(np.log(1.5)) == -loss_log_ratio(worse, good)
    # how badly a fit failed says no more
    assert loss_log_ratio(good, failed) == loss_log_ratio(good, FitLoss(400.0, 0.9)) > loss_log_ratio(good, worse)
    # both miss the mattes, as where a shadow is part of them
    assert loss_log_ratio(FitLoss(6.4, 0.116), FitLoss(8.2, 0.118)) == 0
    assert loss_log_ratio(FitLoss(0.0, 0.0), FitLoss(0.0, 0.0)) == 0
