"""The judge against motions whose scores are known."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.datasets.example import write_example
from hfb.datasets.truth import JointTruth, Truth, load_truth
from hfb.evaluation.judge import judge
from hfb.evaluation.prediction import Prediction
from hfb.geometry.camera import PinholeCamera
from hfb.motion.clock import subframe_times_s
from hfb.motion.sampled import SampledMotion
from hfb.rendering.observation import Observation


@dataclass
class Known:
    """The example's motion as a fit has it, and what it was made from."""

    truth: Truth
    seen: Observation
    motion: SampledMotion


@pytest.fixture
def known(tmp_path: Path) -> Known:
    truth = load_truth(write_example(tmp_path, seed=0).truth)
    height, width = truth.silhouettes.shape[1:]
    camera = PinholeCamera.from_matrix(torch.from_numpy(truth.motion.K), height, width)
    plate = torch.zeros(height, width, 3)
    mattes = torch.from_numpy(truth.silhouettes.astype(np.float32)).mean(0)[None]
    exposure_s = float(truth.motion.times_s[-1])
    clock, index = subframe_times_s(1, 8, exposure_s, exposure_s)
    rows = np.abs(truth.motion.times_s[None] - clock[:, None]).argmin(1)
    true = truth.motion
    motion = replace(
        true, poses=true.poses[rows], trans=true.trans[rows], joints=true.joints[rows], times_s=clock, frame_index=index
    )
    return Known(truth, Observation(plate[None], plate, mattes, camera, exposure_s, exposure_s), motion)


def test_radii_count_on_real_video_by_the_joints_that_it_knows(known: Known) -> None:
    numbers = np.array([1, 2, 7, 20])  # the hips, an ankle, a wrist
    joints = known.truth.motion.joints[:, numbers].copy()
    joints[:, 3] = np.nan
    times_s, frame_index = known.truth.motion.times_s, known.truth.motion.frame_index
    real = JointTruth(joints, numbers, times_s, frame_index, ("RHip", "LHip", "LAnkle", "LWrist"))
    radius = np.full((8, 24), 5.0)
    radius[:, 20] = 1e6  # of no joint that counts
    off = known.motion.joints.copy()
    off[:, 7] += (0, 0, 0.5)
    sure = replace(known.motion, joint_radius_mm=radius)
    right, wrong = (
        judge(Prediction(motion, None, None, 0.0), known.seen, real, load_default_body(), None)
        for motion in (sure, replace(sure, joints=off))
    )
    assert right["radius_mm"] == wrong["radius_mm"] == 5
    assert wrong["within_p90"] < right["within_p90"] == 1
    without_hips = replace(real, joints=joints[:, 2:], smpl_joints=numbers[2:], names=real.names[2:])
    assert "radius_mm" not in judge(
        Prediction(sure, None, None, 0.0), known.seen, without_hips, load_default_body(), None
    )


def test_a_motion_that_runs_backwards_is_as_good_the_other_way(known: Known) -> None:
    truth, seen, forth = known.truth, known.seen, known.motion
    body = load_default_body()
    back = replace(forth, poses=forth.poses[::-1], trans=forth.trans[::-1], joints=forth.joints[::-1])
    scores = [judge(Prediction(motion, None, None, 0.0), seen, truth, body, None) for motion in (forth, back)]
    assert [one["wrong_direction"] for one in scores] == [0, 1]
    assert scores[0]["iou"] > 0.999 > 0.95 > scores[1]["iou"]
    assert [one["better_iou"] for one in scores] == pytest.approx([scores[0]["iou"]] * 2)
    assert [one["better_mpjpe_mm"] for one in scores] == pytest.approx([scores[0]["mpjpe_mm"]] * 2, abs=1e-6)
