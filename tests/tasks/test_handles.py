"""Handles name finished files by content."""

import time
from pathlib import Path

import pytest

from hfb.config import FitConfig
from hfb.errors import InputError
from hfb.tasks.benchmark.judge_case import JudgedHandle
from hfb.tasks.core.handles import (
    FileHandle,
    FirstBodyHandle,
    FitHandle,
    StaleFile,
    digest,
    files_in,
    verify_unchanged,
    with_files,
)
from hfb.tasks.inputs.inputs import Inputs, input_file, input_hashes


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.bin"
    path.write_bytes(b"content")
    return path


def fit_of(file: Path, seconds: float = 1.0, loss: float = 0.5) -> FitHandle:
    one = FileHandle.of(file)
    return FitHandle(
        motion=one,
        texture=one,
        texture_image=one,
        history=one,
        mattes=(one,),
        seconds=seconds,
        stage_seconds={"stage_1": seconds},
        best_iteration=3,
        loss=loss,
    )


def test_a_handle_sees_that_its_file_changed(file: Path) -> None:
    handle = FileHandle.of(file)
    assert handle.path.is_absolute()
    handle.verify()
    file.write_bytes(b"Content")
    with pytest.raises(StaleFile, match="no longer what it was"):
        handle.verify()
    file.unlink()
    with pytest.raises(StaleFile, match="is gone"):
        handle.verify()


def test_the_digest_is_of_content_alone(file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "elsewhere.bin"
    copy.write_bytes(file.read_bytes())
    assert digest(FileHandle.of(file)) == digest(FileHandle.of(copy))
    assert digest(fit_of(file, seconds=1)) == digest(fit_of(copy, seconds=9))
    assert digest(fit_of(file, loss=0.5)) != digest(fit_of(file, loss=0.6))
    copy.write_bytes(b"other")
    assert digest((FileHandle.of(file),)) != digest((FileHandle.of(copy),))
    assert digest(FirstBodyHandle.of(file, source="a")) != digest(FirstBodyHandle.of(file, source="b"))
    assert digest(FitConfig()) != digest(FitConfig(subframes=9))
    assert digest([]) != digest(None)


def test_every_file_is_found(file: Path) -> None:
    one = FileHandle.of(file)
    assert len(list(files_in(fit_of(file)))) == 5
    assert list(files_in(Inputs(frames=(one, one), background=one, body=one))) == [one] * 4
    assert list(files_in(3)) == []
    judged = JudgedHandle.of(file, motion=one)  # a file that goes with others
    assert list(files_in(judged)) == [judged, one]


def test_every_file_is_moved(file: Path) -> None:
    def away(one: FileHandle) -> FileHandle:
        return one.model_copy(update={"path": Path("/away") / one.path.name})

    one, there = FileHandle.of(file), Path("/away/a.bin")
    moved = with_files((JudgedHandle.of(file, motion=one), [one], 3), away)
    assert (moved[0].path, moved[0].motion.path, moved[1][0].path, moved[2]) == (there, there, there, 3)


def test_handles_survive_json(file: Path) -> None:
    handle = fit_of(file)
    assert FitHandle.model_validate_json(handle.model_dump_json()) == handle


def test_inputs_by_role(file: Path, tmp_path: Path) -> None:
    one = input_file(file)
    hashes = input_hashes(Inputs(frames=(one, one), background=one, first_bodies=(one,)))
    assert set(hashes) == {"frame_0", "frame_1", "background", "first_body_0"}
    with pytest.raises(InputError, match="is a folder"):
        input_file(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        input_file(tmp_path / "none")


def test_what_is_replaced_while_it_is_read_is_seen(file: Path, tmp_path: Path) -> None:
    handle = FileHandle.of(file)
    with verify_unchanged(handle, [handle], 3):
        pass
    with pytest.raises(StaleFile, match="no longer what it was"), verify_unchanged(handle):
        file.write_bytes(b"Content")
    with pytest.raises(StaleFile, match="no longer what it was"), verify_unchanged(handle):
        pytest.fail("what is read is not what was given")
    file.write_bytes(b"content")
    with verify_unchanged(handle):  # the same content again is the same input
        (tmp_path / "backup").hardlink_to(file)
    other = tmp_path / "other"
    other.write_bytes(b"content")
    with pytest.raises(StaleFile, match="replaced while it was read"), verify_unchanged(handle):
        other.replace(file)
    with pytest.raises(StaleFile, match="is gone"), verify_unchanged(handle):
        file.unlink()


def test_a_file_that_nobody_touched_is_read_once(tmp_path: Path) -> None:
    """As a video of many gigabytes, which is checked before every frame."""
    file = tmp_path / "large"
    file.write_bytes(bytes(100_000_000))
    began = time.process_time()
    handle = FileHandle.of(file)
    once_s = time.process_time() - began
    began = time.process_time()
    for _ in range(20):
        handle.check()
    assert time.process_time() - began < once_s / 2
