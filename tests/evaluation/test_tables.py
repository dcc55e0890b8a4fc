"""Summaries: hand-computed cells, edges of bins, intervals that cover, and pages that say what the numbers say."""

import json
import math
import random

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hfb.errors import InputError
from hfb.evaluation.tables import summarize, table_markdown

BINS = [(0.1, 0.2), (0.2, 0.4)]
NAMED_IN_THE_INTERFACE = {
    "n",
    "initial_mpjpe_mm",
    "mpjpe_mm",
    "ratio",
    "ratio_ci95",
    "pa_mpjpe_mm",
    "initial_iou",
    "iou",
    "better_than_start",
    "wrong_direction",
    "best_of_two_mpjpe_mm",
    "seconds_per_case",
}


def _row(case: int, method: str = "best", blur_rate: float | None = 0.15, **values) -> dict:
    return {"case": case, "method": method, "blur_rate": blur_rate, "failed": None, **values}


def _fitted(case: int, initial: float, fitted: float, blur_rate: float | None = 0.15, method: str = "best") -> dict:
    return _row(case, method, blur_rate, initial_mpjpe_mm=initial, mpjpe_mm=fitted)


def _summary(rows, **options) -> dict:
    return summarize(rows, "bt-amass", 9, {}, 3, BINS, **options)


def test_a_cell_by_hand():
    rows = [
        _row(
            case, initial_mpjpe_mm=initial, mpjpe_mm=fitted, pa_mpjpe_mm=pa, better_mpjpe_mm=better,
            initial_iou=0.5, iou=iou, wrong_direction=wrong, seconds=seconds, blur_rate=0.15,
        )
        for case, initial, fitted, pa, better, iou, wrong, seconds in [
            (1, 100.0, 50.0, 40.0, 45.0, 0.7, 0.0, 2.0),
            (2, 60.0, 70.0, 50.0, 65.0, 0.8, 1.0, 4.0),
            (3, 40.0, 40.0, 30.0, 40.0, 0.9, 0.5, 3.0),
        ]
    ]  # fmt: skip
    cell = _summary(rows)["methods"]["best"]["all"]
    assert cell["n"] == cell["n_pose"] == 3
    assert cell["initial_mpjpe_mm"] == pytest.approx(200 / 3)
    assert cell["mpjpe_mm"] == pytest.approx(160 / 3)
    assert cell["ratio"] == pytest.approx(0.8)  # of the means, not the mean of .5, 1.17 and 1
    assert cell["ratio_ci95"] is cell["mpjpe_ci95"] is cell["iou_ci95"] is None  # of three cases nothing is known
    assert cell["pa_mpjpe_mm"] == pytest.approx(40)
    assert cell["best_of_two_mpjpe_mm"] == pytest.approx(50)
    assert (cell["initial_iou"], cell["iou"]) == (pytest.approx(0.5), pytest.approx(0.8))
    assert cell["better_than_start"] == pytest.approx(1 / 3)
    assert cell["worse_than_start"] == pytest.approx(1 / 3)
    assert cell["wrong_direction"] == pytest.approx(0.5)
    assert cell["seconds_per_case"] == pytest.approx(3)


def test_the_interface_is_complete_for_full_and_empty_cells():
    summary = summarize([_fitted(1, 100, 50)], "bt-amass", 5, {"a.bvh": "empty"}, 7, BINS, methods=["paper"])
    assert {"set", "count", "skipped", "seed", "methods"} <= set(summary)
    assert (summary["set"], summary["count"], summary["skipped"], summary["seed"]) == ("bt-amass", 5, 1, 7)
    assert summary["skipped_reasons"] == {"a.bvh": "empty"}
    assert list(summary["methods"]) == ["paper", "best"]
    for cells in summary["methods"].values():
        assert set(cells) == {"all", "bins"}
        assert [cell["blur"] for cell in cells["bins"]] == [[0.1, 0.2], [0.2, 0.4]]
        assert all(set(cell) >= NAMED_IN_THE_INTERFACE for cell in [cells["all"], *cells["bins"]])
    empty = summary["methods"]["paper"]["all"]
    assert (empty["n"], empty["mpjpe_mm"], empty["ratio"], empty["better_than_start"]) == (0, None, None, None)


def test_one_case_has_means_and_no_intervals():
    cell = _summary([_fitted(1, 100, 50)])["methods"]["best"]["all"]
    assert (cell["n"], cell["ratio"], cell["ratio_ci95"], cell["mpjpe_ci95"]) == (1, 0.5, None, None)


