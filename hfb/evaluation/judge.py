"""Scores of one prediction of one case, against the truth and the images."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from hfb.body.model import Body
from hfb.datasets.synthetic.sharp import SHARP_SUBFRAMES
from hfb.datasets.truth import JointTruth, Truth
from hfb.evaluation.metrics import (
    better_of_both,
    errors_mm,
    joint_errors_mm,
    motion_errors,
    psnr_db,
    silhouette_iou,
    ssim,
    subset_errors,
    wrong_direction,
)
from hfb.evaluation.movement import at_instants, movement_errors
from hfb.evaluation.prediction import Prediction
from hfb.evaluation.protocol import at_rest, picture_scores, pose_rows, silhouette_scores
from hfb.evaluation.reliability import direction_row, joint_row
from hfb.fitting.confidence import shipped_confidence
from hfb.geometry.camera import PinholeCamera
from hfb.motion.clock import subframe_times_s
from hfb.motion.sampled import SampledMotion
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.typing import Array, Bool, Float, Int

Scores = dict[str, Any]
_PELVIS, _HIPS = 0, (1, 2)
_SSIM_WINDOW_PX = 11
_PLACES_IN_SPACE = ("in_plane_px", "motion_mm", "better_motion_mm")
"""Errors that need places in front of the camera; joints about their root have none."""


def judge(
    prediction: Prediction,
    observation: Observation,
    truth: Truth | JointTruth,
    body: Body,
    sharp: Float[Array, "T 8 H W 4"] | None,
) -> Scores:
    """Score a prediction against the truth at the nearest instants and against the images.

    Args:
        prediction: one method's prediction.
        observation: the blurred frames with their mattes and clock.
        truth: the case's truth.
        body: the model in which the prediction's poses are given.
        sharp: the true sub-frames at u = i / 7, for the images' scores.

    Returns:
        the numbers of a row of cases.parquet; None where the method, or the truth, does not say.
    """
    frames = observation.mattes.shape[0]
    scores: Scores = {"seconds": prediction.seconds}
    joints = prediction.joints if prediction.motion is None else prediction.motion.joints
    if joints is not None:
        times_s = _clock(len(joints), observation)
        scores |= _motion_scores(joints, times_s, truth, frames)
        scores |= _movement_scores(joints, times_s, truth, observation, prediction.motion is not None)
    scores |= _said(prediction, truth)
    if isinstance(truth, Truth):
        silhouettes = _silhouettes(prediction, body, truth)
        if silhouettes is not None:
            nearest = _nearest(_clock(len(silhouettes), observation), truth.motion.times_s)
            shown = truth.silhouettes[nearest].astype(np.float32)
            drawn = silhouettes.astype(np.float32)
            if prediction.motion is None:  # without joints no direction is the better one
                scores["iou"] = silhouette_iou(drawn, shown)
            else:
                wrong = wrong_direction(prediction.motion.joints, truth.motion.joints[nearest], frames)
                scores |= silhouette_scores(drawn, shown, wrong)
    if prediction.pictures is not None:
        scores |= _explained(prediction.pictures, observation)
        if sharp is not None:
            scores |= _sharp_scores(prediction.pictures, sharp, observation)
    return {name: _finite(value) for name, value in scores.items()}


def judge_start(starts: Sequence[FirstBody], observation: Observation, truth: Truth | JointTruth, body: Body) -> Scores:
    """Return the scores of the static start, named ``initial_*``.

    Args:
        starts: first body of each frame.
        observation: the blurred frames with their mattes and clock.
        truth: the case's truth.
        body: model of the starts.
    """
    frames = observation.mattes.shape[0]
    times_s, index = subframe_times_s(frames, SHARP_SUBFRAMES, observation.exposure_s, observation.interval_s)
    rows = len(times_s)
    blank = SampledMotion(
        np.zeros((rows, 72)),
        np.zeros((rows, 3)),
        np.zeros(10),
        np.zeros((rows, 24, 3)),
        times_s,
        index,
        observation.camera.matrix().double().numpy(),
    )
    still = at_rest(starts, blank, body)
    found = judge(Prediction(still, None, None, 0.0), observation, truth, body, None)
    kept = ("mpjpe_mm", "pa_mpjpe_mm", "iou", "in_plane_mm", "depth_mm")
    return {f"initial_{name}": found.get(name) for name in kept}


def _motion_scores(
    joints: Float[Array, "R 24 3"], times_s: Float[Array, "R"], truth: Truth | JointTruth, frames: int
) -> Scores:
    known = np.isfinite(joints).all((0, 2))
    if isinstance(truth, JointTruth):
        at, both = _nearest(times_s, truth.times_s), known[truth.smpl_joints]
        return _known_joints(joints, truth.joints[at][:, both], truth.smpl_joints[both], frames)
    true = truth.motion.joints[_nearest(times_s, truth.motion.times_s)]
    if not known.all():
        numbers = np.flatnonzero(known)
        return _known_joints(joints, true[:, numbers], numbers, frames)
    errors = motion_errors(joints, true, frames)
    return asdict(errors) | {"joint_errors_mm": joint_errors_mm(joints, true).tolist()}


def _movement_scores(
    joints: Float[Array, "R 24 3"],
    times_s: Float[Array, "R"],
    truth: Truth | JointTruth,
    observation: Observation,
    is_placed: bool,
) -> Scores:
    """Score position, front and motion: at the truth's instants for real video, else at the prediction's."""
    rows = np.arange(len(joints)).reshape(observation.mattes.shape[0], -1)
    known = np.flatnonzero(np.isfinite(joints).all((0, 2)))
    if isinstance(truth, JointTruth):
        both = np.isin(truth.smpl_joints, known)
        numbers, true, index = truth.smpl_joints[both], truth.joints[:, both], truth.frame_index
        claimed = np.empty(true.shape)
        for frame, own in enumerate(rows):
            seen = index == frame
            claimed[seen] = at_instants(joints[own][:, numbers], times_s[own], truth.times_s[seen])
    else:
        numbers, index = known, np.repeat(np.arange(len(rows)), rows.shape[1])
        true, claimed = truth.motion.joints[_nearest(times_s, truth.motion.times_s)][:, known], joints[:, known]
    errors = asdict(movement_errors(claimed, true, numbers.tolist(), index, observation.camera))
    return {name: value for name, value in errors.items() if is_placed or name not in _PLACES_IN_SPACE}


def _said(prediction: Prediction, truth: Truth | JointTruth) -> Scores:
    """Score the method's predicted errors, on real video by the joints that its truth has."""
    said: Scores = {} if prediction.alternatives is None else dict(direction_row(prediction.alternatives))
    motion = prediction.motion
    if motion is None or motion.joint_radius_mm is None:
        return said
    if isinstance(truth, Truth):
        counted = np.arange(1, motion.joints.shape[1])  # the pelvis is the origin
        errors = errors_mm(motion.joints, truth.motion.joints[_nearest(motion.times_s, truth.motion.times_s)])[:, 1:]
    else:
        counted, true = truth.smpl_joints, truth.joints[_nearest(motion.times_s, truth.times_s)]
        centre = _centre(counted)
        if not centre:
            return said
        errors = subset_errors(motion.joints[:, counted], true, centre).distances_mm
    return said | joint_row(errors, motion.joint_radius_mm[:, counted], shipped_confidence().exponent)


