"""One clip's trouble is that clip's: names that no folder can have, and results that somebody damaged."""

import json
import os
import shutil
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.flows.batch import batch
from hfb.flows.cli.cli import main
from hfb.io.names import shown_name
from hfb.tasks.batch.batch_summary import BatchSummary
from hfb.tasks.inputs.clip_places import find_clips
from hfb.tasks.inputs.inputs import input_file
from tests.fuzz.hostile import _large_png
from tests.fuzz.results import FACTS, write_result
from tests.shared import REPORTS
from tests.small_clips import small_config

_LONG_AGO = (1_700_000_000, 1_700_000_000)
_TAR = REPORTS / "name_not_utf8.tar"
_NOT_UTF8 = os.fsdecode(b"caf\xe9_walk")


def made(folder: Path, names: list[str]) -> Path:
    """Clips that cannot be worked on, of some names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        place = folder / name
        if name.endswith((".mp4", ".ts")):
            place.write_text("no video")
        else:
            place.mkdir()
            (place / "clip.toml").write_text("fps = 3\n")
    for path in folder.rglob("*"):
        os.utime(path, _LONG_AGO)
    return folder


def run(clips: Path, out: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
    """(what the batch said, its record, its page)."""
    told = batch(clips, out, small_config().model_dump(mode="json"), workers=1, attempts=1, wait_s=0.1)
    return told, json.loads((out / "batch.json").read_text()), Path(told["page"]).read_text()


def test_names_that_no_folder_of_results_can_have(store: Path, tmp_path: Path) -> None:
    kept = ["summary.html", "batch.json", "Intermediate", "summary-2.html.mp4", "batch.json.set-aside-1"]
    odd = ["line\nbreak", "..walk..", "a" * 251 + ".mp4", "b" * 252 + ".ts", "<b>bold<b>.mp4", "\x1b[31mred"]
    clips = made(tmp_path / "clips", [*kept, *odd, f"{_NOT_UTF8}.mp4", _NOT_UTF8 + "2", "broken.mp4"])
    told, ledger, page = run(clips, tmp_path / "out")
    count = len(kept) + len(odd) - 1 + 3  # what begins with a dot is hidden
    assert (told["clips"], told["set_aside"]) == (count, count)
    for name in kept:
        assert "rename the clip" in ledger[name.removesuffix(".mp4")]["reason"], name
    assert "not text in UTF-8: rename it" in ledger[_NOT_UTF8]["reason"]
    assert "not text in UTF-8: rename it" in ledger[_NOT_UTF8 + "2"]["reason"]
    assert "caf\\udce9_walk" in page
    assert "line\\nbreak" in page
    assert "<b>bold" not in page
    assert "broken.mp4" in ledger["broken"]["reason"]
    assert "\x1b" not in page
    assert [one["status"] for one in ledger.values()] == ["set aside"] * count


@pytest.mark.skipif(not _TAR.exists(), reason="the reports are not here")
def test_the_reported_archive(store: Path, tmp_path: Path) -> None:
    with tarfile.open(_TAR) as archive:
        archive.extractall(tmp_path / "clips", filter="data")
    places = find_clips(tmp_path / "clips", tmp_path / "out")
    if not places:  # in a folder of its own
        (inner,) = (tmp_path / "clips").iterdir()
        places = find_clips(inner, tmp_path / "out")
    assert len(places) == 2
    bad = [place for place in places if shown_name(place.name) != place.name]
    assert len(bad) == 1
    with pytest.raises(InputError, match="not text in UTF-8: rename it"):
        bad[0].check()
    next(place for place in places if place is not bad[0]).check()


def test_files_and_folders_of_such_names_are_refused_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / f"{_NOT_UTF8}.png").write_bytes(b"x")
    with pytest.raises(InputError, match="not text in UTF-8") as raised:
        input_file(tmp_path / f"{_NOT_UTF8}.png")
    str(raised.value).encode()
    folder = tmp_path / _NOT_UTF8
    clips = made(folder / "clips", ["broken.mp4"])
    assert main(["batch", str(clips), "--out", str(folder / "out"), "--json"]) == 2
    assert "not text in UTF-8" in json.loads(capsys.readouterr().out.splitlines()[-1])["error"]


def test_clips_that_cannot_be_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clips = made(tmp_path / "clips", ["walk", "wave"])
    (clips / "circle").symlink_to("circle2")
    (clips / "circle2").symlink_to("circle")
    real = Path.exists

    def exists(self: Path) -> bool:
        if self.parent.name == "wave":  # root, as which tests run, may look at everything
            raise PermissionError(13, "Permission denied")
        return real(self)

    monkeypatch.setattr(Path, "exists", exists)
    found = {place.name: place for place in find_clips(clips, tmp_path / "out")}
    assert {"walk", "wave"} <= found.keys()
    with pytest.raises(InputError, match="Permission denied"):
        found["wave"].check()
    found["walk"].check()


def _bomb(path: Path) -> None:
    path.write_bytes(_large_png(np.random.default_rng(1)))


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _types(path: Path) -> None:
    path.write_text(json.dumps(FACTS | {"frames": "many", "gaps": 3}))


def _deep(path: Path) -> None:
    path.write_text("[" * 100_000)


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 32)


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("result.json", _cut),
        ("result.json", _folder),
        ("result.json", _types),
        ("result.json", _deep),
        ("result.json", _huge),
        ("result.json", _pipe),
        ("strip.png", _cut),
        ("strip.png", _folder),
        ("strip.png", _bomb),
        ("strip.png", _huge),
    ],
)
def test_a_damaged_result_is_its_clips_trouble(name: str, damage: Callable[[Path], None], tmp_path: Path) -> None:
    out = tmp_path / "out"
    for clip in ("walk", "wave"):
        list(write_result(out / clip))
    damage(out / "walk" / name)
    summary = BatchSummary("Clips of here", out, out / "intermediate" / "thumbnails")
    summary.show_all([("walk", "done", "", None), ("wave", "done", "", "http://127.0.0.1:5000/x")])
    assert (summary.counts().done, summary.counts().set_aside) == (1, 1)
    page = (out / "summary.html").read_text()
    assert "2 clips: 1 done, 1 set aside, 0 waiting" in page
    assert f"{name}" in page
    assert "move" in page
    assert page.count("data:image/jpeg;base64,") == 1, "the other clip's picture"


@pytest.mark.parametrize(
    "content", ["{", '{"broken": 3}', '{"broken": {"stamp": "a", "status": "done", "due": 1e999}}']
)
def test_a_damaged_record_of_the_batch_is_set_aside(content: str, store: Path, tmp_path: Path) -> None:
    clips, out = made(tmp_path / "clips", ["broken.mp4"]), tmp_path / "out"
    out.mkdir()
    (out / "batch.json").write_text(content)
    (out / "summary.html").mkdir()
    told, ledger, page = run(clips, out)
    assert told["set_aside"] == 1
    assert ledger["broken"]["status"] == "set aside"
    assert (out / "batch.json.set-aside-1").read_text() == content
    assert (out / "summary.html.set-aside-1").is_dir()
    assert "broken.mp4" in page


def test_a_folder_in_the_place_of_the_record(store: Path, tmp_path: Path) -> None:
    clips, out = made(tmp_path / "clips", ["broken.mp4"]), tmp_path / "out"
    (out / "batch.json").mkdir(parents=True)
    assert run(clips, out)[0]["set_aside"] == 1


def test_a_finished_result_that_is_damaged_is_not_made_again(store: Path, tmp_path: Path) -> None:
    clips, out = made(tmp_path / "clips", ["walk.mp4", "wave.mp4"]), tmp_path / "out"
    run(clips, out)
    ledger = json.loads((out / "batch.json").read_text())
    for name in ("walk", "wave"):
        list(write_result(out / name))
        ledger[name] |= {"status": "done", "reason": ""}
    (out / "batch.json").write_text(json.dumps(ledger))
    _cut(out / "walk" / "result.json")
    told, _, page = run(clips, out)
    assert (told["done"], told["set_aside"], told["waiting"]) == (1, 1, 0)
    assert "result.json is damaged" in page
    shutil.rmtree(out / "walk")
    assert "no video" in (clips / "walk.mp4").read_text()
    assert run(clips, out)[0]["done"] == 1, "gone: tried again, and set aside for its own reason"
