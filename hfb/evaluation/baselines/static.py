"""The static start estimates as methods."""

import time
from collections.abc import Sequence

import torch

from hfb.body.model import Body
from hfb.datasets.case import Case
from hfb.evaluation.baselines.rows import middle_times_s, motion_of_rows, points_at, poses_at, row_times_s
from hfb.evaluation.prediction import Prediction
from hfb.motion.static_pose import FirstBody
from hfb.rendering.observation import Observation


class Static:
    """Each frame's first body, held still through the exposure, or interpolated between the exposures' middles.

    Args:
        name: name of the method.
        interpolated: interpolate between the exposures' middles.
        subframes: rows per frame of the prediction.
        body: model of the first bodies.
    """

    def __init__(self, name: str, interpolated: bool, subframes: int, body: Body) -> None:
        self.name = name
        self._interpolated = interpolated
        self._subframes = subframes
        self._body = body

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Predict poses alone; the case is not used."""
        started = time.perf_counter()
        poses = torch.stack([start.pose for start in starts])
        translations = torch.stack([start.translation for start in starts])
        betas = torch.stack([start.betas for start in starts]).mean(0)
        times_s, frames = row_times_s(observation, self._subframes)
        if self._interpolated:
            known_s = middle_times_s(observation)
            poses, translations = poses_at(times_s, known_s, poses), points_at(times_s, known_s, translations)
        else:
            poses, translations = poses[frames], translations[frames]
        motion = motion_of_rows(poses, translations, betas, observation, self._body)
        return Prediction(motion, None, None, time.perf_counter() - started)
