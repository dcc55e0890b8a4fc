"""The judge against motions whose scores are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.datasets.example import write_example
from hfb.datasets.truth import load_truth
from hfb.evaluation.judge import judge
from hfb.evaluation.prediction import Prediction
from hfb.geometry.camera import PinholeCamera
from hfb.motion.clock import subframe_times_s
from hfb.rendering.observation import Observation


def test_a_motion_that_runs_backwards_is_as_good_the_other_way(tmp_path: Path) -> None:
    truth, body = load_truth(write_example(tmp_path, seed=0).truth), load_default_body()
    height, width = truth.silhouettes.shape[1:]
    camera = PinholeCamera.from_matrix(torch.from_numpy(truth.motion.K), height, width)
    plate = torch.zeros(height, width, 3)
    mattes = torch.from_numpy(truth.silhouettes.astype(np.float32)).mean(0)[None]
    exposure_s = float(truth.motion.times_s[-1])
    seen = Observation(plate[None], plate, mattes, camera, exposure_s, exposure_s)
    clock, index = subframe_times_s(1, 8, exposure_s, exposure_s)
    rows = np.abs(truth.motion.times_s[None] - clock[:, None]).argmin(1)
    true = truth.motion
    forth = replace(
        true, poses=true.poses[rows], trans=true.trans[rows], joints=true.joints[rows], times_s=clock, frame_index=index
    )
    back = replace(forth, poses=forth.poses[::-1], trans=forth.trans[::-1], joints=forth.joints[::-1])
    scores = [judge(Prediction(motion, None, None, 0.0), seen, truth, body, None) for motion in (forth, back)]
    assert [one["wrong_direction"] for one in scores] == [0, 1]
    assert scores[0]["iou"] > 0.999 > 0.95 > scores[1]["iou"]
    assert [one["better_iou"] for one in scores] == pytest.approx([scores[0]["iou"]] * 2)
    assert [one["better_mpjpe_mm"] for one in scores] == pytest.approx([scores[0]["mpjpe_mm"]] * 2, abs=1e-6)
