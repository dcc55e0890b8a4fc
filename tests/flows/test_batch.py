"""A folder of clips: each once, the hopeless ones set aside with their reason, and a page about all."""

import fcntl
import json
import os
import re
import shutil
import time
from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.flows.batch import batch
from tests.orchestration import mlflow_rows
from tests.small_clips import small_clip, small_config


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two clips of one frame and a file that is none, all written long ago."""
    made = small_clip(1)
    for name in ("walk", "wave"):
        shutil.copytree(made.truth.parent, tmp_path / "clips" / name)
    # The same clip with the same clip.toml would be the same run in MLflow.
    (tmp_path / "clips" / "wave" / "clip.toml").write_text(made.clip.read_text().replace("fps = 30.0", "fps = 25.0"))
    (tmp_path / "clips" / "broken.mp4").write_text("no video")
    for path in (tmp_path / "clips").rglob("*"):
        os.utime(path, (1_700_000_000, 1_700_000_000))
    return tmp_path / "clips"


def test_each_clip_once(folder: Path, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = small_config().model_dump(mode="json")
    out.mkdir()
    # Another process works on one of them: not hopeless, so it is tried again, and by then it is free.
    (out / "walk" / "intermediate").mkdir(parents=True)
    with (out / "walk" / "intermediate" / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        first = batch(folder, out, config, workers=1, attempts=1, wait_s=0.1)
    assert {name: first[name] for name in ("clips", "done", "set_aside", "waiting")} == {
        "clips": 3,
        "done": 1,
        "set_aside": 2,
        "waiting": 0,
    }
    ledger = json.loads((out / "batch.json").read_text())
    assert "another hfb is working" in ledger["walk"]["reason"]
    assert "broken.mp4" in ledger["broken"]["reason"]
    stamp = (out / "wave" / "result.json").stat().st_mtime_ns

    second = batch(folder, out, config, workers=1, attempts=3, wait_s=0.1, again=True)
    assert (second["done"], second["set_aside"]) == (2, 1)
    assert (out / "wave" / "result.json").stat().st_mtime_ns == stamp  # done once
    assert json.loads((out / "batch.json").read_text())["broken"]["attempts"] == 1  # nothing but a new file mends it
    runs = [("broken", "FAILED"), ("walk", "FINISHED"), ("wave", "FINISHED")]
    assert sorted(mlflow_rows(store, "select name, status from runs")) == runs
    page = Path(second["page"]).read_text()
    assert "3 clips: 2 done, 1 set aside, 0 waiting" in page
    assert page.count("data:image/jpeg;base64,") == 2
    assert "broken.mp4" in page
    assert not re.findall(r'(?:src|href)="(?!data:|http://127\.0\.0\.1:5000/)', page)

    shutil.rmtree(out / "wave")
    assert batch(folder, out, config, workers=1)["done"] == 2
    assert (out / "wave" / "result.json").is_file(), "a result that is gone is made again"


def test_what_no_clip_can_mend(folder: Path, store: Path, tmp_path: Path) -> None:
    """An option's file that is missing ends the batch; a place that is taken is tried again."""
    options = small_config().model_dump(mode="json")
    options["prior"]["motion"] = str(tmp_path / "none.safetensors")
    with pytest.raises(InputError, match=r"none\.safetensors does not exist"):
        batch(folder, tmp_path / "out", options, workers=1)

    for name in ("wave", "broken.mp4"):
        shutil.rmtree(folder / name, ignore_errors=True)
    (folder / "broken.mp4").unlink(missing_ok=True)
    out = tmp_path / "out"
    out.mkdir(exist_ok=True)
    (out / "walk").write_text("a file where the result belongs")
    options["prior"]["motion"] = None
    assert batch(folder, out, options, workers=1, attempts=2, wait_s=0.1)["set_aside"] == 1
    ledger = json.loads((out / "batch.json").read_text())["walk"]
    assert (ledger["attempts"], ledger["status"]) == (2, "set aside")
    assert "is a file" in ledger["reason"]


def test_times_that_cannot_be_are_not_believed(store: Path, tmp_path: Path) -> None:
    """A clock that was put back, and a file from a machine whose clock is ahead."""
    (tmp_path / "clips").mkdir()
    clip = tmp_path / "clips" / "broken.mp4"
    clip.write_text("no video")
    os.utime(clip, (4_000_000_000, 4_000_000_000))
    config = small_config().model_dump(mode="json")
    began = time.monotonic()
    assert batch(tmp_path / "clips", tmp_path / "out", config, workers=1)["set_aside"] == 1
    assert time.monotonic() - began >= 3, "it may still be on its way"

    ledger = json.loads((tmp_path / "out" / "batch.json").read_text())
    ledger["broken"] |= {"status": "failed", "due": 4_000_000_000.0}
    (tmp_path / "out" / "batch.json").write_text(json.dumps(ledger))
    assert batch(tmp_path / "clips", tmp_path / "out", config, workers=1)["set_aside"] == 1
    assert time.monotonic() - began < 60


def test_clips_of_one_name_are_told_and_the_first_is_worked_on(store: Path, tmp_path: Path) -> None:
    """And a clip that was set aside is taken again when its plate was replaced."""
    clips, out = tmp_path / "clips", tmp_path / "out"
    clips.mkdir()
    for name in ("broken.mp4", "broken.mov", "broken_plate.png"):
        (clips / name).write_text("no film and no picture")
        os.utime(clips / name, (1_700_000_000, 1_700_000_000))
    config = small_config().model_dump(mode="json")
    told = batch(clips, out, config, workers=1)
    assert (told["clips"], told["set_aside"]) == (2, 2)
    ledger = json.loads((out / "batch.json").read_text())
    assert "broken.mov" in ledger["broken"]["reason"]
    assert "rename one of them" not in ledger["broken"]["reason"]
    assert re.search(r"broken\.mp4 and .*broken\.mov are .* rename one of them", ledger["./broken.mp4"]["reason"])
    assert "rename one of them" in Path(told["page"]).read_text()
    assert not (out / "broken.mp4").exists()

    os.utime(clips / "broken_plate.png", (1_700_000_001, 1_700_000_001))
    batch(clips, out, config, workers=1)
    assert json.loads((out / "batch.json").read_text())["broken"]["stamp"] != ledger["broken"]["stamp"]
