"""truth.npz: the true motion of a case, for evaluation only.

A synthetic case has the whole motion and every silhouette (`Truth`); real video has the positions of some joints
(`JointTruth`). The file's members determine the kind.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hfb.body.skeleton import JOINT_COUNT
from hfb.errors import InputError
from hfb.io.array_files import names_in, read_arrays
from hfb.motion.motion_file import load_motion, motion_arrays, write_arrays
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool, Float, Int


@dataclass(frozen=True)
class Truth:
    """True motion at dense instants and the silhouette at each of them."""

    motion: SampledMotion
    silhouettes: Bool[Array, "R H W"]
    betas_space: str


@dataclass(frozen=True)
class JointTruth:
    """Positions of some joints of a person in a real video.

    Attributes:
        joints: camera coordinates [m]; NaN (all three numbers) where a joint is unknown at an instant.
        smpl_joints: the SMPL joints that they stand for, 0..23.
        times_s: time since the first shutter opened [s].
        frame_index: the frame each row belongs to.
        names: names of the joints, as their source calls them.
    """

    joints: Float[Array, "R P 3"]
    smpl_joints: Int[Array, "P"]
    times_s: Float[Array, "R"]
    frame_index: Int[Array, "R"]
    names: tuple[str, ...]


def save_truth(path: Path, truth: Truth) -> None:
    """Write a truth file whole or not at all: a motion file with one more member, silhouettes packed to bits.

    Args:
        path: the .npz file.
        truth: the case's truth.
    """
    silhouettes = {
        "silhouettes": np.packbits(truth.silhouettes, axis=-1),
        "silhouette_width": np.array(truth.silhouettes.shape[-1]),
    }
    write_arrays(path, motion_arrays(truth.motion, truth.betas_space) | silhouettes)


def load_truth(path: Path) -> Truth:
    """Read a truth file.

    Args:
        path: the .npz file.

    Raises:
        InputError: not a truth file.
    """
    motion, betas_space = load_motion(path)
    try:
        found = read_arrays(path, ("silhouettes", "silhouette_width"))
        bits = np.unpackbits(found["silhouettes"], axis=-1, count=int(found["silhouette_width"]))
    except KeyError:
        raise InputError(f"{path} holds a motion but no true silhouettes; make a case with `hfb demo`") from None
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path} is not a truth file of hfb ({error}); make the case again") from None
    return Truth(motion, bits.astype(bool), betas_space)


def save_joint_truth(path: Path, truth: JointTruth) -> None:
    """Write known joints whole or not at all (.npz, no pickle).

    Args:
        path: the .npz file.
        truth: the case's truth.
    """
    write_arrays(
        path,
        {
            "joints": truth.joints,
            "smpl_joints": truth.smpl_joints,
            "times_s": truth.times_s,
            "frame_index": truth.frame_index,
            "names": np.array(truth.names, dtype=np.str_),
        },
    )


def load_joint_truth(path: Path) -> JointTruth:
    """Read the known joints of a real video.

    Args:
        path: the .npz file.

    Raises:
        InputError: missing, damaged, or its members do not fit each other.
    """
    try:
        found = read_arrays(path)
        truth = JointTruth(
            joints=np.asarray(found["joints"], np.float64),
            smpl_joints=np.asarray(found["smpl_joints"], np.int64),
            times_s=np.asarray(found["times_s"], np.float64),
            frame_index=np.asarray(found["frame_index"], np.int64),
            names=tuple(str(name) for name in np.atleast_1d(found["names"])),
        )
    except FileNotFoundError:
        raise InputError(f"there is no truth file at {path}") from None
    except (KeyError, ValueError, TypeError, OSError) as error:
        raise InputError(f"{path} is not a truth file of hfb ({error}); make the case again") from None
    wrong = _what_does_not_fit(truth)
    if wrong:
        raise InputError(f"{path} is not a truth file of hfb ({wrong}); make the case again")
    return truth


def load_truth_of(path: Path) -> Truth | JointTruth:
    """Read either kind of truth file.

    Args:
        path: the .npz file.

    Raises:
        InputError: neither kind.
    """
    try:
        joints_alone = "smpl_joints" in names_in(path)
    except FileNotFoundError:
        raise InputError(f"there is no truth file at {path}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a truth file of hfb ({error}); make the case again") from None
    return load_joint_truth(path) if joints_alone else load_truth(path)


def _what_does_not_fit(truth: JointTruth) -> str:
    """Describe a mismatch of rows, joints and names; empty where all match and every joint is one of SMPL's, once."""
    count = len(truth.names)
    if truth.joints.ndim != 3 or truth.joints.shape[1:] != (count, 3) or truth.smpl_joints.shape != (count,):
        return "joints, smpl_joints and names differ in number"
    if {truth.times_s.shape, truth.frame_index.shape} != {truth.joints.shape[:1]}:
        return "joints, times_s and frame_index differ in number"
    known = set(truth.smpl_joints.tolist())
    if len(known) != count or not known <= set(range(JOINT_COUNT)):
        return "smpl_joints must be different numbers from 0 to 23"
    return ""