@pytest.mark.parametrize(
    ("rate", "counts"),
    [(0.1, [1, 0]), (0.2, [0, 1]), (0.4, [0, 1]), (0.0999, [0, 0]), (0.4001, [0, 0]), (None, [0, 0])],
)
def test_rates_on_edges_belong_to_the_upper_bin_and_the_last_bin_is_closed(rate, counts):
    summary = _summary([_fitted(1, 100, 50, rate)])
    assert [cell["n"] for cell in summary["methods"]["best"]["bins"]] == counts
    assert summary["methods"]["best"]["all"]["n"] == 1
    assert summary["outside_bins"] == 1 - sum(counts)


def test_a_failed_case_is_counted_as_failed_and_nowhere_else():
    failed = _row(2, blur_rate=0.15, failed="diverged", mpjpe_mm=None)
    cells = _summary([_fitted(1, 100, 50), failed])["methods"]["best"]
    for cell in (cells["all"], cells["bins"][0]):
        assert (cell["n"], cell["failed"], cell["mpjpe_mm"]) == (1, 1, 50)
    assert cells["bins"][1]["failed"] == 0


def test_a_method_without_a_body_has_silhouettes_and_no_ratio():
    rows = [_row(case, "sfb", initial_mpjpe_mm=100.0, mpjpe_mm=None, initial_iou=0.5, iou=0.4) for case in (1, 2)]
    cell = _summary(rows)["methods"]["sfb"]["all"]
    assert (cell["n"], cell["n_pose"]) == (2, 0)
    assert (cell["mpjpe_mm"], cell["ratio"], cell["ratio_ci95"], cell["better_than_start"]) == (None,) * 4
    assert (cell["initial_mpjpe_mm"], cell["iou"]) == (100, pytest.approx(0.4))


def test_means_and_ratio_are_of_the_same_cases():
    rows = [_fitted(1, 100, 50), _row(2, initial_mpjpe_mm=900.0), _row(3, mpjpe_mm=700.0)]
    cell = _summary(rows)["methods"]["best"]["all"]
    assert (cell["initial_mpjpe_mm"], cell["mpjpe_mm"], cell["ratio"], cell["n_pose"]) == (100, 50, 0.5, 1)


def test_unknown_numbers_never_reach_the_json():
    rows = [_fitted(1, 100, 50), _row(2, initial_mpjpe_mm=math.nan, mpjpe_mm=math.inf, iou=math.nan, seconds=1.0)]
    text = json.dumps(_summary(rows + [_fitted(3, 0, 0, method="paper")]), allow_nan=False)
    assert json.loads(text)["methods"]["paper"]["all"]["ratio"] is None


def test_neither_the_order_of_rows_nor_their_container_matters(tmp_path):
    rng = np.random.default_rng(0)
    rows = [
        {**_fitted(case, *rng.uniform(50, 150, 2), rng.uniform(0.1, 0.4), method), "joint_errors_mm": [1.5] * 24}
        for case in range(1, 30)
        for method in ("best", "paper", "static")
    ]
    rows[7] |= {"failed": "diverged", "mpjpe_mm": None, "joint_errors_mm": None}
    reference = json.dumps(_summary(rows))
    shuffled = random.Random(1).sample(rows, len(rows))
    table = tmp_path / "cases.parquet"
    pd.DataFrame(shuffled).to_parquet(table)
    assert json.dumps(_summary(shuffled)) == reference
    assert json.dumps(_summary(pd.read_parquet(table))) == reference


def test_a_case_that_stands_twice_is_refused():
    with pytest.raises(InputError, match="case 4 stands twice in the results of best"):
        _summary([_fitted(4, 100, 50), _fitted(4, 100, 60)])


@pytest.mark.parametrize("column", ["case", "method"])
def test_a_row_of_nothing_is_refused(column):
    for row in ({**_fitted(1, 100, 50), column: None}, {"iou": 0.5}):
        with pytest.raises(InputError, match="names no case or no method"):
            _summary([_fitted(2, 100, 50), row])


def test_pairs_are_compared_on_the_cases_both_answered():
    ours = [_fitted(1, 100, 40), _fitted(2, 100, 70), _fitted(3, 100, 10)]
    theirs = [_fitted(1, 100, 60, method="paper"), _fitted(2, 100, 60, 0.3, "paper"), _row(3, "paper", failed="no")]
    both = _summary([*ours, *theirs])["comparisons"]["best vs paper"]
    assert both["all"]["n"] == 2
    assert both["all"]["difference_mm"] == pytest.approx(-5)
    assert both["all"]["ratio"] == pytest.approx(110 / 120)
    assert both["all"]["better"] == pytest.approx(0.5)
    assert both["bins"][0]["difference_mm"] == pytest.approx(-20)
    assert "best vs sfb" not in _summary([*ours, _row(1, "sfb", iou=0.5)])["comparisons"]
    assert list(_summary([*ours, *theirs], pairs=[("paper", "best"), ("paper", "none")])["comparisons"]) == [
        "paper vs best"
    ]


