"""A real fit of a recording whose camera stands 26 degrees off level: exports stand upright, as the measured joints."""

from pathlib import Path

import numpy as np
import pytest

import hfb
from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.real.case_windows import RealWindow
from hfb.datasets.real.markers import read_trc
from hfb.datasets.real.real_case import make_real_case
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.real.source_videos import open_footage
from hfb.datasets.real.video_assets import find_recording
from tests.shared import SHARED_DATA

_RECORDING = SHARED_DATA / "pose2sim_balancing"
_FIRST, _AVERAGE = 1, 5


def lean_deg(hips: np.ndarray, shoulders: np.ndarray, up: int) -> float:
    """Mean angle between the trunk, both sides' mean, and an axis."""
    trunk = (shoulders - hips).mean(1)
    return float(np.degrees(np.arccos(trunk[:, up] / np.linalg.norm(trunk, axis=-1))).mean())


def test_the_trunk_leans_as_it_was_measured(tmp_path: Path) -> None:
    if not _RECORDING.is_dir():
        pytest.skip(f"{_RECORDING} is not there")
    with np.load(_RECORDING / "joints3d.npz", allow_pickle=False) as file:
        rows = slice(_FIRST - 1, _FIRST - 1 + _AVERAGE)  # a row shows the frame after it
        true = {name: file["xyz"][rows, number] for number, name in enumerate(file["names"].tolist())}
    hips, shoulders = (np.stack([true[f"{side}{part}"] for side in "LR"], 1) for part in ("Hip", "Shoulder"))
    measured = lean_deg(hips, shoulders, up=2)
    assert 3 < measured < 6

    footage = open_footage(_RECORDING / "cam01_f000-059.mp4")
    spec = RealSpec(set="real", videos=(_RECORDING,), average=(_AVERAGE,))
    case = make_real_case(spec, 1, RealWindow(find_recording(footage)[0], _FIRST, _AVERAGE), tmp_path / "case")
    (frame,) = case.frame_paths()
    result = hfb.fit(frame, case.background, clip=case.clip, directions={"search": False})
    path = tmp_path / "joints.trc"
    assert result.export("trc", folder=tmp_path) == [path]
    read = read_trc(path)
    at = {name: read.xyz_m[:, number] for number, name in enumerate(JOINT_NAMES)}
    limbs = [np.stack([at[f"{side}_{part}"] for side in ("left", "right")], 1) for part in ("hip", "shoulder")]
    assert lean_deg(*limbs, up=1) == pytest.approx(measured, abs=6)
    # Pose2Sim's axes: its world is y, z, x of the table. The calibrated distance is about as good as a tape's.
    place = np.stack([at["left_hip"], at["right_hip"]], 1).mean((0, 1))[[2, 0, 1]]
    assert np.linalg.norm(place - hips.mean((0, 1))) < 0.5
