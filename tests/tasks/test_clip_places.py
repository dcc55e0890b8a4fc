"""Which files are meant by what a user names."""

from pathlib import Path

import pytest

from hfb.errors import InputError
from tasks.clip_places import find_clips, plate_beside, resolve_source


def touch(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_pictures_come_in_their_natural_order(tmp_path: Path) -> None:
    names = ("f9.png", "f10.png", "f1.png", "background.png", "notes.txt")
    touch(*(tmp_path / name for name in names))
    files, clip = resolve_source(tmp_path, None)
    assert [path.name for path in files] == ["f1.png", "f9.png", "f10.png"]
    assert clip is None
    assert plate_beside(files) == tmp_path / "background.png"


def test_a_folder_with_everything(tmp_path: Path) -> None:
    touch(tmp_path / "frames" / "00000.png", tmp_path / "frames" / "00001.png", tmp_path / "background.png")
    (tmp_path / "clip.toml").write_text("[exposure]\nfps = 30\n")
    files, clip = resolve_source(tmp_path, None)
    assert [path.name for path in files] == ["00000.png", "00001.png"]
    assert clip == tmp_path / "clip.toml"
    assert plate_beside(files) == tmp_path / "background.png"
    assert plate_beside(files[:1]) == tmp_path / "background.png"
    assert resolve_source(tmp_path / "clip.toml", None) == (files, clip)


def test_a_clip_file_names_its_video(tmp_path: Path) -> None:
    touch(tmp_path / "one.mp4", tmp_path / "two.mp4", tmp_path / "two_plate.png")
    with pytest.raises(InputError, match="holds 2 videos"):
        resolve_source(tmp_path, None)
    (tmp_path / "clip.toml").write_text('video = "two.mp4"\n')
    assert resolve_source(tmp_path, None)[0] == (tmp_path / "two.mp4",)
    assert plate_beside((tmp_path / "two.mp4",)) == tmp_path / "two_plate.png"
    assert plate_beside((tmp_path / "one.mp4",)) is None
    (tmp_path / "clip.toml").write_text('video = "three.mp4"\n')
    with pytest.raises(InputError, match=r"three\.mp4, which does not exist"):
        resolve_source(tmp_path, None)


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither a video nor pictures"):
        resolve_source(tmp_path, None)
    with pytest.raises(InputError, match="does not exist"):
        resolve_source(tmp_path / "none.mp4", None)


def test_clips_of_a_folder(tmp_path: Path) -> None:
    touch(tmp_path / "b.mp4", tmp_path / "b.toml", tmp_path / "a10.mov", tmp_path / "a9.mov", tmp_path / "readme.txt")
    touch(tmp_path / "c" / "clip.toml", tmp_path / "c" / "frames" / "0.png", tmp_path / "out" / "x" / "clip.toml")
    touch(tmp_path / "no clip" / "0.png")
    places = find_clips(tmp_path, tmp_path / "out")
    assert [place.name for place in places] == ["a9", "a10", "b", "c"]
    assert places[2].clip == tmp_path / "b.toml"
    assert set(places[3].files) == {tmp_path / "c" / "clip.toml", tmp_path / "c" / "frames" / "0.png"}
    with pytest.raises(InputError, match="is no folder"):
        find_clips(tmp_path / "b.mp4", tmp_path / "out")


def test_what_leads_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    touch(tmp_path / "secret.mp4", tmp_path / "secret.png", tmp_path / "clips" / "good" / "clip.toml")
    touch(tmp_path / "clips" / "plated.mp4", tmp_path / "clips" / "good" / "frames" / "0.png")
    (tmp_path / "clips" / "linked.mp4").symlink_to(tmp_path / "secret.mp4")
    (tmp_path / "clips" / "plated_plate.png").symlink_to(tmp_path / "secret.png")
    (tmp_path / "clips" / "inside.mp4").symlink_to(tmp_path / "clips" / "plated.mp4")
    (tmp_path / "clips" / "hidden").mkdir()
    (tmp_path / "clips" / "hidden" / "clip.toml").touch()
    (tmp_path / "clips" / "hidden" / "0.png").symlink_to(tmp_path / "secret.png")
    places = {place.name: place for place in find_clips(tmp_path / "clips", tmp_path / "out")}
    assert sorted(name for name, place in places.items() if place.stray) == ["hidden", "linked", "plated"]
    with pytest.raises(InputError, match="leads out of the folder of clips"):
        places["linked"].check()
    places["good"].check()
