"""Images are decoded once per process and content, and no task sees what another one does to them."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.config import CameraConfig, ExposureConfig
from hfb.io.clip import Clip
from hfb.io.media.images.image_io import write_matte, write_png
from hfb.tasks.core import scene
from hfb.tasks.core.handles import ClipHandle, FileHandle, StaleFile
from hfb.tasks.core.scene import DecodedImages, load_image, load_mattes, load_observation
from hfb.tasks.image.prepare import prepare


@pytest.fixture
def clip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ClipHandle:
    monkeypatch.setattr(scene, "_kept", DecodedImages(1 << 20, 3))
    noise = np.random.default_rng(0).random((2, 20, 30, 3))
    for name, image in zip(("frame", "plate"), noise, strict=True):
        write_png(tmp_path / f"{name}.png", image, bits=16)
    frame, plate = (FileHandle.of(tmp_path / f"{name}.png") for name in ("frame", "plate"))
    return prepare.fn(frames=(frame,), background=plate, clip=Clip(), camera=CameraConfig(), exposure=ExposureConfig())


def test_what_was_decoded_needs_its_file_no_more(clip: ClipHandle) -> None:
    before = load_image(clip.frames[0], clip)
    clip.frames[0].path.unlink()  # a task checks its files: see hfb.tasks.task
    assert torch.equal(load_image(clip.frames[0], clip), before)


def test_what_a_task_changes_is_its_own(clip: ClipHandle, tmp_path: Path) -> None:
    write_matte(tmp_path / "matte.png", np.full((20, 30), 0.25, np.float32))
    matte = FileHandle.of(tmp_path / "matte.png")
    before = load_observation(clip, (matte,))
    kept = [one.clone() for one in (before.frames_linear, before.plate_linear, before.mattes)]
    for one in (before.frames_linear, before.plate_linear, before.mattes):
        one.zero_()
    load_image(clip.background, clip).zero_()
    load_mattes((matte,)).zero_()
    after = load_observation(clip, (matte,))
    for one, other in zip((after.frames_linear, after.plate_linear, after.mattes), kept, strict=True):
        assert torch.equal(one, other)
    assert torch.equal(load_image(clip.frames[0], clip), kept[0][0])


def test_another_light_is_another_image(clip: ClipHandle) -> None:
    as_stored = clip.model_copy(update={"light": "srgb"})
    assert not torch.equal(load_image(clip.background, clip), load_image(clip.background, as_stored))


def test_nothing_is_kept_of_a_file_that_is_not_what_it_was(clip: ClipHandle, tmp_path: Path) -> None:
    """Also not for whoever puts the right file back."""
    write_png(tmp_path / "new.png", np.zeros((20, 30, 3), np.float32))
    right = FileHandle.of(tmp_path / "new.png")
    write_png(tmp_path / "new.png", np.ones((20, 30, 3), np.float32))
    with pytest.raises(StaleFile):
        load_image(right, clip)
    write_png(tmp_path / "new.png", np.zeros((20, 30, 3), np.float32))
    assert load_image(right, clip).max() == 0


def test_so_many_bytes_and_at_least_three() -> None:
    decoded: list[str] = []

    def get(images: DecodedImages, name: str) -> None:
        def decode() -> torch.Tensor:
            decoded.append(name)
            return torch.zeros(25)  # 100 bytes

        images.get((name,), decode)

    large, small = DecodedImages(400, 3), DecodedImages(10, 3)
    for name in "abcdabcd":
        get(large, name)
    assert decoded == list("abcd")
    get(large, "e")  # a goes
    get(large, "b")
    get(large, "a")
    assert decoded == list("abcdea")
    decoded.clear()
    for name in "abcabcda":
        get(small, name)
    assert decoded == list("abcda")
