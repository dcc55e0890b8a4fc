"""A result's folder of somebody else: its links lead nowhere, and nothing that hfb did not write is lost."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hfb.body.assets import load_default_body
from hfb.config import RunConfig
from hfb.datasets.synthetic.clip_making import _make_room
from hfb.errors import InputError, TemporaryError
from hfb.flows.compare import _check_room
from hfb.flows.export import export_result
from hfb.flows.report import make_report
from hfb.io.safe_folder import NotOrdinary
from hfb.motion.motion_file import save_motion
from hfb.tasks.core.result_folder import check_result
from hfb.tasks.core.result_records import drop_foreign
from hfb.tasks.results.stored_runs import find_run
from hfb.tasks.results.workspace import beside_result, mark_unfinished, publish, workspace
from tests.flows.test_workspace import published
from tests.interop.writers.motions import motion_of
from tests.orchestration import is_finished


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """The user's own files, elsewhere."""
    for name in ("hfb-mine", "mine.part", "motion.npz", "result.json", ".lock", "frame_0000_sub_00.obj", "0.png"):
        (tmp_path / "outside" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "outside" / name).write_text("mine")
    return tmp_path / "outside"


def is_whole(outside: Path) -> bool:
    return len(list(outside.iterdir())) == 7 and all(path.read_text() == "mine" for path in outside.iterdir())


@pytest.mark.parametrize(
    ("place", "target"),
    [
        ("intermediate", "."),
        ("intermediate/records", "."),
        ("intermediate/.lock", ".lock"),
        ("intermediate/publish", "."),
        ("intermediate/publish/motion.npz", "motion.npz"),
        ("intermediate/records/hfb-1", "hfb-mine"),
        ("intermediate/matte", "none"),
        ("result.json", "result.json"),
        ("motion.npz", "motion.npz"),
        ("matte_3.png", "0.png"),
        ("cases", "."),
        ("person-2", "."),
        ("export", "."),
        ("overlay.mp4", "none"),
    ],
)
def test_links_in_a_folder_for_results(outside: Path, tmp_path: Path, place: str, target: str) -> None:
    link = tmp_path / "out" / place
    link.parent.mkdir(parents=True)
    link.symlink_to(outside / target)
    with pytest.raises(NotOrdinary, match=f"{place} is a symbolic link"), workspace(tmp_path / "out"):
        pytest.fail("worked in")
    assert is_whole(outside)
    assert link.is_symlink()


@pytest.mark.parametrize("place", ["intermediate/.lock", "result.json", "intermediate/records/hfb-1", "strip.png"])
def test_pipes_do_not_hang(tmp_path: Path, place: str) -> None:
    pipe = tmp_path / "out" / place
    pipe.parent.mkdir(parents=True)
    os.mkfifo(pipe)
    with pytest.raises(NotOrdinary, match=f"{place} is a named pipe"), workspace(tmp_path / "out"):
        pytest.fail("worked in")


