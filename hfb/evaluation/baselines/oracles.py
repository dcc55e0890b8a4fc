"""Methods that use a part of the truth, which their names state."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from hfb.body.height import height_m
from hfb.body.model import Body
from hfb.datasets.case import Case
from hfb.datasets.simulated_start import simulated_starts
from hfb.datasets.synthetic.sharp import SHARP_SUBFRAMES, load_sharp
from hfb.datasets.truth import load_truth
from hfb.errors import InputError
from hfb.evaluation.baselines.chain import found_in
from hfb.evaluation.baselines.estimates import Estimate, interpolate
from hfb.evaluation.baselines.fitted import HumanFromBlur
from hfb.evaluation.baselines.method import Method
from hfb.evaluation.baselines.rows import middle_times_s
from hfb.evaluation.prediction import Prediction
from hfb.initialization.initializer import Initializer
from hfb.io.media.images.image_io import read_matte
from hfb.kernels.determinism import one_torch_thread
from hfb.motion.static_pose import FirstBody
from hfb.photometry import srgb_to_linear
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.typing import Float, Tensor

_LEAST_BLUR = 0.05  # the lower end of the paper's first interval of blur rates


class TrueMatte:
    """Another method with the exact mattes in place of the estimated ones.

    Args:
        name: name of the method.
        method: method that gets the exact mattes.
    """

    def __init__(self, name: str, method: Method) -> None:
        self.name = name
        self._method = method

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """See `Method`."""
        mattes = torch.from_numpy(np.stack([read_matte(path) for path in case.true_matte_paths()]))
        if mattes.shape != observation.mattes.shape:
            raise InputError(f"{case.folder}: the true mattes are of another size; make the set again with `hfb synth`")
        return self._method(case, replace(observation, mattes=mattes), starts)


class TrueStart:
    """Another method that starts from the true body in the middle of every exposure.

    Args:
        name: name of the method.
        method: method that starts from the true body.
        body: model of the start.
    """

    def __init__(self, name: str, method: Method, body: Body) -> None:
        self.name = name
        self._method = method
        self._body = body

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """See `Method`. The shape is true too where the truth's betas are those of the body model in use."""
        truth = load_truth(case.truth)
        rows = np.abs(truth.motion.times_s[None] - middle_times_s(observation)[:, None]).argmin(1)
        same = truth.betas_space == self._body.betas_space
        true_starts = [
            FirstBody(
                torch.from_numpy(truth.motion.poses[row].reshape(24, 3)).to(start.pose),
                torch.from_numpy(truth.motion.trans[row]).to(start.translation),
                torch.from_numpy(truth.motion.betas).to(start.betas) if same else start.betas,
                "truth",
            )
            for row, start in zip(rows, starts, strict=True)
        ]
        return self._method(case, observation, true_starts)


class TrueHeight:
    """A fit with the person's true height, which a user may know.

    Args:
        name: name of the method.
        method: the fit.
        body: model that is fitted.
    """

    def __init__(self, name: str, method: HumanFromBlur, body: Body) -> None:
        self.name = name
        self._method = method
        self._body = body

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """See `Method`.

        Raises:
            InputError: the truth has another body model's betas, or none.
        """
        truth = load_truth(case.truth)
        if truth.betas_space != self._body.betas_space:
            raise InputError(f"{case.folder}: the true person's height is not known in {self._body.name}'s betas")
        height = float(height_m(self._body, torch.from_numpy(truth.motion.betas).float()))
        return self._method.told(height)(case, observation, starts)


class TwoStageOracle:
    """An estimator on the TRUE sharp sub-frames with their exact mattes: the limit of perfect deblurring.

    Args:
        name: name of the method.
        initializer: the estimator; None for the simulated one.
        subframes: rows per frame of the prediction.
        seed: seed of the simulated estimator.
        body: model of the prediction.
    """

    def __init__(self, name: str, initializer: Initializer | None, subframes: int, seed: int, body: Body) -> None:
        self.name = name
        self._subframes = subframes
        self._seed = seed
        self._body = body
        self._initializer = initializer  # None: the simulated estimator, which needs no images

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Predict poses alone, interpolated between the eight sub-frames of the truth."""
        started = time.perf_counter()
        with one_torch_thread():
            estimates = (
                self._simulated(case, observation) if self._initializer is None else self._seen(case, observation)
            )
            times = np.linspace(0.0, 1.0, SHARP_SUBFRAMES)
            motion, _ = interpolate(estimates, times, observation, starts, self._body, self._subframes)
        return Prediction(motion, None, None, time.perf_counter() - started)

    def _seen(self, case: Case, observation: Observation) -> list[list[Estimate | None]]:
        initializer = self._initializer
        assert initializer is not None
        linear = observation.light == "linear"
        plate = observation.plate_linear if linear else srgb_to_linear(observation.plate_linear)
        estimates = []
        for frame in range(len(observation.mattes)):
            sharp = torch.from_numpy(load_sharp(case, frame))
            if sharp.shape[1:3] != plate.shape[:2]:
                raise InputError(f"{case.folder}: the true sub-frames are of another size; make the set again")

            def estimate(index: int, sharp: Float[Tensor, "S H W 4"] = sharp) -> Estimate:
                picture, matte = compose(sharp[index], plate), sharp[index, ..., 3]
                return Estimate.of(initializer(picture, plate, matte, observation.camera, self._body))

            estimates.append(found_in(estimate, len(sharp)))
        return estimates

    def _simulated(self, case: Case, observation: Observation) -> list[list[Estimate | None]]:
        """Apply the simulated estimator to every sub-frame, as if it were a frame with hardly any blur.

        All are drawn together, since a network's errors on neighbouring sub-frames are alike.
        """
        truth, frames = load_truth(case.truth), len(observation.mattes)
        u = np.linspace(0.0, 1.0, SHARP_SUBFRAMES) * observation.exposure_s
        instants = (np.arange(frames)[:, None] * observation.interval_s + u).ravel()
        rows = np.abs(truth.motion.times_s[None] - instants[:, None]).argmin(1)
        motion = replace(
            truth.motion,
            poses=truth.motion.poses[rows],
            trans=truth.motion.trans[rows],
            joints=truth.motion.joints[rows],
            times_s=truth.motion.times_s[rows],
            frame_index=np.arange(len(rows)),
        )
        rng = np.random.default_rng([self._seed, case.number])
        single = replace(truth, motion=motion, silhouettes=truth.silhouettes[rows])
        found = simulated_starts(single, len(rows), _LEAST_BLUR, self._body, observation.camera, rng)
        return [
            [Estimate.of(one) for one in found[start : start + SHARP_SUBFRAMES]]
            for start in range(0, len(found), SHARP_SUBFRAMES)
        ]
