"""The renderer still draws the pictures that somebody has looked at."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.golden.views import VIEWS, draw_view

HERE = Path(__file__).parent


@pytest.mark.parametrize("name", VIEWS)
def test_the_view_is_as_it_was(name: str, tmp_path: Path) -> None:
    stored = np.asarray(Image.open(HERE / f"{name}.png"))
    drawn = draw_view(name)
    difference = np.abs(drawn.astype(int) - stored)
    if difference.max() > 2:  # 8-bit rounding may differ by a step between machines
        Image.fromarray(np.concatenate([stored, drawn, np.minimum(8 * difference, 255).astype(np.uint8)], 1)).save(
            tmp_path / f"{name}.png"
        )
    assert difference.max() <= 2, f"stored | drawn | difference: {tmp_path / name}.png; regenerate if it is meant"
