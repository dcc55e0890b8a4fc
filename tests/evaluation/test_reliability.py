"""Said against happened: counted by hand."""

import numpy as np
import pytest
from pandas import DataFrame

from hfb.evaluation.metrics import errors_mm
from hfb.evaluation.reliability import WITHIN, direction_groups, direction_row, joint_row, reliability_cell
from hfb.evaluation.tables import summarize, table_markdown
from hfb.fitting.confidence import radius_factor
from tests.fitting.test_alternatives import swinging

BINS = [(0.0, 1.0)]


def test_shares_within_a_radius_by_hand() -> None:
    # One joint far out holds the axes, so that the alignment turns nothing; the others are off by 10 mm along them.
    rng = np.random.default_rng(0)
    true = rng.normal(0, 0.5, (6, 24, 3))
    true[:, 0] = 0
    joints = true.copy()
    joints[:, 1:13] *= 1 + 0.01 / np.linalg.norm(true[:, 1:13], axis=-1, keepdims=True)
    row = joint_row(errors_mm(joints, true)[:, 1:], np.full((6, 23), 5.0), 1.5)
    assert row["radius_mm"] == 5
    # 11 of 23 joints are right; 10 mm is twice the radius, which holds 1 - 2^-(2^1.5) = 86 %
    assert row["within_p50"] == pytest.approx(11 / 23, abs=0.05)
    assert row["within_p75"] == pytest.approx(11 / 23, abs=0.05)
    assert row["within_p90"] == pytest.approx(1, abs=0.05)
    assert radius_factor(0.75, 1.5) < 2 < radius_factor(0.9, 1.5)


def test_what_is_not_known_counts_nowhere() -> None:
    errors = np.array([[1.0, np.nan], [9.0, 9.0]])
    row = joint_row(errors, np.array([[5.0, 1.0], [5.0, 5.0]]), 1.5)
    assert row["within_p50"] == pytest.approx(1 / 3)
    assert row["radius_mm"] == 5
    assert joint_row(np.full((2, 2), np.nan), np.ones((2, 2)), 1.5) == {}


def test_the_row_of_directions() -> None:
    assert direction_row(swinging((0.4, 0.3, 0.2, 0.1), frames=2)) == {"direction_said": pytest.approx(0.7)}


def _values(said: list[float], wrong: list[float], within: float = 0.5) -> DataFrame:
    shares = {name: np.full(len(said), within) for name in WITHIN}
    return DataFrame({**shares, "radius_mm": 20.0, "direction_said": said, "wrong_direction": wrong})


def test_groups_and_calibration_errors_by_hand() -> None:
    values = _values([0.55, 0.55, 0.95, 0.95, np.nan], [1, 0, 0, 0, 1])
    groups = direction_groups(values)
    assert [group["n"] for group in groups] == [2, 2]
    assert [group["right"] for group in groups] == [0.5, 1.0]
    cell = reliability_cell(values)
    assert cell["direction_said"] == pytest.approx(0.75)
    assert cell["direction_error"] == pytest.approx(0.05)
    assert cell["radius_error"] == pytest.approx(np.mean([0.4, 0.25, 0, 0.25, 0.4]))


def test_a_method_that_says_nothing_has_empty_entries() -> None:
    nothing = DataFrame(np.nan, [0, 1], [*WITHIN, "radius_mm", "direction_said", "wrong_direction"])
    assert set(reliability_cell(nothing).values()) == {None}


def _rows(sure: bool) -> list[dict]:
    said = dict.fromkeys(WITHIN, 0.6) | {"radius_mm": 30.0, "direction_said": 0.8}
    numbers = {"blur_rate": 0.3, "failed": None, "initial_mpjpe_mm": 90.0, "mpjpe_mm": 60.0, "wrong_direction": 0.0}
    return [{"case": case, "method": "best", **numbers, **(said if sure else {})} for case in range(3)]


def test_the_page_has_a_section_where_a_method_says_how_sure_it_is() -> None:
    summary = summarize(_rows(sure=True), "bt-amass", 3, {}, 0, BINS)
    assert summary["methods"]["best"]["all"]["within_p90"] == pytest.approx(0.6)
    page = table_markdown(summary)
    assert "How sure it is" in page
    assert "80" in page.split("How sure it is")[1]
    assert "How sure it is" not in table_markdown(summarize(_rows(sure=False), "bt-amass", 3, {}, 0, BINS))
