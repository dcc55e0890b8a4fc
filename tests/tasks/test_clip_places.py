"""Which files are meant by what a user names."""

import json
import os
import re
from pathlib import Path

import pytest

from hfb.config import InitConfig, RunConfig
from hfb.errors import InputError, TemporaryError
from hfb.io.media.footage_files import footage_files
from hfb.tasks.batch.batch_ledger import stamp_of
from hfb.tasks.core.handles import FileHandle, files_in
from hfb.tasks.inputs.clip_places import find_clips, plate_beside, resolve_source
from hfb.tasks.inputs.video_inputs import take_video_inputs


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


def stamp(folder: Path, name: str = "walk") -> str:
    """What `hfb batch` tells a clip from a changed one by."""
    places = {place.name: place for place in find_clips(folder, folder / "out")}
    return stamp_of(places[name].files, {})[0]


def test_clips_of_one_name_are_not_lost(tmp_path: Path) -> None:
    touch(tmp_path / "walk.mp4", tmp_path / "walk.mov", tmp_path / "wave.mp4", tmp_path / "wave" / "clip.toml")
    places = {place.source.name: place for place in find_clips(tmp_path, tmp_path / "out")}
    assert {name: place.name for name, place in places.items()} == {
        "walk.mov": "walk",
        "walk.mp4": "./walk.mp4",
        "wave": "wave",
        "wave.mp4": "./wave.mp4",
    }
    places["walk.mov"].check()
    places["wave"].check()
    with pytest.raises(InputError, match=r"walk\.mp4 and .*walk\.mov are clips of one name.*: rename one of them"):
        places["walk.mp4"].check()
    with pytest.raises(InputError, match=r"wave\.mp4 and .*wave are clips of one name"):
        places["wave.mp4"].check()


@pytest.mark.parametrize("later", ["walk.avi", "walk/clip.toml"])
def test_a_result_stays_its_clips(tmp_path: Path, later: str) -> None:
    """Whatever comes to lie beside it, also what would stand before it by name."""
    (tmp_path / "walk.mp4").write_bytes(b"the film")
    result = {"out": "", "inputs": {"video": FileHandle.of(tmp_path / "walk.mp4").sha256}}
    (tmp_path / "out" / "walk").mkdir(parents=True)
    (tmp_path / "out" / "walk" / "result.json").write_text(json.dumps(result))
    before = stamp(tmp_path)
    touch(tmp_path / later)
    places = {place.name: place for place in find_clips(tmp_path, tmp_path / "out")}
    assert places["walk"].source == tmp_path / "walk.mp4"
    assert places[f"./{Path(later).parts[0]}"].twin == tmp_path / "walk.mp4"
    assert stamp(tmp_path) == before


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"inputs": 3}', '{"inputs": {"video": 3}}'])
def test_a_damaged_result_is_nobodys(tmp_path: Path, content: str) -> None:
    touch(tmp_path / "walk.mp4", tmp_path / "walk.mov", tmp_path / "out" / "walk" / "result.json")
    (tmp_path / "out" / "walk" / "result.json").write_text(content)
    assert [place.name for place in find_clips(tmp_path, tmp_path / "out")] == ["walk", "./walk.mp4"]


def test_a_clip_changes_with_all_that_decides_its_result(tmp_path: Path) -> None:
    touch(tmp_path / "walk.mp4", tmp_path / "walk_plate.png", tmp_path / "other.mp4", tmp_path / "tracks.csv")
    other, bare = stamp(tmp_path, "other"), stamp(tmp_path)
    (tmp_path / "walk_plate.png").write_bytes(b"a better one")
    plated = stamp(tmp_path)
    assert plated != bare
    assert stamp(tmp_path, "other") == other

    (tmp_path / "walk.toml").write_text('[camera]\ncalibration = "calib.toml"\n[person]\ntrack = "tracks.csv"\n')
    named = stamp(tmp_path)
    for name in ("tracks.csv", "calib.toml"):  # the second was not even there
        (tmp_path / name).write_bytes(name.encode())
        assert named != (named := stamp(tmp_path)), name

    (tmp_path / "walk.toml").write_text('background = "median"\n')
    median = stamp(tmp_path)
    (tmp_path / "walk_plate.png").write_bytes(b"nobody looks at it")
    assert stamp(tmp_path) == median
    (tmp_path / "walk.toml").write_text('background = "empty.png"\n')
    given = stamp(tmp_path)
    touch(tmp_path / "empty.png")
    assert stamp(tmp_path) != given


