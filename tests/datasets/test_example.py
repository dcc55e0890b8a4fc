"""The embedded example is reproducible, and its files agree with each other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.datasets.example import ExamplePaths, write_example
from hfb.datasets.truth import load_truth
from hfb.errors import InputError
from hfb.evaluation.metrics import blur_rate
from hfb.evaluation.protocol import pose_rows, truth_scores
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.motion.motion_file import save_motion
from hfb.motion.sampled import SampledMotion
from hfb.rendering.backends import make_rasterizer


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> ExamplePaths:
    return write_example(tmp_path_factory.mktemp("example"), seed=0)


def test_the_same_seed_gives_the_same_bytes(example: ExamplePaths, tmp_path: Path) -> None:
    again = write_example(tmp_path, seed=0)
    for one, other in ((example.frame, again.frame), (example.background, again.background)):
        assert one.read_bytes() == other.read_bytes()
    other_seed = write_example(tmp_path / "other", seed=1)
    assert other_seed.frame.read_bytes() != example.frame.read_bytes()


def test_the_truth_is_where_the_picture_differs_from_the_plate(example: ExamplePaths) -> None:
    truth = load_truth(example.truth)
    difference = np.abs(read_picture_srgb(example.frame) - read_picture_srgb(example.background)).max(-1)
    alpha = truth.silhouettes.mean(0)
    assert difference[alpha == 0].mean() < 0.02  # sensor noise only
    assert difference[alpha > 0.9].mean() > 0.1
    assert 0.1 < blur_rate(truth.silhouettes.astype(np.float32)) < 1.1


def test_the_motion_renders_to_its_silhouettes(example: ExamplePaths) -> None:
    truth, body = load_truth(example.truth), load_default_body()
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    torch.testing.assert_close(
        pose_rows(truth.motion, np.array([0, 30]), body).joints.double(),
        torch.from_numpy(truth.motion.joints[[0, 30]]),
        atol=1e-5,
        rtol=0,
    )
    scores = truth_scores(truth.motion, truth, body, rasterizer)
    assert scores["iou"] > 0.999
    assert scores["mpjpe_mm"] < 1e-3
    back = truth_scores(reversed_in_time(truth.motion), truth, body, rasterizer)
    assert back["iou"] < 0.95
    assert back["better_iou"] > 0.999
    assert back["wrong_direction"] == 1


def reversed_in_time(motion: SampledMotion) -> SampledMotion:
    return replace(motion, poses=motion.poses[::-1], trans=motion.trans[::-1], joints=motion.joints[::-1])


def test_a_motion_without_silhouettes_is_no_truth(example: ExamplePaths, tmp_path: Path) -> None:
    save_motion(tmp_path / "motion.npz", load_truth(example.truth).motion, "hfb")
    with pytest.raises(InputError, match="no true silhouettes"):
        load_truth(tmp_path / "motion.npz")
