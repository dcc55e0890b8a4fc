"""The reliability plot: drawn where something was said, the same bytes for the same rows."""

import io

import numpy as np
from PIL import Image

from hfb.evaluation.cells import by_method
from hfb.evaluation.reliability import LEVELS, WITHIN
from hfb.evaluation.tables import summarize
from hfb.report.plots.reliability_plot import reliability

BLUE = (0x00, 0x72, 0xB2)


def _rows(off: float, sure: bool = True) -> list[dict]:
    rng = np.random.default_rng(0)
    rows = []
    for case in range(30):
        wrong = float(rng.uniform() < 0.3)
        said = {name: min(level + off, 1.0) for name, level in zip(WITHIN, LEVELS, strict=True)}
        said |= {"radius_mm": 40.0, "direction_said": rng.uniform(0.5, 1)}
        rows.append(
            {
                "case": case,
                "method": "best",
                "blur_rate": 0.4,
                "failed": None,
                "initial_mpjpe_mm": 100.0,
                "mpjpe_mm": 60.0,
                "wrong_direction": wrong,
                **(said if sure else {}),
            }
        )
    return rows


def _drawn(rows: list[dict]) -> bytes | None:
    return reliability(by_method(rows), summarize(rows, "bt-amass", 30, {}, 0, [(0.0, 1.0)]))


def _blue_height(png: bytes) -> float:
    """Mean row of the blue pixels in the left panel, from the bottom."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    panel = pixels[120:, : pixels.shape[1] // 2]
    rows, _ = np.nonzero(np.abs(panel - BLUE).max(-1) < 12)
    assert len(rows) > 300
    return float(len(panel) - rows.mean())


def test_a_method_that_is_too_careful_is_drawn_above_one_that_is_honest() -> None:
    careful, honest = _drawn(_rows(0.1)), _drawn(_rows(0.0))
    assert careful is not None
    assert honest is not None
    assert _blue_height(careful) > _blue_height(honest) + 20


def test_equal_rows_give_equal_bytes() -> None:
    assert _drawn(_rows(0.1)) == _drawn(_rows(0.1)[::-1])


def test_nothing_said_nothing_drawn() -> None:
    assert _drawn(_rows(0.0, sure=False)) is None
