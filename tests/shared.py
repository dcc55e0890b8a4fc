"""Real recordings beside the project, and inputs on which hfb was wrong; tests that need them are skipped elsewhere."""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from hfb.photometry import srgb_to_linear

_BESIDE = Path(__file__).parents[2] / "shared"
SHARED_DATA = Path(os.environ.get("HFB_SHARED_DATA", _BESIDE / "data"))
REPORTS = _BESIDE / "reports"


def average_frames(frames_srgb: Iterable[np.ndarray]) -> np.ndarray:
    """One long exposure: the mean of the frames' linear light."""
    return np.mean([srgb_to_linear(frame) for frame in frames_srgb], axis=0, dtype=np.float64).astype(np.float32)