def test_equal_methods_differ_by_nothing_whatever_the_draw():
    rows = [_fitted(c, 100, 40 + 7 * c, method=method) for c in range(1, 9) for method in ("best", "paper")]
    both = _summary(rows)["comparisons"]["best vs paper"]["all"]
    assert both["difference_ci95"] == [0, 0]
    assert both["ratio_ci95"] == [1, 1]


def test_the_start_is_known_from_any_method():
    rows = [_fitted(1, 100, 50), _row(2, failed="no"), _fitted(2, 60, 50, method="paper"), _row(3, failed="no")]
    start = _summary(rows)["start"]["all"]
    assert (start["n"], start["mpjpe_mm"]) == (2, 80)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(1, 500), st.floats(0, 500)), min_size=6, max_size=12), st.floats(0.1, 10))
def test_ratios_do_not_depend_on_the_unit_and_lie_in_their_interval(errors, scale):
    def cell(factor: float) -> dict:
        rows = [_fitted(case, factor * first, factor * fit) for case, (first, fit) in enumerate(errors)]
        return _summary(rows)["methods"]["best"]["all"]

    one, other = cell(1.0), cell(scale)
    assert one["ratio"] == pytest.approx(other["ratio"], rel=1e-9, abs=1e-12)
    assert one["ratio_ci95"] == pytest.approx(other["ratio_ci95"], rel=1e-9, abs=1e-12)
    assert one["ratio_ci95"][0] <= one["ratio_ci95"][1]
    ratios = [fit / first for first, fit in errors]
    assert min(ratios) - 1e-9 <= one["ratio"] <= max(ratios) + 1e-9


def _cells(page: str, heading: str) -> dict[str, list[str]]:
    """Rows of the first table under a heading, by their first cell."""
    lines = page.split(f"## {heading}")[1].split("## ")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    assert len({len(row) for row in rows}) == 1, "every row of a table has as many cells"
    return {row[0]: row[1:] for row in rows}


def test_the_page_has_the_papers_layout():
    rows = [_fitted(1, 100, 50), _fitted(2, 100, 90, 0.3), _fitted(3, 80, 40, 0.3)]
    rows += [_fitted(c, i, i, b, "static") for c, i, b in [(1, 100, 0.15), (2, 100, 0.3), (3, 80, 0.3)]]
    rows += [_fitted(1, 100, 60, method="paper"), _fitted(2, 100, 60, 0.3, "paper"), _row(3, "paper", 0.3, failed="x")]
    rows += [_fitted(c, 90, 5, b, "oracle-sharp") for c, b in [(1, 0.15), (2, 0.3), (3, 0.3)]]
    page = table_markdown(_summary(rows, methods=["static", "paper", "best"]), ["starts: simulated", "body: ours"])
    assert "starts: simulated; body: ours." in page
    table = _cells(page, "MPJPE")
    assert list(table) == ["blur rate", ":---", "n", "start (static)", "paper", "best", "*oracle-sharp*"]
    assert table["blur rate"] == ["0.1–0.2", "0.2–0.4", "all"]
    assert table["n"] == ["1", "2", "3"]
    assert table["start (static)"] == ["100.0", "90.0", "93.3"]
    assert table["best"] == ["**50.0**", "65.0", "**60.0**"]
    assert [cell.replace("\u00a0", " ") for cell in table["paper"]] == ["60.0", "**60.0** (n 1)", "**60.0** (n 2)"]
    assert table["*oracle-sharp*"] == ["5.0", "5.0", "5.0"]
    ratios = _cells(page, "Ratio")
    assert ratios["blur rate"] == ["n", "start [mm]", "paper", "best", "oracle-sharp"]
    assert ratios["0.1–0.2"][3] == "0.500"
    assert ratios["all"][3] == "0.643"  # three cases have no interval

    assert _cells(page, "On the same cases")["best vs paper"][0] == "2"


def test_an_interval_says_of_how_many_cases_it_is():
    rows = [_fitted(c, 100, 40 + 5 * c, 0.15 if c <= 4 else 0.3) for c in range(1, 11)]
    rows.append(_row(11, failed="no", blur_rate=0.3, initial_mpjpe_mm=90.0))
    summary = _summary(rows, methods=["best"])
    cell = summary["methods"]["best"]["all"]
    assert cell["n_pose"] == 10
    assert cell["ratio_ci95"][0] < cell["ratio"] < cell["ratio_ci95"][1]
    page = table_markdown(summary).replace("\u00a0", " ")
    ratios = _cells(page, "Ratio")
    assert ratios["all"][2].endswith("; n 10]")
    assert ratios["0.2–0.4"][2].endswith("; n 6]")
    assert ratios["0.1–0.2"][2] == "0.525"


