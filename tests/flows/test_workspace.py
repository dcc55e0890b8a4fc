"""What a result may take the place of: what earlier results left, and nothing of the user's."""

import json
import subprocess
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from hfb.errors import InputError
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.results import workspace as place
from hfb.tasks.results.workspace import OutputConflict, beside_result, publish, workspace


def published(out: Path, files: Mapping[str, str], **facts: Any) -> dict[str, Any]:
    """A result of these files' contents."""
    with workspace(out) as folder:
        made = {name: folder / f"made_{name}" for name in files}
        for name, content in files.items():
            made[name].write_text(content)
        result = {"out": str(out), **facts}
        publish(out, made, result)
    return result


def held(out: Path) -> dict[str, str]:
    """The user's view of a folder: every file but result.json, and what it holds."""
    return {path.name: path.read_text() for path in out.iterdir() if path.is_file() and path.name != "result.json"}


def forgetful(out: Path) -> None:
    """As a version left it that did not write down what it published."""
    content = json.loads((out / "result.json").read_text())
    del content["files"]
    (out / "result.json").write_text(json.dumps(content))


def test_only_what_an_earlier_result_left_is_removed(tmp_path: Path) -> None:
    mine = {"matte_holiday.png": "mine", "matte_7.png": "mine", "motion.glb": "mine", "report.html": "mine"}
    for name, content in mine.items():
        (tmp_path / name).write_text(content)
    first = published(tmp_path, {"motion.npz": "1", "matte_0.png": "1", "matte_1.png": "1", "overlay.mp4": "1"})
    assert json.loads((tmp_path / "result.json").read_text()) == first
    assert first["files"] == ["matte_0.png", "matte_1.png", "motion.npz", "overlay.mp4"]
    published(tmp_path, {"motion.npz": "2", "matte_0.png": "2"})
    assert held(tmp_path) == mine | {"motion.npz": "2", "matte_0.png": "2"}
    assert not (tmp_path / "intermediate" / "publish").exists()


def test_a_result_of_another_kind_leaves_nothing_of_the_first(tmp_path: Path) -> None:
    """As `hfb video --everyone` after `hfb video`; what a result.json from elsewhere names outside stays."""
    (tmp_path / "mine").write_text("mine")
    published(tmp_path / "out", {"motion.npz": "1", "curves.json": "1", "strip.png": "1"})
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    content["files"] += ["../mine", str(tmp_path / "mine"), "intermediate"]
    (tmp_path / "out" / "result.json").write_text(json.dumps(content))
    published(tmp_path / "out", {})
    assert held(tmp_path / "out") == {}
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_result_of_a_version_that_wrote_no_names_down(tmp_path: Path) -> None:
    first = {"motion.npz": "1", "curves.json": "1", "matte_0.png": "1", "matte_12.png": "1", "overlay.mp4": "1"}
    published(tmp_path, first)
    forgetful(tmp_path)
    (tmp_path / "matte_holiday.png").write_text("mine")
    (tmp_path / "matte_.png").write_text("mine")
    published(tmp_path, {"motion.npz": "2", "matte_0.png": "2"})
    kept = {"matte_holiday.png": "mine", "matte_.png": "mine", "curves.json": "1"}
    assert held(tmp_path) == kept | {"motion.npz": "2", "matte_0.png": "2"}


def test_what_was_made_of_a_result_goes_with_it(tmp_path: Path) -> None:
    """As the page of `hfb report`: it would show another fit."""
    published(tmp_path, {"motion.npz": "1"})
    (tmp_path / "overlay.mp4").write_text("mine")
    with beside_result(tmp_path, ["report.html"]) as place:
        (place / "report.html").write_text("of 1")
    assert (tmp_path / "report.html").read_text() == "of 1"
    assert json.loads((tmp_path / "result.json").read_text())["files"] == ["motion.npz", "report.html"]
    published(tmp_path, {"motion.npz": "2"})
    assert held(tmp_path) == {"motion.npz": "2", "overlay.mp4": "mine"}
    with beside_result(tmp_path / "elsewhere", ["report.html"]):
        assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("name", ["matte_0.png", "result.json"])
def test_what_hfb_did_not_put_there_is_not_replaced(tmp_path: Path, name: str) -> None:
    """Such as the exact matte in the folder of a synthetic case. What was computed is kept."""
    (tmp_path / name).write_text('{"somebody": "else"}')
    with pytest.raises(OutputConflict, match=f"holds {name}, .*move it away .*or choose another --out"):
        published(tmp_path, {"motion.npz": "1", "matte_0.png": "1"})
    assert (tmp_path / name).read_text() == '{"somebody": "else"}'
    assert not (tmp_path / "motion.npz").exists()
    assert (tmp_path / "intermediate" / "made_motion.npz").exists()
    (tmp_path / name).rename(tmp_path / "mine")
    published(tmp_path, {"motion.npz": "1", "matte_0.png": "1"})
    assert held(tmp_path) == {"mine": '{"somebody": "else"}', "motion.npz": "1", "matte_0.png": "1"}


