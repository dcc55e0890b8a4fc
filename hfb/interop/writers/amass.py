"""amass.npz for AMASS's tools and Blender's SMPL add-on (SMPL-H's 156 columns, z up, an even rate)."""

from pathlib import Path

import numpy as np
import torch

from hfb.body.model import BetasSpace
from hfb.config import AmassRate
from hfb.geometry.placement import z_up
from hfb.geometry.rotations import quaternion_to_axis_angle
from hfb.interop.writers.keys import even_keys, rest_joints, turned
from hfb.motion.motion_file import write_arrays
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array

_COLUMNS, _BODY_COLUMNS, _BETAS, _DMPLS = 156, 66, 16, 8


def amass_arrays(motion: SampledMotion, betas_space: BetasSpace, rate: AmassRate = 120) -> dict[str, Array]:
    """Return the members of the file.

    AMASS's own are ``poses`` (F, 156): root, 21 body joints, fingers at rest; ``trans``, ``betas``, ``dmpls``,
    ``gender``, ``mocap_framerate``. Readers would take other betas for SMPL's, so ``betas`` is zero then, and they are
    in ``hfb_betas``. Additional members, under names that no AMASS tool uses, are ``hfb_joints`` (F, 24, 3) m in the
    same world, ``hfb_times_s``, ``hfb_observed`` (the shutter was open), ``hfb_present`` (the person was there),
    ``betas_space``, ``hfb_world`` (whose world it is, `World.source`).

    The world is the motion's with z up; of a level camera it looks along +y.

    Args:
        motion: camera coordinates.
        betas_space: space of the betas, ``smpl`` or ``hfb``.
        rate: frames per second of the file.

    Raises:
        InputError: the motion's instants are not in order.
    """
    keys = even_keys(motion, float(rate))
    rest, placed = rest_joints(motion), z_up(motion.export_world)
    poses = np.zeros((len(keys.times_s), _COLUMNS))
    rotations = quaternion_to_axis_angle(torch.from_numpy(turned(keys.quaternions, placed.quaternion()))).numpy()
    poses[:, :_BODY_COLUMNS] = rotations.reshape(len(poses), -1)[:, :_BODY_COLUMNS]
    joints = placed.points(keys.places)
    betas = np.zeros(_BETAS)
    if betas_space == "smpl":
        betas[: len(motion.betas)] = motion.betas
    return {
        "poses": poses,
        "trans": joints[:, 0] - rest[0],  # SMPL's root turns about its own joint, which stays at rest plus trans
        "betas": betas,
        "dmpls": np.zeros((len(poses), _DMPLS)),
        "gender": np.array("neutral"),
        "mocap_framerate": np.array(float(rate)),
        "hfb_joints": joints,
        "hfb_times_s": keys.times_s,
        "hfb_observed": keys.observed,
        "hfb_present": keys.present,
        "hfb_betas": motion.betas,
        "betas_space": np.array(betas_space),
        "hfb_world": np.array(motion.export_world.source),
    }


def write_amass(path: Path, motion: SampledMotion, betas_space: BetasSpace, rate: AmassRate = 120) -> None:
    """Write the file whole or not at all; see `amass_arrays`.

    Args:
        path: the file.
        motion: camera coordinates.
        betas_space: space of the betas, ``smpl`` or ``hfb``.
        rate: frames per second of the file.
    """
    write_arrays(path, amass_arrays(motion, betas_space, rate))
