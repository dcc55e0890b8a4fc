"""Human from Blur itself, as one of the methods."""

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from hfb.body.model import Body
from hfb.config import RunConfig
from hfb.datasets.case import Case
from hfb.evaluation.baselines.frames import one_by_one
from hfb.evaluation.baselines.rows import row_times_s
from hfb.evaluation.prediction import Prediction
from hfb.evaluation.protocol import pose_rows
from hfb.fitting.fit import FitResult, fit
from hfb.initialization.fronts import find_other_front
from hfb.kernels.determinism import one_torch_thread
from hfb.motion.sampled import SampledMotion
from hfb.motion.static_pose import FirstBody
from hfb.priors.load import load_pose_prior
from hfb.priors.motion_prior import load_motion_prior
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.observation import Observation
from hfb.typing import Array, Float


class HumanFromBlur:
    """A fit by eq. (11), of all frames together or of each alone, drawn with exact silhouettes at every row.

    Args:
        name: name of the method.
        config: options of the fit.
        frames_alone: fit every frame separately.
        body: model that is fitted.
    """

    def __init__(self, name: str, config: RunConfig, frames_alone: bool, body: Body) -> None:
        self.name = name
        self._config = config
        self._frames_alone = frames_alone
        self._body = body
        self._prior = load_pose_prior(config.prior.pose, config.prior.kind)
        self._motion_prior = load_motion_prior(config.prior.motion)
        # The rows are drawn alike for every method, whatever silhouette its loss was made of.
        self._rasterizer = make_rasterizer("coverage", "cpu", threads=1)

    def told(self, height_m: float) -> "HumanFromBlur":
        """Return the same method with the person's height fixed.

        Args:
            height_m: height of the person, soles to crown.
        """
        other = copy.copy(self)
        fit = self._config.fit.model_copy(update={"height_m": height_m})
        other._config = self._config.model_copy(update={"fit": fit})
        return other

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Predict poses and appearance; the case is not used."""
        if not self._frames_alone:
            result = self._fit(observation, starts)
            pictures = self._draw(result, observation)
            return Prediction(
                result.motion, None, pictures, result.seconds, None, result.alternatives, result.joint_features
            )
        frames = one_by_one(observation)
        results = [self._fit(frame, [start]) for frame, start in zip(frames, starts, strict=True)]
        pictures = np.concatenate([self._draw(one, frame) for one, frame in zip(results, frames, strict=True)])
        seconds = sum(result.seconds for result in results)
        # Each frame has found a shape of its own, the joined motion holds their mean: what is drawn is each frame's.
        return Prediction(_joined(results, observation), pictures[..., 3] >= 0.5, pictures, seconds)

    def _fit(self, observation: Observation, starts: Sequence[FirstBody]) -> FitResult:
        config = self._config.fit
        return fit(
            observation,
            starts,
            self._body,
            config,
            self._config.seed,
            self._prior,
            motion_prior=self._motion_prior,
            other_front=find_other_front(observation, starts, self._body, enabled=config.both_fronts),
        )

    def _draw(self, result: FitResult, observation: Observation) -> Float[Array, "R H W 4"]:
        with torch.no_grad(), one_torch_thread():
            vertices = pose_rows(result.motion, np.arange(len(result.motion.poses)), self._body).vertices
            return self._rasterizer.render(vertices, result.texture, observation.camera, self._body.mesh).numpy()


def _joined(results: Sequence[FitResult], observation: Observation) -> SampledMotion:
    """Join single frames' motions on the clip's clock; joints are those of each frame's shape."""
    motions = [result.motion for result in results]
    times_s, frame_index = row_times_s(observation, len(motions[0].poses))
    radii = [motion.joint_radius_mm for motion in motions if motion.joint_radius_mm is not None]
    return replace(
        motions[0],
        poses=np.concatenate([motion.poses for motion in motions]),
        trans=np.concatenate([motion.trans for motion in motions]),
        joints=np.concatenate([motion.joints for motion in motions]),
        betas=np.mean([motion.betas for motion in motions], axis=0),
        times_s=times_s,
        frame_index=frame_index,
        joint_radius_mm=np.concatenate(radii) if len(radii) == len(motions) else None,
    )
