"""When the shutter was open: who wins, true times, the position in the frame."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hfb.config import ExposureConfig
from hfb.errors import InputError
from hfb.io.clip import ClipExposure
from hfb.io.media.footage import Footage
from hfb.io.media.timing import settle_timing

TIMES = np.array([2.0, 2.04, 2.08, 2.16])
FOOTAGE = Footage(Path("a.mp4"), (Path("a.mp4"),), 48, 64, TIMES, 0.04, 8, "srgb")
NOTHING = ExposureConfig()


@pytest.mark.parametrize(
    ("told", "config", "exposure_s", "source"),
    [
        (ClipExposure(), NOTHING, 0.04, "assumed"),
        (ClipExposure(shutter_fraction=0.5), NOTHING, 0.02, "clip.toml"),
        (ClipExposure(shutter_angle=90), NOTHING, 0.01, "clip.toml"),
        (ClipExposure(seconds=0.03), ExposureConfig(seconds=0.025), 0.025, "options"),
        (ClipExposure(auto=True), NOTHING, 0.04, "asked for as auto"),
    ],
)
def test_who_wins(told: ClipExposure, config: ExposureConfig, exposure_s: float, source: str) -> None:
    timing = settle_timing(FOOTAGE, told, config)
    assert timing.exposure_s == pytest.approx(exposure_s)
    assert source in timing.source
    assert np.allclose(timing.openings_s, TIMES - 2)


def test_what_the_footage_recorded() -> None:
    footage = replace(FOOTAGE, recorded_exposure=(0.008, "the video's own entry ExposureTime"))
    timing = settle_timing(footage, ClipExposure(auto=True), NOTHING)
    assert timing.exposure_s == 0.008
    assert "ExposureTime" in timing.source


@pytest.mark.parametrize(("position", "late_s"), [("start", 0), ("middle", 0.015), ("end", 0.03)])
def test_where_the_exposure_lies_in_the_frame(position: str, late_s: float) -> None:
    timing = settle_timing(FOOTAGE, ClipExposure(seconds=0.01, position=position), NOTHING)
    assert timing.first_opening_s == pytest.approx(2 + late_s)
    assert timing.openings_s[0] == 0


def test_an_average_is_open_all_the_time() -> None:
    footage = replace(FOOTAGE, average=4, interval_s=0.16, times_s=np.array([0, 0.16]))
    timing = settle_timing(footage, ClipExposure(seconds=0.002), NOTHING)
    assert timing.exposure_s == timing.interval_s == pytest.approx(0.16)
    assert "mean of 4 frames" in timing.source


def test_longer_than_the_interval() -> None:
    with pytest.raises(InputError, match="does not fit"):
        settle_timing(FOOTAGE, ClipExposure(seconds=0.05), NOTHING)
