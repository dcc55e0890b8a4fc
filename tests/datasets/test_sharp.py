"""The strip of true sub-frames gives the pictures back."""

from pathlib import Path

import numpy as np
import pytest

from hfb.datasets.case import Case
from hfb.datasets.synthetic.sharp import load_sharp, save_sharp
from hfb.errors import InputError
from hfb.photometry import linear_to_srgb


def made(tmp_path: Path) -> tuple[Case, np.ndarray]:
    rng = np.random.default_rng(0)
    pictures = np.zeros((8, 40, 30, 4), np.float32)
    for index in range(8):
        window = pictures[index, 8 + index : 25 + index, 3 + index : 12 + index]
        window[..., 3] = rng.choice([0.0, 0.25, 1.0], window.shape[:2])
        window[..., :3] = rng.random((*window.shape[:2], 3)) * window[..., 3:]
    box = save_sharp(tmp_path / "sharp_0.png", pictures)
    return Case(tmp_path, 1, 1, 0.5, {"sharp": [box], "camera": {"height": 40, "width": 30}}), pictures


def test_round_trip_within_eight_bits(tmp_path: Path) -> None:
    case, pictures = made(tmp_path)
    back = load_sharp(case, 0)
    assert back.shape == pictures.shape
    assert back.dtype == np.float32
    assert np.abs(back[..., 3] - pictures[..., 3]).max() <= 0.5 / 255 + 1e-6
    solid = pictures[..., 3] == 1
    difference = linear_to_srgb(back[..., :3][solid]) - linear_to_srgb(pictures[..., :3][solid])
    assert np.abs(difference).max() <= 0.5 / 255 + 1e-5
    assert np.abs(back[..., :3] - pictures[..., :3]).max() < 0.01
    assert (back[pictures[..., 3] == 0] == 0).all()


def test_the_box_is_tight(tmp_path: Path) -> None:
    case, _ = made(tmp_path)
    left, top, width, height = case.facts["sharp"][0]
    assert (left, top) == (3, 8)
    assert (left + width, top + height) == (19, 32)


def test_damage_is_noticed(tmp_path: Path) -> None:
    case, _ = made(tmp_path)
    path = case.sharp_paths()[0]
    whole = path.read_bytes()
    for data in (b"", b"no picture", whole[:60]):
        path.write_bytes(data)
        with pytest.raises(InputError, match="hfb synth"):
            load_sharp(case, 0)
    path.write_bytes(whole)
    for facts in (
        {},
        {"sharp": [[0, 0, 4, 4]], "camera": {"height": 40, "width": 30}},
        {"sharp": [[25, 8, 16, 24]], "camera": {"height": 40, "width": 30}},
    ):
        with pytest.raises(InputError, match="hfb synth"):
            load_sharp(Case(tmp_path, 1, 1, 0.5, facts), 0)
    path.unlink()
    with pytest.raises(InputError, match="hfb synth"):
        load_sharp(case, 0)
