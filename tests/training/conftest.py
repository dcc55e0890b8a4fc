"""Tiny recordings and photographs to train on."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.sources import open_motions
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.interop.writers.bvh import bvh_text
from hfb.motion.sampled import SampledMotion

_CLIPS = ("01_01", "01_02", "01_03", "01_04", "09_01")
_NAMES = {
    "pelvis": "CC_Base_Hip",
    "spine1": "CC_Base_Waist",
    "spine2": "CC_Base_Spine01",
    "spine3": "CC_Base_Spine02",
    "neck": "CC_Base_NeckTwist01",
    "head": "CC_Base_Head",
}
_LIMBS = {
    "hip": "Thigh",
    "knee": "Calf",
    "ankle": "Foot",
    "foot": "ToeBase",
    "collar": "Clavicle",
    "shoulder": "Upperarm",
    "elbow": "Forearm",
    "wrist": "Hand",
    "hand": "Mid1",
}
_NAMES |= {
    f"{side}_{ours}": f"CC_Base_{side[0].upper()}_{cc}" for side in ("left", "right") for ours, cc in _LIMBS.items()
}


@pytest.fixture(scope="session")
def mocap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built-in motions as clips of CMU's: four of a subject to learn from, one of a subject held out."""
    folder = tmp_path_factory.mktemp("mocap")
    source = open_motions(None, 0)
    for number, clip in enumerate(_CLIPS):
        text = bvh_text(_seen(source.load(number)))
        for ours, theirs in _NAMES.items():
            text = text.replace(f"JOINT {ours}\n", f"JOINT {theirs}\n").replace(f"ROOT {ours}\n", f"ROOT {theirs}\n")
        (folder / f"cmu_{clip}.bvh").write_text(text)
    return folder


def _seen(clip: MotionClip) -> SampledMotion:
    """A built-in motion in a camera's axes, y down."""
    frames = min(len(clip.poses), 90)
    flip = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    turns = axis_angle_to_matrix(torch.from_numpy(clip.poses[:frames]).float())
    turns[:, 0] = flip @ turns[:, 0]
    places = torch.from_numpy(clip.translations[:frames]).float() @ flip
    joints = load_default_body().shape(torch.zeros(10)).joints_of(turns, places)
    poses = matrix_to_axis_angle(turns).reshape(frames, 72).double().numpy()
    times_s = np.arange(frames) / clip.fps
    return SampledMotion(
        poses, places.double().numpy(), np.zeros(10), joints.double().numpy(), times_s, np.zeros(frames, int), np.eye(3)
    )


@pytest.fixture(scope="session")
def backgrounds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four scenes in each of three folders."""
    folder = tmp_path_factory.mktemp("backgrounds")
    rng = np.random.default_rng(0)
    for name in ("polyhaven", "budgie", "textures"):
        (folder / name).mkdir()
        for scene in range(4):
            small = rng.integers(0, 256, (6, 6, 3), np.uint8)
            cv2.imwrite(str(folder / name / f"scene{scene}_0.png"), cv2.resize(small, (64, 64)))
    return folder
