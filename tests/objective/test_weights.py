"""Effective weights of every stage: one table, which the documents show."""

from pathlib import Path

import pytest

from hfb.config import FitConfig, MultiFrame, Weights, preset
from hfb.objective.weights import base_weights, stage_weights, weights_table

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "weights.md"
BEST = preset("best").fit


def test_the_documents_show_the_present_table() -> None:
    assert weights_table() in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize(("n_frames", "image", "motion", "height"), [(1, 30, 0.1, 0.04), (2, 990, 0.05, 0.12)])
def test_frames_that_share_a_texture_weigh_images_and_height_more(
    n_frames: int, image: float, motion: float, height: float
) -> None:
    full, coarse = stage_weights(BEST, n_frames, "full").terms, stage_weights(BEST, n_frames, "coarse").terms
    assert (full.image, full.motion, full.height) == pytest.approx((image, motion, height))
    assert coarse == full.model_copy(update={"image": 30.0}) == base_weights(BEST, n_frames)


def test_the_warm_up_has_no_images_and_weaker_regularisers() -> None:
    of_stage = stage_weights(BEST, 1, "warm-up")
    nonzero = {name: value for name, value in of_stage.terms.model_dump().items() if value > 0}
    assert nonzero == pytest.approx(
        {
            "pose": 0.0007,
            "shape": 0.002,
            "motion": 0.01,
            "boundary": 5,
            "start": 0.02,
            "joints": 1,
            "path": 0.3,
            "height": 0.04,
        }
    )
    assert (of_stage.xy_weight, stage_weights(BEST, 1, "full").xy_weight) == (1.0, 0.2)


def test_options_reach_every_stage() -> None:
    config = FitConfig(weights=Weights(image=2, motion=0.6, height=0.5), multi_frame=MultiFrame(image=3, height=2))
    assert stage_weights(config, 3, "full").terms == Weights(image=6, motion=0.6, height=1.0)
    shared = config.model_copy(update={"motion_shared": True})
    assert stage_weights(shared, 3, "coarse").terms.motion == pytest.approx(0.2)
