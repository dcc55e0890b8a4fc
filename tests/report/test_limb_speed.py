"""Speeds, smears and shutters of motions whose every number is known."""

from dataclasses import replace

import numpy as np
import pytest

from hfb.body.assets import load_default_body
from hfb.motion.sampled import SampledMotion
from hfb.report.pages.limb_speed import LIMB_ENDS, exposure_s, instant_speeds, limb_speeds, shutter_for
from hfb.report.pages.result_speeds import shutter_advice, shutter_text
from tests.interop.writers.motions import motion_of

WRIST = LIMB_ENDS["right wrist"]


def thrown(acceleration: float = 0.0, radius_mm: float | None = None) -> SampledMotion:
    """Nobody moves but the right wrist: along x at 4 m/s at first, 2 m away, f = 500 px, 2 frames of 20 ms."""
    motion = motion_of(load_default_body(), frames=2)
    joints = np.zeros_like(motion.joints) + [0.0, 0.0, 2.0]
    time_s = motion.times_s
    joints[:, WRIST, 0] = 4 * time_s + acceleration / 2 * time_s**2
    K = np.array([[500.0, 0, 0], [0, 500, 0], [0, 0, 1]])
    radius = None if radius_mm is None else np.full((len(joints), 24), radius_mm)
    return replace(motion, joints=joints, K=K, joint_radius_mm=radius)


def test_speed_smear_and_shutter() -> None:
    motion = thrown()
    by_limb = {one.limb: one for one in limb_speeds(motion)}
    assert list(by_limb) == list(LIMB_ENDS)
    wrist = by_limb["right wrist"]
    assert wrist.peak_m_s == pytest.approx(4)
    assert wrist.mean_m_s == pytest.approx(4)
    assert wrist.smear_px == pytest.approx(4 * 0.02 / 2 * 500)  # 20 px
    assert wrist.peak_px_s == pytest.approx(1000)
    assert wrist.interval_m_s is None
    assert by_limb["left wrist"].peak_m_s == 0
    assert exposure_s(motion) == pytest.approx(0.02)
    assert shutter_for(wrist.peak_px_s, 1) == 1000
    assert shutter_for(wrist.peak_px_s, 2) == 500
    assert shutter_for(9000, 1) is None
    (said,) = shutter_advice(limb_speeds(motion), exposure_s(motion))
    assert said.startswith("The right wrist smeared 20 px in 1/50 s; 1/1000 s would have frozen it")
    assert "1/500 s nearly" in said


def test_the_fastest_moment_is_found() -> None:
    (wrist,) = [one for one in limb_speeds(thrown(acceleration=60.0)) if one.limb == "right wrist"]
    times, speeds, frames = instant_speeds(thrown(acceleration=60.0))
    assert wrist.frame == 1
    assert wrist.peak_s == pytest.approx(1 / 30 + 0.02 - 0.02 / 14)  # between the last two of eight instants
    assert wrist.peak_m_s == pytest.approx(4 + 60 * wrist.peak_s)
    assert speeds.max() == wrist.peak_m_s
    assert len(times) == len(frames) == 14  # none across the closed shutter
    assert wrist.smear_frame == 1


def test_intervals_widen_with_doubt_and_hold_the_speed() -> None:
    widths = []
    for radius in (10.0, 40.0):
        (wrist,) = [one for one in limb_speeds(thrown(radius_mm=radius)) if one.limb == "right wrist"]
        assert wrist.interval_m_s is not None
        low, high = wrist.interval_m_s
        assert 0 <= low < 4 < high
        widths.append(high - low)
    assert widths[1] > 2 * widths[0]


def test_advice_knows_its_limits() -> None:
    motion = thrown()
    still = replace(motion, joints=np.zeros_like(motion.joints) + [0.0, 0.0, 2.0])
    assert shutter_advice(limb_speeds(still), 0.02) == []
    fast = replace(motion, K=motion.K * [[40], [40], [1]])
    assert "a flash" in shutter_advice(limb_speeds(fast), 0.02)[0]
    assert shutter_text(1 / 30) == "1/30 s"
    assert shutter_text(0.5) == "0.5 s"
