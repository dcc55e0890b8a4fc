"""Deblur, then estimate: the paper's chains of Jin et al., AfB or BIN with METRO, HybrIK or PyMAF."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from hfb.body.model import Body
from hfb.config import InitConfig, MattingConfig
from hfb.datasets.case import Case, case_name
from hfb.errors import InputError
from hfb.evaluation.baselines.chain_spec import ChainSpec
from hfb.evaluation.baselines.deblurrers import Deblurrer, SharpPictures, subframe_times
from hfb.evaluation.baselines.estimates import Estimate, interpolate
from hfb.evaluation.baselines.estimators import Estimator, InitializerEstimator, NetworkEstimator, Sight
from hfb.evaluation.baselines.stored_poses import read_estimates
from hfb.evaluation.prediction import Prediction
from hfb.initialization.initializer import make_initializer
from hfb.kernels.determinism import one_torch_thread
from hfb.matting.methods import make_matting
from hfb.motion.static_pose import FirstBody
from hfb.networks.runtimes import load_network
from hfb.photometry import srgb_to_linear
from hfb.rendering.observation import Observation
from hfb.typing import Array, Float, Tensor


class Chain:
    """Sub-frames of every blurred frame, an estimate in each, interpolated to the clock of the prediction.

    Args:
        name: name of the method.
        chain: its table in the chains file.
        subframes: rows per frame of the prediction.
        body: model of the prediction.
    """

    def __init__(self, name: str, chain: ChainSpec, subframes: int, body: Body) -> None:
        self.name = name
        self._poses = chain.poses
        self._times = chain.deblurrer_layout.times
        self._subframes = subframes
        self._body = body
        self._deblurrer = Deblurrer(chain)
        self._matting = make_matting(MattingConfig())
        self._estimator: Estimator | None = None
        self._wants_own_matte = False
        if chain.estimator == "mediapipe" or chain.estimator == "matte":
            self._estimator = InitializerEstimator(make_initializer(InitConfig(method=chain.estimator)))
            self._wants_own_matte = self._deblurrer.changes_pictures
        elif isinstance(chain.estimator, Path):
            self._estimator = NetworkEstimator(load_network(chain.estimator), chain.estimator_layout)

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Predict poses, or joints where the estimator gives no more; of the case only its number is used."""
        started = time.perf_counter()
        frames = len(observation.mattes)
        with one_torch_thread():
            if self._poses is not None:
                estimates = read_estimates(self._poses / f"{case_name(case.number)}.npz", frames, self._body)
                times = subframe_times(len(estimates[0]), self._times)
            else:
                sharp = self._deblurrer(case, observation)
                estimates, times = self._estimated(sharp, observation), sharp.times
            motion, joints = interpolate(estimates, times, observation, starts, self._body, self._subframes)
        return Prediction(motion, None, None, time.perf_counter() - started, joints)

    def _estimated(self, sharp: SharpPictures, observation: Observation) -> list[list[Estimate | None]]:
        estimator, estimates = self._estimator, []
        assert estimator is not None
        for pictures, matte in zip(sharp.pictures_srgb, observation.mattes, strict=True):

            def estimate(
                index: int, pictures: Float[Array, "M H W 3"] = pictures, matte: Float[Tensor, "H W"] = matte
            ) -> Estimate:
                person = self._matte(pictures[index], observation) if self._wants_own_matte else matte
                sight = Sight(pictures[index], observation.plate_linear, person, observation.camera)
                return estimator(sight, self._body)

            estimates.append(found_in(estimate, len(pictures)))
        return estimates

    def _matte(self, picture_srgb: Float[Array, "H W 3"], observation: Observation) -> Float[Tensor, "H W"]:
        """Return the matte of a deblurred image; the blurred frame's would include other times."""
        picture = srgb_to_linear(picture_srgb) if observation.light == "linear" else picture_srgb
        return torch.from_numpy(self._matting(picture.astype(np.float32), observation.plate_linear))


def found_in(estimate: Callable[[int], Estimate], count: int) -> list[Estimate | None]:
    """Estimate the body in each of a frame's sub-frames; None where nobody was found, as long as one succeeds.

    Args:
        estimate: returns the estimate of a sub-frame by its number.
        count: number of sub-frames.

    Raises:
        InputError: the last reason, where the person is found in no sub-frame.
    """
    found: list[Estimate | None] = []
    reason: InputError | None = None
    for index in range(count):
        try:
            found.append(estimate(index))
        except InputError as error:
            found.append(None)
            reason = error
    if reason is not None and not any(found):
        raise reason
    return found