@pytest.mark.parametrize("old", [False, True])
def test_inputs_of_the_run_are_neither_replaced_nor_removed(tmp_path: Path, old: bool) -> None:
    """Also where an earlier result left them."""
    published(tmp_path, {"motion.npz": "1", "overlay.mp4": "1 film", "joints.csv": "1"})
    if old:
        forgetful(tmp_path)
    start = {"init_file_0": sha256_of(tmp_path / "motion.npz")}
    with pytest.raises(OutputConflict, match=r"holds motion\.npz, an input of this run"):
        published(tmp_path, {"motion.npz": "2"}, inputs=start)
    assert held(tmp_path) == {"motion.npz": "1", "overlay.mp4": "1 film", "joints.csv": "1"}
    film = {"video": sha256_of(tmp_path / "overlay.mp4")}
    published(tmp_path, {"motion.npz": "2"}, inputs=film)
    assert held(tmp_path) == {"motion.npz": "2", "overlay.mp4": "1 film"}


def test_what_is_the_same_already_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / "strip.png").write_text("1")
    published(tmp_path, {"strip.png": "1"}, inputs={"frame_0": sha256_of(tmp_path / "strip.png")})
    assert held(tmp_path) == {"strip.png": "1"}


def test_a_first_result_that_was_killed_half_way_is_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files lie there without a result.json; what was removed since has to go with it."""

    class Killed(BaseException):
        pass

    replace = Path.replace

    def killed(path: Path, target: Path) -> Path:
        if path.parent.name == "publish" and path.name == "result.json":
            raise Killed
        return replace(path, target)

    monkeypatch.setattr(place.Path, "replace", killed)
    with pytest.raises(Killed):
        published(tmp_path, {"motion.npz": "1", "overlay.mp4": "1"})
    monkeypatch.undo()
    assert held(tmp_path) == {"motion.npz": "1", "overlay.mp4": "1"}
    published(tmp_path, {"motion.npz": "2"})
    assert held(tmp_path) == {"motion.npz": "2"}


@pytest.mark.parametrize(
    "content", ["", "[]", "3", '{"out": 3}', '{"out": "x", "files": 3}', '{"out": "x", "files": [[]]}']
)
def test_a_result_that_says_nonsense_removes_nothing(tmp_path: Path, content: str) -> None:
    (tmp_path / "result.json").write_text(content)
    (tmp_path / "overlay.mp4").write_text("mine")
    with suppress(OutputConflict):
        published(tmp_path, {"motion.npz": "1"})
    assert (tmp_path / "overlay.mp4").read_text() == "mine"


def test_names_in_a_result_lead_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "overlay.mp4").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.json").write_text(json.dumps({"out": "x", "files": ["../overlay.mp4", "intermediate", "notes.txt"]}))
    (out / "notes.txt").write_text("mine")
    published(out, {"motion.npz": "1"})
    assert held(out) == {"notes.txt": "mine", "motion.npz": "1"}
    assert (tmp_path / "overlay.mp4").exists()


def test_intermediate_files_on_a_mount_of_their_own(tmp_path: Path) -> None:
    """Files cannot be renamed across mounts: said before anything is computed or replaced."""
    published(tmp_path, {"motion.npz": "1"})
    folder = tmp_path / "intermediate"
    if subprocess.run(["mount", "--bind", str(folder), str(folder)], capture_output=True).returncode:
        pytest.skip("nothing can be mounted here")
    try:
        with pytest.raises(InputError, match="is mounted by itself"):
            published(tmp_path, {"motion.npz": "2"})
        assert [path.name for path in folder.iterdir() if path.name != "made_motion.npz"] == [".lock"]
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
    assert held(tmp_path) == {"motion.npz": "1"}
    published(tmp_path, {"motion.npz": "2"})
    assert held(tmp_path) == {"motion.npz": "2"}


def test_two_exports_at_once(tmp_path: Path) -> None:
    """The files in the end are of one of them."""

    def export(content: str) -> None:
        with beside_result(tmp_path, names) as place:
            for name in names:
                (place / name).write_text(content)
            both.wait()

    names, both = [f"matte_{number}.png" for number in range(40)], threading.Barrier(2)
    for _ in range(3):
        with ThreadPoolExecutor() as pool:
            list(pool.map(export, ("1", "2")))
        assert len({(tmp_path / name).read_text() for name in names}) == 1
