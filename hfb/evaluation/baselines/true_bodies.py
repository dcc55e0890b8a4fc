"""Bodies at the true pose of a case: copied from a true motion, or registered to the known joints of real video."""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT
from hfb.datasets.case import Case
from hfb.datasets.truth import JointTruth, Truth, load_truth_of
from hfb.errors import InputError
from hfb.initialization.point_registration import register_joints
from hfb.kernels.determinism import one_torch_thread
from hfb.typing import Array, Float, Int, Tensor

_LEAST_JOINTS = 6  # fewer tell no body
_INSTANTS = 8  # of each exposure of a dense truth


@dataclass(frozen=True)
class TrueBodies:
    """The body of one person at M true instants.

    Attributes:
        times_s: since the first shutter opened [s].
        frame_index: the exposure of each instant.
        joints: the truth's joints [m], NaN where unknown.
        poses: axis-angle [rad].
        translations: [m].
        betas: None where the truth has those of another body model.
    """

    times_s: Float[Array, "M"]
    frame_index: Int[Array, "M"]
    joints: Float[Array, "M 24 3"]
    poses: Float[Tensor, "M 24 3"]
    translations: Float[Tensor, "M 3"]
    betas: Float[Tensor, "10"] | None

    def nearest(self, times_s: Float[Array, "T"]) -> Int[Array, "T"]:
        """Return the index of the instant nearest to each time.

        Args:
            times_s: since the first shutter opened [s].
        """
        return np.abs(self.times_s[None] - times_s[:, None]).argmin(1)


def true_bodies(case: Case, body: Body) -> TrueBodies:
    """Return the bodies at the truth's instants.

    A true motion is copied. To known joints the body is registered, with one shape for all instants; the anatomical
    prior sets what they leave open (head, hands, feet).

    Args:
        case: the case.
        body: the body model.

    Raises:
        InputError: there is no truth, or it knows too few joints for a body.
    """
    truth = load_truth_of(case.truth)
    if isinstance(truth, JointTruth):
        return _laid_on(truth, body, case)
    motion, same = truth.motion, truth.betas_space == body.betas_space
    return TrueBodies(
        motion.times_s,
        motion.frame_index,
        motion.joints,
        torch.from_numpy(motion.poses).unflatten(1, (24, 3)),
        torch.from_numpy(motion.trans),
        torch.from_numpy(motion.betas) if same else None,
    )


def bodies_on_joints(case: Case, body: Body) -> TrueBodies:
    """Return the bodies registered to the true joints, also where the truth has a motion.

    Args:
        case: the case.
        body: the body model.

    Raises:
        InputError: there is no truth, or it knows too few joints for a body.
    """
    truth = load_truth_of(case.truth)
    return _laid_on(_some_joints(truth) if isinstance(truth, Truth) else truth, body, case)


def _some_joints(truth: Truth) -> JointTruth:
    """Return all joints at a few instants of each exposure of a dense truth."""
    motion = truth.motion
    rows = np.concatenate(
        [
            own[np.linspace(0, len(own) - 1, min(_INSTANTS, len(own))).round().astype(int)]
            for own in (motion.rows_of(int(frame)) for frame in np.unique(motion.frame_index))
        ]
    )
    every = np.arange(JOINT_COUNT)
    return JointTruth(motion.joints[rows], every, motion.times_s[rows], motion.frame_index[rows], ("",) * JOINT_COUNT)


def _laid_on(truth: JointTruth, body: Body, case: Case) -> TrueBodies:
    joints = np.full((len(truth.joints), JOINT_COUNT, 3), np.nan)
    joints[:, truth.smpl_joints] = truth.joints
    enough = np.isfinite(joints).all(-1).sum(1) >= _LEAST_JOINTS
    if set(truth.frame_index[enough].tolist()) != set(range(case.frames)):
        raise InputError(f"{case.folder}: an exposure's truth knows fewer than {_LEAST_JOINTS} joints, no body")
    with one_torch_thread():
        found = register_joints(joints[enough], body)
    return TrueBodies(
        truth.times_s[enough], truth.frame_index[enough], joints[enough], found.poses, found.translations, found.betas
    )