def test_a_plate_beside_a_folder_of_pictures_counts(tmp_path: Path) -> None:
    touch(tmp_path / "walk" / "clip.toml", tmp_path / "walk" / "0.png", tmp_path / "plate.png")
    before = stamp(tmp_path)
    (tmp_path / "plate.png").write_bytes(b"another")
    assert stamp(tmp_path) != before


def test_a_clip_without_plate_keeps_its_stamp(tmp_path: Path) -> None:
    """What an earlier version did is not done again."""
    touch(tmp_path / "walk.mp4", tmp_path / "walk.toml", tmp_path / "wave" / "clip.toml", tmp_path / "wave" / "0.png")
    touch(tmp_path / "wave" / "background.png")
    assert stamp(tmp_path) == stamp_of((tmp_path / "walk.mp4", tmp_path / "walk.toml"), {})[0]
    held = sorted((tmp_path / "wave").iterdir())
    assert stamp(tmp_path, "wave") == stamp_of(held, {})[0]


def test_a_clip_that_cannot_be_read_is_found_all_the_same(tmp_path: Path) -> None:
    touch(tmp_path / "walk.mp4", tmp_path / "two" / "a.mp4", tmp_path / "two" / "b.mp4", tmp_path / "two" / "clip.toml")
    (tmp_path / "walk.toml").write_text("[camera\n")
    assert [place.name for place in find_clips(tmp_path, tmp_path / "out")] == ["two", "walk"]


def test_plates_of_names_that_mean_something_to_a_shell(tmp_path: Path) -> None:
    touch(tmp_path / "walk [id7].mp4", tmp_path / "walk [id7]_plate.png", tmp_path / "walk i_plate.png")
    assert plate_beside((tmp_path / "walk [id7].mp4",)) == tmp_path / "walk [id7]_plate.png"


@pytest.mark.parametrize(
    "name",
    [
        "0.png",
        "f2.JPG",
        "f10.png",
        "Plate.png",
        "BACKGROUND.JPG",
        "walk_plate.png",
        "walk_Background.tif",
        "plates.png",
        "template.png",
        "backplate.png",
        "plate_1.png",
        "._0.png",
        "._plate.png",
        ".hidden.png",
        "notes.txt",
    ],
)
def test_a_picture_is_a_frame_a_plate_or_neither(tmp_path: Path, name: str) -> None:
    """By the same rule wherever a folder of pictures is read, and what is no frame for its name is the plate."""
    touch(tmp_path / "f1.png", tmp_path / name)
    frames = resolve_source(tmp_path, None)[0]
    assert frames == footage_files(tmp_path)
    picture = not name.startswith(".") and not name.endswith(".txt")
    assert plate_beside(frames) == (tmp_path / name if picture and tmp_path / name not in frames else None)


def test_the_plate_with_the_plain_name_goes_first(tmp_path: Path) -> None:
    touch(tmp_path / "frames" / "0.png", tmp_path / "Plate.png", tmp_path / "plate.png", tmp_path / "walk_plate.png")
    files = resolve_source(tmp_path, None)[0]
    assert plate_beside(files) == tmp_path / "plate.png"
    touch(tmp_path / "frames" / "walk_plate.png")
    assert plate_beside(files) == tmp_path / "frames" / "walk_plate.png"
    touch(tmp_path / "frames" / "Background.png")
    assert plate_beside(files) == tmp_path / "frames" / "Background.png"


def test_hidden_files_are_no_clips(tmp_path: Path) -> None:
    touch(tmp_path / "walk.mp4", tmp_path / "._walk.mp4")
    assert resolve_source(tmp_path, None)[0] == (tmp_path / "walk.mp4",)
    assert [place.source.name for place in find_clips(tmp_path, tmp_path / "out")] == ["walk.mp4"]


def refusal(folder: Path, name: str) -> str:
    """Why a clip is not worked on."""
    places = {place.name: place for place in find_clips(folder, folder.parent / "out")}
    with pytest.raises(InputError) as refused:
        places[name].check()
    return str(refused.value)


