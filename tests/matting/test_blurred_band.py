"""The default matte where things are blurred: mean |error| in the band .05 < alpha < .95 over many textures."""

from pathlib import Path

import numpy as np
import pytest

from hfb.config import MattingConfig
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.matting.matting_protocol import shrink
from hfb.matting.methods import make_matting
from hfb.photometry import srgb_to_linear
from tests.matting.silhouettes import Composite, composite
from tests.matting.textures import TEXTURES, slide

PAIRS = 2 * len(TEXTURES)
matting = make_matting(MattingConfig())


def band_error(scene: Composite) -> float:
    band = (scene.alpha > 0.05) & (scene.alpha < 0.95)
    return float(np.abs(matting(scene.frame, scene.plate) - scene.alpha)[band].mean())


@pytest.mark.parametrize(("smear_px", "bound"), [(24, 0.05), (72, 0.08)])
def test_textures_before_textures(smear_px: int, bound: float) -> None:
    assert np.mean([band_error(slide(number, smear_px)) for number in range(PAIRS)]) <= bound


def test_jointed_figures_before_photographs(shared_data: Path) -> None:
    """Every limb turns by itself, so smears of up to 24 px and more run in many directions."""
    files = sorted((shared_data / "backgrounds").rglob("*.jpg"))
    errors = []
    for seed, file in enumerate(files[:: len(files) // PAIRS][:PAIRS]):
        plate = shrink(srgb_to_linear(read_picture_srgb(file)).astype(np.float32), 320)
        errors.append(band_error(composite(plate, 24, seed)))
    assert len(errors) == PAIRS
    assert np.mean(errors) <= 0.05
