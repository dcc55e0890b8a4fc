"""Methods that use a part of the truth, which their names state."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from hfb.body.height import height_m
from hfb.body.model import Body
from hfb.config import MattingConfig
from hfb.datasets.case import Case
from hfb.datasets.simulated_start import simulated_starts
from hfb.datasets.synthetic.sharp import SHARP_SUBFRAMES, load_sharp
from hfb.datasets.truth import load_truth
from hfb.errors import InputError
from hfb.evaluation.baselines.chain import found_in
from hfb.evaluation.baselines.estimates import Estimate, interpolate
from hfb.evaluation.baselines.fitted import HumanFromBlur
from hfb.evaluation.baselines.method import Method
from hfb.evaluation.baselines.rows import middle_times_s, motion_of_rows, points_at, poses_at, row_times_s
from hfb.evaluation.baselines.static import Static
from hfb.evaluation.baselines.true_bodies import bodies_on_joints, true_bodies
from hfb.evaluation.prediction import Prediction
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.floor_shade import without_shade
from hfb.initialization.fronts import mirrored_in_depth
from hfb.initialization.initializer import Initializer
from hfb.io.media.images.image_io import read_matte, read_picture_srgb
from hfb.kernels.determinism import one_torch_thread
from hfb.matting.methods import make_matting
from hfb.motion.static_pose import FirstBody
from hfb.photometry import srgb_to_linear
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.typing import Array, Float, Tensor

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


class _OtherStart:
    """Another method with another start.

    Args:
        name: name of the method.
        method: method that gets the start.
        body: model of the start.
    """

    def __init__(self, name: str, method: Method, body: Body) -> None:
        self.name = name
        self._method = method
        self._body = body


class TrueStart(_OtherStart):
    """Another method that starts from the true body in the middle of every exposure.

    It is fitted as the start whose place it takes: what corrects simulated starts pulls true ones on real video away.
    """

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """See `Method`. The shape is true too, but where the truth's betas are another body model's."""
        truth = true_bodies(case, self._body)
        true_starts = [
            FirstBody(
                truth.poses[row].to(start.pose),
                truth.translations[row].to(start.translation),
                start.betas if truth.betas is None else truth.betas.to(start.betas),
                start.source,
            )
            for row, start in zip(truth.nearest(middle_times_s(observation)).tolist(), starts, strict=True)
        ]
        return self._method(case, observation, true_starts)


class TrueFront(_OtherStart):
    """Another method whose start is mirrored in depth where that is nearer to the truth."""

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """See `Method`."""
        truth = true_bodies(case, self._body)
        rows = truth.nearest(middle_times_s(observation)).tolist()
        chosen = [
            min((start, mirrored_in_depth(start)), key=lambda one: self._distance(one, joints))
            for start, joints in zip(starts, truth.joints[rows], strict=True)
        ]
        return self._method(case, observation, chosen)

    def _distance(self, first: FirstBody, true: Float[Array, "24 3"]) -> float:
        """Return the mean distance of the known joints after both sides are centred."""
        dtype = self._body.template.dtype
        shaped = self._body.shape(first.betas.to(dtype))
        turns = axis_angle_to_matrix(first.pose.to(dtype))[None]
        joints = shaped.joints_of(turns, first.translation.to(dtype)[None])[0].double().numpy()
        known = np.isfinite(true).all(1)
        own, there = joints[known], true[known]
        return float(np.linalg.norm(own - own.mean(0) - (there - there.mean(0)), axis=1).mean())


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
        """See `Method`. In real video it is the height of the body that is laid onto the true joints.

        Raises:
            InputError: the truth has another body model's betas, or none.
        """
        betas = true_bodies(case, self._body).betas
        if betas is None:
            raise InputError(f"{case.folder}: the true person's height is not known in {self._body.name}'s betas")
        return self._method.told(float(height_m(self._body, betas.float())))(case, observation, starts)


class Floor:
    """The body registered to the true joints: the lowest error that its poses can reach."""

    def __init__(self, name: str, subframes: int, body: Body) -> None:
        self.name = name
        self._subframes = subframes
        self._body = body

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Poses alone."""
        started = time.perf_counter()
        laid = bodies_on_joints(case, self._body)
        rows_s, frame_index = row_times_s(observation, self._subframes)
        poses, places = [], []
        for frame in range(len(observation.mattes)):
            own, at = laid.frame_index == frame, rows_s[frame_index == frame]
            poses.append(poses_at(at, laid.times_s[own], laid.poses[own]))
            places.append(points_at(at, laid.times_s[own], laid.translations[own]))
        assert laid.betas is not None
        motion = motion_of_rows(torch.cat(poses), torch.cat(places), laid.betas, observation, self._body)
        return Prediction(motion, None, None, time.perf_counter() - started)


class SharpMiddle:
    """The start's estimator on the TRUE sharp frame in the middle of each exposure, held still.

    It bounds methods that deblur one sharp image and then estimate a body. Each frame is estimated alone.
    """

    def __init__(self, name: str, initializer: Initializer, subframes: int, body: Body) -> None:
        self.name = name
        self._initializer = initializer
        self._still = Static(name, False, subframes, body)
        self._body = body

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Poses alone.

        Raises:
            InputError: the case has no sharp frames, or nobody is found in one.
        """
        started = time.perf_counter()
        if not all(path.exists() for path in case.middle_paths()):
            raise InputError(
                f"{case.folder} has no {case.middle_paths()[0].name}: cases of real video have; make it again"
            )
        plate = observation.to_linear(observation.plate_linear)
        matting = without_shade(make_matting(MattingConfig(), quick=True))
        found = []
        with one_torch_thread():
            for path in case.middle_paths():
                picture = srgb_to_linear(read_picture_srgb(path)).astype(np.float32)
                matte = torch.from_numpy(matting(picture, plate.numpy()))
                found.append(self._initializer(torch.from_numpy(picture), plate, matte, observation.camera, self._body))
        prediction = self._still(case, observation, found)
        return replace(prediction, seconds=time.perf_counter() - started)


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
        plate = observation.to_linear(observation.plate_linear)
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