def _known_joints(
    joints: Float[Array, "R 24 3"], true: Float[Array, "R P 3"], numbers: Int[Array, "P"], frames: int
) -> Scores:
    """Return errors where one side has only some joints."""
    centres = _centre(numbers)
    if not centres:
        return {}

    def error(predicted: Float[Array, "R P 3"], target: Float[Array, "R P 3"]) -> float:
        return subset_errors(predicted, target, centres).mpjpe_mm

    claimed = joints[:, numbers]
    errors = subset_errors(claimed, true, centres)
    turned = wrong_direction(claimed, true, frames, error)
    per_joint = np.full(joints.shape[1], np.nan)
    per_joint[numbers] = errors.joints_mm
    return {
        "mpjpe_mm": errors.mpjpe_mm,
        "pa_mpjpe_mm": errors.pa_mpjpe_mm,
        "better_mpjpe_mm": better_of_both(error, claimed, true, frames),
        "wrong_direction": float(turned.mean()),
        "in_plane_mm": errors.in_plane_mm,
        "depth_mm": errors.depth_mm,
        "joint_errors_mm": [float(value) if np.isfinite(value) else None for value in per_joint],
    }


def _centre(numbers: Int[Array, "P"]) -> list[int]:
    """Return the place of the pelvis among joints, without it of both hips; nothing without these either."""
    positions = {int(number): place for place, number in enumerate(numbers)}
    found = next((some for some in ((_PELVIS,), _HIPS) if positions.keys() >= set(some)), ())
    return [positions[number] for number in found]