def test_the_page_of_an_empty_benchmark_is_still_a_page():
    page = table_markdown(_summary([], methods=["best"]))
    assert _cells(page, "MPJPE")["best"] == ["–", "–", "–"]
    assert "Ratio" not in page


def _real(case: int, method: str, recording: str, camera: str, average: int, **values) -> dict:
    facts = {"recording": recording, "source": f"{recording}/{camera}.mp4", "average": average}
    return _row(case, method, 0.15, **facts, **values)


def _real_rows() -> list[dict]:
    rows = []
    for case in range(1, 17):
        place = ("gym", f"cam{case % 2}", 5) if case <= 8 else ("park", "cam0", 5 if case < 13 else 9)
        told = {
            "initial_mpjpe_mm": 100.0 + case,
            "initial_pa_mpjpe_mm": 80.0,
            "still_motion_mm": 20.0,
            "true_path_mm": 50.0,
            "ray_depth_mm": 30.0,
            "lean_deg": 5.0,
            "in_plane_px": 4.0,
        }
        still = {
            "mpjpe_mm": 100.0 + case,
            "pa_mpjpe_mm": 80.0,
            "motion_mm": 20.0,
            "better_motion_mm": 20.0,
            "path_mm": 0.0,
            "front_wrong": 0.0,
        }
        fitted = {
            "mpjpe_mm": 50.0 + case,
            "pa_mpjpe_mm": 40.0,
            "motion_mm": 10.0 + case / 8,
            "better_motion_mm": 8.0,
            "path_mm": 30.0,
            "front_wrong": float(case == 3),
        }
        rows += [_real(case, "static", *place, **told, **still), _real(case, "best", *place, **told, **fitted)]
    return rows


def test_real_video_is_told_by_recording_exposure_and_camera():
    summary = summarize(_real_rows(), "real", 16, {}, 3, BINS, methods=["static", "best"])
    cells = {(one["recording"], one["average"]): one for one in summary["recordings"]}
    assert list(cells) == [(r, k) for r in ("gym", "park", None) for k in (5, 9, None)]
    counts = {key: cell["methods"]["best"]["n"] for key, cell in cells.items()}
    assert counts == {
        ("gym", 5): 8,
        ("gym", 9): 0,
        ("gym", None): 8,
        ("park", 5): 4,
        ("park", 9): 4,
        ("park", None): 8,
        (None, 5): 12,
        (None, 9): 4,
        (None, None): 16,
    }
    gym = cells["gym", 5]["methods"]["best"]
    assert gym["mpjpe_mm"] == pytest.approx(54.5)
    assert gym["mpjpe_ci95"][0] < 54.5 < gym["mpjpe_ci95"][1]
    assert cells[None, None]["methods"]["best"] == summary["methods"]["best"]["all"]
    assert [one["camera"] for one in summary["cameras"]] == ["gym/cam0.mp4", "gym/cam1.mp4", "park/cam0.mp4"]
    assert [one["methods"]["best"]["front_wrong"] for one in summary["cameras"]] == [0, 0.25, 0]
    whole = summary["methods"]["best"]["all"]
    assert summary["methods"]["static"]["all"]["motion_ratio"] == 1
    assert whole["motion_ratio"] == pytest.approx((10 + 8.5 / 8) / 20)
    assert whole["motion_ratio_ci95"][0] < whole["motion_ratio"] < whole["motion_ratio_ci95"][1]
    assert (whole["better_motion_ratio"], whole["path_share"], whole["n_motion"]) == (0.4, 0.6, 16)

    page = table_markdown(summary)
    tables = page.split("## By recording and K")[1].split("## Position, front")[0]
    assert "| recording | method | K = 5 | K = 9 | all K |" in tables
    low, high = gym["mpjpe_ci95"]
    assert f"|  | best | 54.5 [{low:.0f},\u00a0{high:.0f};\u00a0n\u00a08] | – |" in tables
    assert "| park | start (static) | 110.5 (n\u00a04) | 114.5 (n\u00a04) |" in tables
    moved = page.split("## Position, front")[1].split("## The same by camera")
    assert "| best | 16 | 58.5\u00a0/\u00a040.0 | 4.0 | 30 | 5.0 | 6\u00a0% | 11.1 | 20.0 | 0.55 [" in moved[0]
    assert "| gym/cam1.mp4 | start (static) | 4 |" in moved[1]
    assert "## The same by blur rate" in moved[1]
    assert "spin" not in moved[0].split("\n\n")[2]


def test_other_sets_have_no_recordings():
    summary = _summary([_fitted(1, 100, 50)])
    assert {"recordings", "cameras"}.isdisjoint(summary)
    page = table_markdown(summary)
    assert "By recording" not in page
    assert "Position, front" not in page