def test_the_users_own_link(outside: Path, tmp_path: Path) -> None:
    """As --out, or above it; and what hfb has no name for may be anything."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    (tmp_path / "disk" / "notes").symlink_to(outside)
    published(tmp_path / "out", {"motion.npz": "1"})
    published(tmp_path / "out" / "inner", {"motion.npz": "1"})
    assert (tmp_path / "disk" / "inner" / "motion.npz").read_text() == "1"
    assert is_whole(outside)


def test_a_lock_is_not_emptied(tmp_path: Path) -> None:
    (tmp_path / "intermediate").mkdir()
    (tmp_path / "intermediate" / ".lock").write_text("mine")
    with workspace(tmp_path):
        pass
    assert (tmp_path / "intermediate" / ".lock").read_text() == "mine"


@pytest.fixture
def received(tmp_path: Path) -> Path:
    """A result of which but the motion and the facts are there."""
    out = tmp_path / "received"
    save_motion(tmp_path / "motion.npz", motion_of(load_default_body(), frames=1), "hfb")
    with workspace(out):
        publish(out, {"motion.npz": tmp_path / "motion.npz"}, {"out": str(out), "mlflow_run_id": None})
    return out


@pytest.mark.parametrize(
    "place",
    [
        "result.json",
        "motion.npz",
        "texture.png",
        "strip.png",
        "curves.json",
        "intermediate/page_film.mp4",
        "intermediate",
    ],
)
@pytest.mark.parametrize("make", [lambda path, target: path.symlink_to(target), lambda path, _: os.mkfifo(path)])
def test_readers_of_a_received_result(
    outside: Path, received: Path, place: str, make: Callable[[Path, Path], None]
) -> None:
    taken = received / place
    if taken.exists():
        taken.rename(received / "away")
    make(taken, outside / "0.png" if taken.suffix else outside)
    with pytest.raises(InputError, match=f"{place} is a (symbolic link|named pipe)"):
        make_report(str(received), None)
    if place in ("result.json", "motion.npz", "texture.png"):
        with pytest.raises(InputError, match=f"{place} is a (symbolic link|named pipe)"):
            export_result(str(received), None, ("csv",), ())
    if place == "result.json":
        with pytest.raises(InputError, match=f"{place} is a (symbolic link|named pipe)"):
            find_run(str(received))
    assert is_whole(outside)
    assert not (received / "export").exists()


def test_exports_stay_in_the_folder(outside: Path, received: Path, tmp_path: Path) -> None:
    (received / "export").symlink_to(outside)
    with pytest.raises(NotOrdinary, match="export is a symbolic link"):
        export_result(str(received), None, ("csv",), ())
    (received / "export").unlink()
    (received / "export").mkdir()
    (received / "export" / "meshes").symlink_to(outside)
    for out in (None, received / "export"):
        with pytest.raises(NotOrdinary, match="meshes is a symbolic link"):
            export_result(str(received), out, (), ("obj",))
    assert is_whole(outside)
    (tmp_path / "clip").mkdir()
    (tmp_path / "clip" / "clip.toml").touch()
    with pytest.raises(InputError, match="the folder of a clip"):
        export_result(str(received), tmp_path / "clip", ("csv",), ())
    assert set(export_result(str(received / "motion.npz"), tmp_path / "new", ("csv",), ())["files"]) == {"joints.csv"}
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(InputError, match="named pipe and no file"):
        export_result(str(tmp_path / "pipe.npz"), None, ("csv",), ())


def test_an_export_beside_a_result_takes_nothing_of_the_users(received: Path) -> None:
    (received / "joints.csv").write_text("mine")
    with pytest.raises(InputError, match=r"holds joints\.csv, an input of this run or no file of hfb's"):
        export_result(str(received), received, ("csv",), ())
    assert (received / "joints.csv").read_text() == "mine"
    (received / "joints.csv").rename(received / "mine.csv")
    for _ in range(2):
        assert set(export_result(str(received), received, ("csv",), ())["files"]) == {"joints.csv"}
    told = json.loads((received / "result.json").read_text())
    assert told["files"] == ["joints.csv", "motion.npz"]
    assert is_finished(received)
    assert not (received / "intermediate" / "publish").exists()


def test_what_the_user_changed_is_not_removed(tmp_path: Path) -> None:
    """As a motion.glb that was saved again from another program; one that was not goes with its result."""
    published(tmp_path, {"motion.npz": "1", "motion.glb": "1", "motion.bvh": "1"})
    (tmp_path / "motion.glb").write_text("edited")
    published(tmp_path, {"motion.npz": "2"})
    assert (tmp_path / "motion.glb").read_text() == "edited"
    assert not (tmp_path / "motion.bvh").exists()
    with pytest.raises(InputError, match=r"holds motion\.glb"):
        published(tmp_path, {"motion.npz": "3", "motion.glb": "3"})
    assert (tmp_path / "motion.npz").read_text() == "2"


def test_what_a_killed_writer_left_and_what_others_did(tmp_path: Path) -> None:
    """Other programs end names of unfinished files in .part too."""
    (tmp_path / "intermediate").mkdir()
    left = (".motion.npz.123-0a1b2c3d.part", ".overlay.123-0a1b2c3d.part.mp4", "intermediate/.x.npz.1-a.part")
    kept = (".video.mp4.part", ".holiday.jpg.123-0a1b2c3d.part", "movie.part", "intermediate/.x.part")
    for name in (*left, *kept):
        (tmp_path / name).write_text("x")
    with workspace(tmp_path):
        pass
    assert not [name for name in left if (tmp_path / name).exists()]
    assert all((tmp_path / name).exists() for name in kept)


def test_files_of_others_among_the_staged_ones(tmp_path: Path) -> None:
    (tmp_path / "intermediate" / "publish").mkdir(parents=True)
    (tmp_path / "intermediate" / "publish" / "holiday.jpg").write_text("mine")
    published(tmp_path, {"motion.npz": "1"})
    assert (tmp_path / "intermediate" / "publish" / "holiday.jpg").read_text() == "mine"


def test_records_of_others_are_kept_away_from_prefect(outside: Path, tmp_path: Path) -> None:
    records = tmp_path / "records"
    records.mkdir()
    (records / "holiday.jpg").write_text("mine")
    assert drop_foreign(records) == 1
    (records / "holiday.jpg").write_text("another")
    assert drop_foreign(records) == 1
    assert not list(records.iterdir())
    assert sorted(path.read_text() for path in (tmp_path / "records-set-aside").iterdir()) == ["another", "mine"]
    records.rmdir()
    records.symlink_to(outside)
    with pytest.raises(NotOrdinary):
        drop_foreign(records)
    assert is_whole(outside)


def test_a_file_where_a_folder_belongs(tmp_path: Path) -> None:
    (tmp_path / "intermediate").write_text("mine")
    with pytest.raises(TemporaryError, match="is another kind: move it away"), workspace(tmp_path):
        pytest.fail("worked in")
    (tmp_path / "intermediate").unlink()
    (tmp_path / "motion.npz").mkdir()
    with pytest.raises(InputError, match=r"holds motion\.npz"):
        published(tmp_path, {"motion.npz": "1"})


@pytest.mark.parametrize("inner", ["intermediate", "intermediate/publish", "intermediate/new/new"])
def test_no_result_among_the_intermediate_files_of_another(tmp_path: Path, inner: str) -> None:
    published(tmp_path, {"motion.npz": "1"})
    with pytest.raises(InputError, match="lies among the intermediate files"), workspace(tmp_path / inner):
        pytest.fail("worked in")
    (tmp_path / "lost").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="a link that leads nowhere"), workspace(tmp_path / "lost"):
        pytest.fail("worked in")


def test_an_unfinished_result_is_told_and_mended(tmp_path: Path) -> None:
    mark_unfinished(tmp_path)
    assert not list(tmp_path.iterdir())
    published(tmp_path, {"motion.npz": "1", "overlay.mp4": "1"})
    with workspace(tmp_path):
        mark_unfinished(tmp_path)
    assert not is_finished(tmp_path)
    with pytest.raises(InputError, match="is unfinished"):
        check_result(tmp_path, ())
    with beside_result(tmp_path, ["report.html"]) as place:
        (place / "report.html").write_text("page")
    assert not is_finished(tmp_path)
    published(tmp_path, {"motion.npz": "2"})
    assert is_finished(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["intermediate", "motion.npz", "result.json"]


@pytest.mark.parametrize("place", ["frames", "frames/00000.png", "clip.mp4", "clip.toml", "background.png"])
def test_a_synthetic_clip_stays_in_its_folder(outside: Path, tmp_path: Path, place: str) -> None:
    link = tmp_path / "clip" / place
    link.parent.mkdir(parents=True)
    (tmp_path / "clip" / "clip.toml").write_text("# made by `hfb synth clip`: 3 frames\n")
    if place == "clip.toml":
        link.unlink()
    link.symlink_to(outside if place == "frames" else outside / "0.png")
    with pytest.raises(NotOrdinary, match="is a symbolic link"):
        _make_room(tmp_path / "clip")
    assert is_whole(outside)


def test_a_comparison_takes_nothing_of_the_users(tmp_path: Path) -> None:
    _check_room(tmp_path)
    (tmp_path / "comparison.png").write_text("mine")
    with pytest.raises(InputError, match=r"comparison\.png, which `hfb compare` did not put there"):
        _check_room(tmp_path)
    (tmp_path / "comparison.json").write_text('{"run_a": "1"}')
    _check_room(tmp_path)
    (tmp_path / "comparison.html").symlink_to(tmp_path / "comparison.png")
    with pytest.raises(NotOrdinary):
        _check_room(tmp_path)


def test_the_examples_folder(outside: Path, tmp_path: Path) -> None:
    from hfb.flows.fit_image import fit_example

    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "example").symlink_to(outside)
    with pytest.raises(NotOrdinary, match="example is a symbolic link"):
        fit_example(tmp_path / "out", RunConfig())
    assert is_whole(outside)


def test_meshes_do_not_take_the_users_texture(received: Path) -> None:
    meshes = received / "export" / "meshes"
    meshes.mkdir(parents=True)
    (meshes / "texture.png").write_text("mine")
    with pytest.raises(TemporaryError, match=r"texture\.png is not from hfb"):
        export_result(str(received), None, (), ("obj",))
    assert (meshes / "texture.png").read_text() == "mine"
    assert np.load(received / "motion.npz")["poses"].shape[1] == 72