def _silhouettes(prediction: Prediction, body: Body, truth: Truth) -> Bool[Array, "R H W"] | None:
    """Return the method's silhouettes at each of its instants."""
    if prediction.silhouettes is not None or prediction.motion is None:
        return prediction.silhouettes
    motion = prediction.motion
    height, width = truth.silhouettes.shape[1:]
    camera = PinholeCamera.from_matrix(torch.from_numpy(motion.K), height, width)
    rasterizer = make_rasterizer("coverage", "cpu", 1)
    with torch.no_grad():
        vertices = pose_rows(motion, np.arange(len(motion.poses)), body).vertices
        drawn = [rasterizer.silhouette_mean(one[None], camera, body.mesh).numpy() >= 0.5 for one in vertices]
    return np.stack(drawn)


def _explained(pictures: Float[Array, "R H W 4"], observation: Observation) -> Scores:
    """Return how well the re-blurred images explain the frames."""
    frames = observation.mattes.shape[0]
    blurred = pictures.reshape(frames, -1, *pictures.shape[1:]).mean(1)
    return dict(picture_scores(torch.from_numpy(blurred), observation))


def _sharp_scores(
    pictures: Float[Array, "R H W 4"], sharp: Float[Array, "T 8 H W 4"], observation: Observation
) -> Scores:
    """Return PSNR and SSIM of the predicted sub-frames against the true ones, over the plate, in the person's box."""
    times_s = _clock(len(pictures), observation)
    true = sharp.reshape(-1, *sharp.shape[2:])
    claimed = pictures[_nearest(_clock(len(true), observation), times_s)]
    rows, columns = (np.flatnonzero(sharp[..., 3].max((0, 1)).max(axis) > 0.5 / 255) for axis in (1, 0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    plate = observation.plate_linear
    pairs = [
        [observation.to_srgb(compose(torch.from_numpy(one), plate))[window].numpy() for one in pair]
        for pair in zip(claimed, true, strict=True)
    ]
    scores: Scores = {"sharp_psnr_db": float(np.mean([psnr_db(*pair) for pair in pairs]))}
    if min(pairs[0][0].shape[:2]) >= _SSIM_WINDOW_PX:
        scores["sharp_ssim"] = float(np.mean([ssim(*pair) for pair in pairs]))
    return scores


def _clock(rows: int, observation: Observation) -> Float[Array, "R"]:
    frames = observation.mattes.shape[0]
    return subframe_times_s(frames, rows // frames, observation.exposure_s, observation.interval_s)[0]


def _nearest(times_s: Float[Array, "R"], of_s: Float[Array, "Q"]) -> Int[Array, "R"]:
    return np.abs(of_s[None, :] - times_s[:, None]).argmin(1)


def _finite(value: Any) -> Any:
    """Return None for a value that is not finite."""
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return value if value is None or np.isfinite(value) else None
