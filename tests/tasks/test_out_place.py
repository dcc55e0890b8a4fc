"""Results never go where the next run would read them."""

import os
from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.tasks.inputs.out_place import (
    check_batch_out,
    check_clip_out,
    check_pictures_out,
    check_sources_out,
    default_out,
    lies_in,
    same_place,
)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """A folder of pictures."""
    for name in ("frames/0.png", "frames/1.png", "plain/0.png", "plain/1.png", "plain/plate.png", "walk.mp4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "linked").symlink_to(tmp_path / "plain")
    return tmp_path


def spellings(folder: Path) -> list[Path]:
    """The same folder under other names."""
    other = folder.parent / f"{folder.name} by a link"
    other.symlink_to(folder)
    relative = Path(os.path.relpath(folder))
    return [folder, folder / "..", other, relative, folder.parent / "." / folder.name, Path(f"{folder}/")]


def test_one_folder_under_several_names(clip: Path) -> None:
    names = spellings(clip / "plain")
    assert [same_place(clip / "plain", name) for name in names] == [True, False, True, True, True, True]
    assert same_place(clip / "none", clip / "plain" / ".." / "none")
    assert lies_in(clip / "linked" / "new" / "new", clip / "plain")
    assert not lies_in(clip / "plains", clip / "plain")


@pytest.mark.parametrize("out", ["plain", "plain/frames", "linked", "plain/../plain", "plain/new.png", "plain/out.mp4"])
def test_results_of_a_folder_of_pictures(clip: Path, out: str) -> None:
    files = [clip / "plain" / "0.png", clip / "plain" / "1.png"]
    with pytest.raises(InputError, match=r"would be taken for inputs: give a folder of its own, such as --out runs/"):
        check_clip_out(clip / "plain", files, clip / out)
    for fine in ("plain/result", "results", "plainer", "."):
        check_clip_out(clip / "plain", files, clip / fine)


@pytest.mark.parametrize("out", [".", "frames", "frames/frames"])
@pytest.mark.parametrize("named", [True, False])
def test_results_of_a_folder_with_frames(clip: Path, out: str, named: bool) -> None:
    """Its own folder too: a film of the result would be taken for its only video."""
    with pytest.raises(InputError, match="such as --out runs/"):
        check_clip_out(clip if named else clip / "frames", [clip / "frames" / "0.png"], clip / out)


def test_results_beside_a_video(clip: Path) -> None:
    check_clip_out(clip / "walk.mp4", [clip / "walk.mp4"], clip)
    with pytest.raises(InputError):
        check_clip_out(clip, [clip / "walk.mp4"], clip)
    (clip / "clip.toml").touch()
    for source in (clip / "walk.mp4", clip / "clip.toml"):
        with pytest.raises(InputError, match=r"the folder of a clip|where the frames"):
            check_clip_out(source, [clip / "walk.mp4"], clip)


def test_another_clips_folder(clip: Path, tmp_path: Path) -> None:
    (tmp_path / "other" / "frames").mkdir(parents=True)
    (tmp_path / "other" / "clip.toml").touch()
    for out in ("other", "other/frames"):
        with pytest.raises(InputError, match=r"the folder of a clip \(clip\.toml lies there\)"):
            check_clip_out(clip / "walk.mp4", [clip / "walk.mp4"], tmp_path / out)
        with pytest.raises(InputError):
            check_pictures_out([clip / "plain" / "0.png"], tmp_path / out)


def test_results_of_single_pictures(clip: Path) -> None:
    (clip / "one").mkdir()
    for name in ("photo.png", "photo_plate.png", "strip.png", "matte_0.png", "texture.png"):
        (clip / "one" / name).touch()
    check_pictures_out([clip / "one" / "photo.png"], clip / "one")
    for out in (clip / "plain", clip / "linked"):
        with pytest.raises(InputError, match="a folder of frames"):
            check_pictures_out([clip / "plain" / "0.png"], out)
    with pytest.raises(InputError):
        check_pictures_out([clip / "frames" / "0.png"], clip / "frames")


def test_results_of_a_folder_of_clips(tmp_path: Path) -> None:
    clips = tmp_path / "clips"
    (clips / "walk").mkdir(parents=True)
    (clips / "walk" / "clip.toml").touch()
    (tmp_path / "by a link").symlink_to(clips)
    for out in (clips, clips / "walk" / "..", tmp_path / "by a link", clips / "new" / ".."):
        with pytest.raises(InputError, match=r"the folder of clips itself, .* such as --out runs/clips-result"):
            check_batch_out(clips, out)
    for out in (clips / "walk", clips / "walk" / "new" / "new", tmp_path / "by a link" / "walk"):
        with pytest.raises(InputError, match="in the folder of the clip walk"):
            check_batch_out(clips, out)
    for out in (clips / "results", tmp_path, tmp_path / "results"):
        check_batch_out(clips, out)


def test_results_among_what_a_set_is_made_from(tmp_path: Path) -> None:
    motions = tmp_path / "motions"
    motions.mkdir()
    for out in (motions, motions / "new", tmp_path / "motions" / ".." / "motions"):
        with pytest.raises(InputError, match="which is searched for inputs"):
            check_sources_out([None, motions], out)
    earlier = tmp_path / "bench" / "methods" / "best"
    earlier.mkdir(parents=True)
    with pytest.raises(InputError, match=r"is where results in .* go"):
        check_sources_out([earlier], tmp_path / "bench")
    check_sources_out([motions, tmp_path / "none", None], tmp_path)
    check_sources_out([earlier], tmp_path / "other")


def test_the_folder_that_is_taken_without_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "clip").mkdir(parents=True)
    assert default_out(Path("runs/clip")) == Path("runs/clip-result")
    assert default_out(Path("elsewhere/clip")) == Path("runs/clip")
    assert default_out(Path("walk.mp4")) == Path("runs/walk")
