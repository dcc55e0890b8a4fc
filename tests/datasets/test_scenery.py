"""Backgrounds and textures from folders, with damaged files among them."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.datasets.synthetic.scenery import TEXTURE_PX, draw_scenery, to_file_and_back
from hfb.errors import InputError
from hfb.io.media.images.image_io import write_png
from hfb.photometry import srgb_to_linear
from tests.shared import SHARED_DATA

REAL = SHARED_DATA / "backgrounds" / "polyhaven"


def draw(backgrounds: Path | None, textures: Path | None = None, seed: int = 0, size_px: int = 48):
    return draw_scenery(backgrounds, textures, load_default_body(), size_px, np.random.default_rng(seed))


def plain(path: Path, level: float, shape: tuple[int, int] = (40, 90)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.full((*shape, 3), level, np.float32))
    return path


def test_damaged_pictures_are_passed_over_and_noted(tmp_path: Path) -> None:
    for name in ("a.jpg", "b/c.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"\x89PNG\r\n not a picture")
    plain(tmp_path / "z.png", 0.5)
    (tmp_path / "notes.txt").write_text("no picture and not tried")
    seen = [draw(tmp_path, seed=seed) for seed in range(4)]
    assert {scenery.background for scenery in seen} == {"z.png"}
    assert {name for scenery in seen for name in scenery.skipped} == {"a.jpg", "b/c.png"}
    expected = torch.full((48, 48, 3), float(srgb_to_linear(np.array(128 / 255))))
    torch.testing.assert_close(seen[0].plate_linear, expected, atol=1e-5, rtol=0)


def test_a_folder_without_any_picture_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"nothing")
    with pytest.raises(InputError, match="no picture that can be read"):
        draw(tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        draw(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no picture"):
        draw(None, tmp_path / "empty")


def test_a_crop_keeps_the_pictures_proportions(tmp_path: Path) -> None:
    """A checker of squares stays one of squares, whatever the picture's own proportions."""
    rows, columns = np.mgrid[0:120, 0:240] // 12
    write_png(tmp_path / "checker.png", np.repeat(((rows + columns) % 2)[..., None], 3, 2).astype(np.float32))
    bright = (draw(tmp_path, seed=3, size_px=96).plate_linear[..., 0] > 0.5).numpy()
    across, down = (bright[:, 1:] != bright[:, :-1]).sum() / 96, (bright[1:] != bright[:-1]).sum() / 96
    assert across > 4
    assert abs(across - down) <= 1.5


def test_a_users_texture_is_shown_as_it_is(tmp_path: Path) -> None:
    plain(tmp_path / "t" / "body.png", 0.6, (64, 64))
    plain(tmp_path / "b" / "bright.png", 0.5372)  # a linear mean of .25: the light that needs no correction
    scenery = draw(tmp_path / "b", tmp_path / "t")
    assert scenery.texture == "body.png"
    assert scenery.texture_linear.shape == (TEXTURE_PX, TEXTURE_PX, 3)
    assert abs(scenery.light - 1) < 0.01
    expected = float(srgb_to_linear(np.array(153 / 255))) * scenery.light
    torch.testing.assert_close(scenery.texture_linear, torch.full((TEXTURE_PX, TEXTURE_PX, 3), expected))


def test_a_person_is_darker_in_the_dark(tmp_path: Path) -> None:
    plain(tmp_path / "night" / "a.png", 0.1)
    plain(tmp_path / "day" / "a.png", 0.7)
    night, day = (draw(tmp_path / name) for name in ("night", "day"))
    assert float(night.texture_linear.mean()) < 0.6 * float(day.texture_linear.mean())


def test_scenes_repeat_and_differ() -> None:
    one, again, other = draw(None, seed=1), draw(None, seed=1), draw(None, seed=2)
    assert torch.equal(one.plate_linear, again.plate_linear)
    assert torch.equal(one.texture_linear, again.texture_linear)
    assert not torch.equal(one.plate_linear, other.plate_linear)
    for picture in (one.plate_linear, one.texture_linear):
        assert picture.dtype == torch.float32
        assert 0 <= float(picture.min()) <= float(picture.max()) <= 1
    stored = to_file_and_back(one.plate_linear)
    torch.testing.assert_close(to_file_and_back(stored), stored)


@pytest.mark.skipif(not REAL.is_dir(), reason="no real backgrounds on this machine")
def test_real_backgrounds() -> None:
    scenes = [draw(REAL, seed=seed) for seed in range(3)]
    assert len({scenery.background for scenery in scenes}) > 1
    assert all(not scenery.skipped for scenery in scenes)
    assert all(float(scenery.plate_linear.std()) > 0.01 for scenery in scenes)
