"""Plots: whole PNG files, the same for the same rows, drawn from the numbers and nothing else."""

import io

import numpy as np
import pytest
from PIL import Image

from hfb.evaluation.cells import by_method
from hfb.evaluation.tables import summarize
from hfb.report.plots.benchmark_plots import error_by_joint, ratio_by_blur, write_plots

BINS = [(0.05, 0.2), (0.2, 0.4), (0.4, 1.1)]
BLUE, VERMILLION, GRAY = (0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00), (0x66, 0x66, 0x66)
METHODS = {"static": 1.0, "sfb": None, "paper": 0.9, "best": 0.7}


def _rows(cases: int = 24, methods=None, **changes) -> list[dict]:
    rng = np.random.default_rng(3)
    rows = []
    for case in range(cases):
        rate, initial = rng.uniform(0.05, 1.1), rng.uniform(60, 160)
        for method, share in (METHODS if methods is None else methods).items():
            error = None if share is None else share * initial
            rows.append(
                {
                    "case": case,
                    "method": method,
                    "blur_rate": rate,
                    "failed": None,
                    "initial_mpjpe_mm": initial,
                    "mpjpe_mm": error,
                    "initial_iou": 0.5,
                    "iou": 0.9 - 0.3 * (share or 0.5),
                    "seconds": 1.0,
                    "joint_errors_mm": None if error is None else [error * (1 + joint) / 12 for joint in range(24)],
                    **changes,
                }
            )
    return rows


def _summary(rows) -> dict:
    return summarize(rows, "bt-amass", 24, {}, 0, BINS, ["static"])


def _pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def _amount(pixels: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(pixels - colour).max(-1) < 12).sum())


def test_every_plot_is_written_whole_and_has_room_around_it(tmp_path):
    rows = _rows()
    paths = write_plots(rows, _summary(rows), tmp_path)
    names = ["error_by_blur.png", "iou_by_blur.png", "ratio_by_blur.png", "error_by_joint.png"]
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    for path in paths:
        pixels = _pixels(path.read_bytes())
        assert pixels.shape[1] >= 900
        edge = np.concatenate([pixels[:3].ravel(), pixels[-3:].ravel(), pixels[:, :3].ravel(), pixels[:, -3:].ravel()])
        assert edge.min() == 255, f"{path.name}: something is cut off"
        assert _amount(pixels, BLUE) > 500
        assert _amount(pixels, VERMILLION) > 500


def test_equal_rows_give_equal_bytes_in_any_order(tmp_path):
    rows = _rows(8, {"best": 0.7, "paper": 0.9})
    first = write_plots(rows, _summary(rows), tmp_path / "first")
    second = write_plots(rows[::-1], _summary(rows[::-1]), tmp_path / "second")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_what_is_not_known_is_not_drawn(tmp_path):
    rows = _rows(methods={"sfb": None}, initial_mpjpe_mm=None)
    assert [path.name for path in write_plots(rows, _summary(rows), tmp_path)] == ["iou_by_blur.png"]
    assert write_plots([], _summary([]), tmp_path / "empty") == []


@pytest.mark.parametrize("rate", [None, 5.0])
def test_one_case_and_cases_outside_all_intervals_leave_the_plots_standing(tmp_path, rate):
    rows = _rows(1, {"best": 0.7}, blur_rate=rate)
    assert len(write_plots(rows, _summary(rows), tmp_path)) == 4


def test_bars_are_as_high_as_the_errors():
    """Two methods, one with twice the other's error: twice the coloured area."""
    rows = _rows(methods={"best": 0.4, "paper": 0.8})
    pixels = _pixels(error_by_joint(by_method(rows), _summary(rows)))
    legend = pixels.shape[0] // 12
    blue, vermillion = (_amount(pixels[legend:], colour) for colour in (BLUE, VERMILLION))
    assert vermillion / blue == pytest.approx(2, rel=0.06)


def test_the_start_is_gray_and_sides_can_stand_apart():
    rows = _rows(methods={"static": 1.0, "best": 0.5})
    merged, apart = (_pixels(error_by_joint(by_method(rows), _summary(rows), merge)) for merge in (True, False))
    assert _amount(merged, GRAY) > 5000
    assert (apart != merged).any()


def test_the_papers_ratios_are_drawn_where_given():
    summary = _summary(_rows())
    without, beside = (_pixels(ratio_by_blur(summary, paper)) for paper in (None, [0.8, 0.82, 0.9]))
    assert _amount(beside, GRAY) > _amount(without, GRAY) + 1000
