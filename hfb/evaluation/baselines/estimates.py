"""Single estimates of a body, complete or not, and their conversion to a prediction."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.model import Body
from hfb.evaluation.baselines.rows import motion_of_rows, points_at, poses_at, row_times_s
from hfb.motion.sampled import SampledMotion
from hfb.motion.static_pose import FirstBody
from hfb.rendering.observation import Observation
from hfb.typing import Array, Float, Tensor


@dataclass(frozen=True)
class Estimate:
    """The estimate at one instant: a pose, or joints alone.

    Attributes:
        pose: axis-angle [rad], camera frame; None where only joints are known.
        translation: None where the system does not say; then the start's hold.
        betas: None where the system does not say; then the start's hold.
        joints: [m], camera axes; NaN where a joint of the 24 is not known.
    """

    pose: Float[Tensor, "24 3"] | None = None
    translation: Float[Tensor, "3"] | None = None
    betas: Float[Tensor, "10"] | None = None
    joints: Float[Array, "24 3"] | None = None

    @staticmethod
    def of(first: FirstBody) -> "Estimate":
        """Convert a first body.

        Args:
            first: result of an initialiser.
        """
        return Estimate(first.pose, first.translation, first.betas)


def interpolate(
    estimates: Sequence[Sequence[Estimate | None]],
    times: Float[Array, "M"],
    observation: Observation,
    starts: Sequence[FirstBody],
    body: Body,
    subframes: int,
) -> tuple[SampledMotion | None, Float[Array, "R 24 3"] | None]:
    """Interpolate estimates to a prediction's rows: (motion, None), or (None, joints) where no poses are known.

    Within a frame the body moves between its estimates along straight lines and great circles, and is held beyond them.
    A single estimate per frame is interpolated from frame to frame.

    Args:
        estimates: estimates of each frame's sub-frames, None where the person was not found; at least one per frame.
        times: times of the sub-frames, in exposures.
        observation: the blurred frames with their clock.
        starts: first body of each frame, used for what an estimate lacks.
        body: model of the result.
        subframes: rows per frame.
    """
    rows_s, frame_index = row_times_s(observation, subframes)
    pieces = []
    for frame, found in enumerate(estimates):
        opened = frame * observation.interval_s
        known = [(opened + u * observation.exposure_s, one) for u, one in zip(times, found, strict=True) if one]
        pieces.append((rows_s[frame_index == frame], known, starts[frame]))
    if len(times) == 1:
        every = [(when, one, start) for _, known, start in pieces for when, one in known]
        known_s = np.array([when for when, *_ in every])
        parts = [_tracks(rows_s, known_s, [one for _, one, _ in every], [start for *_, start in every])]
    else:
        parts = [
            _tracks(when, np.array([t for t, _ in known]), [one for _, one in known], [start] * len(known))
            for when, known, start in pieces
        ]
    if parts[0][0] is None:
        return None, np.concatenate([joints.double().numpy() for _, _, joints in parts])
    poses = torch.cat([pose for pose, _, _ in parts if pose is not None])
    said = [one.betas for found in estimates for one in found if one is not None and one.betas is not None]
    betas = torch.stack(said or [start.betas for start in starts]).mean(0)
    translations = torch.cat([translation for _, translation, _ in parts])
    return motion_of_rows(poses, translations, betas, observation, body), None


def _tracks(
    rows_s: Float[Array, "R"], known_s: Float[Array, "M"], found: Sequence[Estimate], starts: Sequence[FirstBody]
) -> tuple[Tensor | None, Tensor, Tensor]:
    """Return poses (None without any), translations and joints at the rows."""
    places = [
        start.translation if one.translation is None else one.translation
        for one, start in zip(found, starts, strict=True)
    ]
    translations = points_at(rows_s, known_s, torch.stack(places))
    poses = [one.pose for one in found if one.pose is not None]
    if len(poses) == len(found):
        return poses_at(rows_s, known_s, torch.stack(poses)), translations, translations
    joints = np.stack([one.joints for one in found if one.joints is not None])
    return None, translations, points_at(rows_s, known_s, torch.from_numpy(joints))
