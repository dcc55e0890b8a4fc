"""Made clips: the same bytes again, a truth that fits the pictures, frames without the person."""

from pathlib import Path

import numpy as np
import pytest

from hfb.datasets.synthetic.clip_making import make_clip
from hfb.errors import InputError
from hfb.io.clip import read_clip
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.plate import changed_pixels
from hfb.motion.motion_file import load_motion


@pytest.mark.parametrize("video", [False, True])
def test_a_clip_is_what_its_truth_says(tmp_path: Path, video: bool) -> None:
    told: list[tuple[int, int]] = []
    made = make_clip(
        tmp_path / "clip",
        6,
        48,
        64,
        seed=5,
        shutter=0.5,
        instants=8,
        video=video,
        leaves=(2, 3),
        on_progress=lambda done, total: told.append((done, total)),
    )
    assert told[-1] == (6, 6)
    footage, plate = open_footage(made.source), read_picture_srgb(made.background)
    assert footage.count == 6
    truth, space = load_motion(made.truth)
    assert space == "hfb"
    assert sorted(set(truth.frame_index.tolist())) == [0, 1, 4, 5]
    changed = changed_pixels(np.stack(list(footage.frames())), plate)
    shares = changed.mean((1, 2))
    assert shares[[2, 3]].max() < 0.01 < 0.03 < shares[[0, 1, 4, 5]].min()
    pelvis = (truth.joints[truth.rows_of(0)[4], 0] @ truth.K.T)[:2] / truth.joints[truth.rows_of(0)[4], 0, 2]
    assert changed[0][int(pelvis[1]), int(pelvis[0])]
    clip = read_clip(made.clip)
    assert clip.exposure.fps == 30
    assert clip.exposure.exposure_s(1 / 30) == pytest.approx(truth.times_s[7] - truth.times_s[0])


def test_the_same_bytes_again_and_another_seed(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "abc"]
    for folder, seed in zip(folders, (1, 1, 2), strict=True):
        make_clip(folder, 2, 32, 48, seed=seed, instants=8)
    contents = [
        {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*.*"))} for folder in folders
    ]
    assert contents[0] == contents[1]
    assert len(contents[0]) == 5
    assert contents[0] != contents[2]


def test_a_long_clip_never_stands_or_jumps(tmp_path: Path) -> None:
    made = make_clip(tmp_path, 8, 32, 48, seed=1, fps=1.0, instants=8)  # eight seconds: longer than any motion
    truth, _ = load_motion(made.truth)
    assert truth.times_s[-1] > 7
    assert np.isfinite(truth.joints).all()


def test_nothing_of_an_earlier_clip_stays(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "notes.txt").write_text("mine")
    make_clip(tmp_path, 3, 32, 48, instants=8)
    (tmp_path / "truth.npz").unlink()  # as if it had been stopped half-way
    assert open_footage(make_clip(tmp_path, 2, 32, 48, instants=8).source).count == 2
    make_clip(tmp_path, 2, 32, 48, instants=8, video=True)
    assert [path.name for path in (tmp_path / "frames").iterdir()] == ["notes.txt"]
    make_clip(tmp_path, 2, 32, 48, instants=8)
    assert not (tmp_path / "clip.mp4").exists()


@pytest.mark.parametrize("name", ["frames/00002.png", "frames/IMG_1.JPG", "clip.mp4", "truth.npz", "clip.toml"])
def test_what_somebody_else_put_there_stays(tmp_path: Path, name: str) -> None:
    if name not in ("clip.toml", "truth.npz"):  # beside a clip of ours too
        make_clip(tmp_path, 2, 32, 48, instants=8)
    (tmp_path / name).write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=rf"holds {name}, .*move it away, or choose another --out"):
        make_clip(tmp_path, 5, 32, 48, instants=8)
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / name).read_text() == "mine"