@pytest.mark.parametrize("where", ["outside", "clips/other"])
@pytest.mark.parametrize("link", ["frames", "sub", "sub/deep", ".hidden"])
def test_a_linked_folder_is_refused_by_name(tmp_path: Path, where: str, link: str) -> None:
    """Also one that stays among the clips: what lies in it is read, and was not watched."""
    clip = tmp_path / "clips" / "walk"
    touch(clip / "0.png", tmp_path / where / "0.png")
    (clip / "clip.toml").write_text('video = "sub"\n')
    (clip / link).parent.mkdir(parents=True, exist_ok=True)
    (clip / link).symlink_to(tmp_path / where)
    assert re.search(
        rf"walk/{link} is a link to a folder, .*: put the folder itself there", refusal(clip.parent, "walk")
    )


def test_a_clip_that_is_a_linked_folder(tmp_path: Path) -> None:
    touch(tmp_path / "elsewhere" / "clip.toml", tmp_path / "elsewhere" / "0.png")
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips" / "walk").symlink_to(tmp_path / "elsewhere")
    assert "walk is a link to a folder" in refusal(tmp_path / "clips", "walk")


_NAMES_TWO = '[camera]\ncalibration = "calib.toml"\n[person]\ntrack = "tracks.csv"\n'


@pytest.mark.parametrize("name", ["walk.toml", "calib.toml", "tracks.csv", "plate.png", "walk_plate.png"])
def test_a_pipe_beside_a_video(tmp_path: Path, name: str) -> None:
    touch(tmp_path / "walk.mp4")
    (tmp_path / "walk.toml").write_text(_NAMES_TWO)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    assert f"{name} cannot be read (it is a named pipe and no file)" in refusal(tmp_path, "walk")


@pytest.mark.parametrize("name", ["calib.toml", "tracks.csv"])
def test_what_a_clip_names_lies_in_no_linked_folder(tmp_path: Path, name: str) -> None:
    touch(tmp_path / "walk.mp4", tmp_path / "inner" / name)
    (tmp_path / "sub").symlink_to(tmp_path / "inner")
    (tmp_path / "walk.toml").write_text(_NAMES_TWO.replace(name, f"sub/{name}"))
    assert "sub is a link to a folder" in refusal(tmp_path, "walk")


@pytest.mark.parametrize("name", ["walk.mp4", "wave/0.png", "wave/clip.toml", "wave/frames"])
def test_a_pipe_among_the_clips_does_not_hang(tmp_path: Path, name: str) -> None:
    touch(tmp_path / "wave" / "clip.toml", tmp_path / "wave" / "1.png")
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    assert f"{name} cannot be read (it is a named pipe and no file)" in refusal(tmp_path, Path(name).parts[0][:4])


def test_folders_without_end_are_one_clips_trouble(tmp_path: Path) -> None:
    touch(tmp_path / "wave" / "clip.toml", tmp_path / "walk.mp4")
    (tmp_path / "wave").joinpath(*["d"] * 100).mkdir(parents=True)
    assert "nested more than" in refusal(tmp_path, "wave")
    next(place for place in find_clips(tmp_path, tmp_path / "out") if place.name == "walk").check()


def test_what_is_read_is_what_is_watched(tmp_path: Path) -> None:
    touch(tmp_path / "walk" / "clip.toml", tmp_path / "walk" / "frames" / "0.png", tmp_path / "walk" / "plate.png")
    (place,) = find_clips(tmp_path, tmp_path / "out")
    inputs = take_video_inputs(place.source, RunConfig(init=InitConfig(method="matte")), place.clip)
    read = list(files_in((inputs.video, inputs.background)))
    assert len(read) == 2
    place.check_read(read)
    touch(tmp_path / "walk" / "frames" / "1.png")
    later = take_video_inputs(place.source, RunConfig(init=InitConfig(method="matte")), place.clip)
    with pytest.raises(TemporaryError, match=r"1\.png came to .*walk while it was being read"):
        place.check_read(files_in(later.video))


def test_results_among_the_clips_are_none(tmp_path: Path) -> None:
    """However their folder is spelled."""
    touch(tmp_path / "walk.mp4", tmp_path / "out" / "clip.toml")
    (tmp_path / "by a link").symlink_to(tmp_path)
    for out in (tmp_path / "out", tmp_path / "by a link" / "out", tmp_path / "none" / ".." / "out"):
        assert [place.name for place in find_clips(tmp_path, out)] == ["by a link", "walk"][-1:]
