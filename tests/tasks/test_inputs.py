"""What a user hands over: a calibration file is taken by its numbers."""

import json
from pathlib import Path

import numpy as np
import pytest

from hfb.config import RunConfig
from hfb.errors import InputError
from hfb.media.pictures import write_png
from tasks.inputs import take_inputs


def calibrated(folder: Path, distortion: list[float]) -> tuple[Path, Path]:
    """(picture, clip.toml) of a camera with this lens."""
    write_png(folder / "f.png", np.zeros((48, 64, 3), np.float32))
    matrix = [[80.0, 0, 31.5], [0, 80, 23.5], [0, 0, 1]]
    (folder / "calib.json").write_text(json.dumps({"camera_matrix": matrix, "dist_coeffs": distortion}))
    (folder / "clip.toml").write_text('[camera]\ncalibration = "calib.json"\n')
    return folder / "f.png", folder / "clip.toml"


def test_a_calibration_file_becomes_numbers(tmp_path: Path) -> None:
    picture, clip = calibrated(tmp_path, [0.0] * 5)
    taken = take_inputs([picture], picture, RunConfig(), clip)
    assert taken.clip.camera.K == ((80, 0, 32), (0, 80, 24), (0, 0, 1))
    assert taken.clip.camera.calibration is None


def test_single_pictures_are_not_undistorted(tmp_path: Path) -> None:
    picture, clip = calibrated(tmp_path, [-0.3, 0.1, 0.0, 0.0])
    with pytest.raises(InputError, match=r"this lens distorts; undistort .* or use `hfb video`"):
        take_inputs([picture], picture, RunConfig(), clip)
