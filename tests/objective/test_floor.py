"""The term that keeps feet above a stated floor: its value, its slope, and when there is none."""

from typing import Any

import pytest
import torch

from hfb.config import FitConfig
from hfb.geometry.placement import with_floor, z_up
from hfb.objective.floor import floor_terms, sunk_soles

_FLOOR = with_floor(None, (0, 1, 0, 1.2))  # 1.2 m below a level camera


def value(toe_m: float, ankle_m: float) -> torch.Tensor:
    """Of one instant, with both toes and ankles at heights above the floor."""
    joints = torch.zeros(1, 1, 24, 3, dtype=torch.float64)
    joints[..., [10, 11], 1] = 1.2 - toe_m
    joints[..., [7, 8], 1] = 1.2 - ankle_m
    assert _FLOOR is not None
    return sunk_soles(joints, z_up(_FLOOR))


def test_only_what_sinks_counts() -> None:
    assert value(0.01, 0.08).item() == pytest.approx(0, abs=1e-15)
    assert value(0.5, 0.6).item() == 0
    assert value(-0.09, 0.08).item() == pytest.approx(2 * 0.01 / (1 + 0.01 / 0.09))
    assert value(0.01, 0.05).item() == pytest.approx(2 * 0.0009 / (1 + 0.0009 / 0.09))


def test_a_floor_that_is_far_off_does_not_pull() -> None:
    def slope(depth_m: float) -> float:
        return (value(-depth_m - 1e-4, 1).item() - value(-depth_m, 1).item()) / 1e-4

    assert slope(0.1) > 0.2
    assert slope(1.0) < 0.05


def test_no_term() -> None:
    assert floor_terms(None, FitConfig()) == ()
    assert floor_terms(with_floor(None, "estimate"), FitConfig()) == ()
    assert [one.name for one in floor_terms(_FLOOR, FitConfig())] == ["sunk_soles"]
    on_device: Any = "warp"
    assert floor_terms(_FLOOR, FitConfig(rasterizer=on_device)) == ()
