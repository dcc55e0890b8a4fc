"""Links and special files below a folder that may come from somebody else."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from hfb.io.safe_folder import (
    NotOrdinary,
    check_ordinary,
    check_readable,
    check_tree,
    open_folder,
    open_lock,
    read_file,
)


def link(path: Path) -> None:
    (path.parent / "elsewhere").write_text("mine")
    path.symlink_to(path.parent / "elsewhere")


def dangling(path: Path) -> None:
    path.symlink_to(path.parent / "nowhere")


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def listening(path: Path) -> None:
    here = os.open(path.parent, os.O_RDONLY)
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(f"/proc/self/fd/{here}/{path.name}")  # a socket's path may have 108 characters
    os.close(here)


KINDS: dict[str, Callable[[Path], None]] = {
    "symbolic link": link,
    "dangling": dangling,
    "to a device": device,
    "named pipe": os.mkfifo,
    "socket": listening,
}


@pytest.fixture(params=KINDS)
def strange(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """What is no file of the folder."""
    place = tmp_path / "out" / "inner"
    place.mkdir(parents=True)
    KINDS[request.param](place / "strange")
    return place / "strange"


def test_nothing_but_files_and_folders_is_opened(strange: Path) -> None:
    out = strange.parents[1]
    with pytest.raises(NotOrdinary, match=r"strange is a .*: remove it"):
        check_tree(out)
    with pytest.raises(NotOrdinary):
        check_ordinary(out, "inner", "strange")
    with pytest.raises(NotOrdinary):
        read_file(out, "inner", "strange", limit=100)
    with pytest.raises(NotOrdinary):
        open_lock(out, "inner", "strange")
    with pytest.raises(NotOrdinary), open_folder(out, "inner", "strange", make=True):
        pass
    assert not (strange.parent / "nowhere").exists()
    if (strange.parent / "elsewhere").exists():
        assert (strange.parent / "elsewhere").read_text() == "mine"


def test_a_link_in_the_middle_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "elsewhere" / "inner").mkdir(parents=True)
    (tmp_path / "elsewhere" / "inner" / "file").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "linked").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(NotOrdinary, match="linked is a symbolic link"):
        read_file(tmp_path / "out", "linked", "inner", "file", limit=100)
    with pytest.raises(NotOrdinary, match="linked is a symbolic link"):
        open_lock(tmp_path / "out", "linked", "new")
    with pytest.raises(NotOrdinary), open_folder(tmp_path / "out", "linked", "new", make=True):
        pass
    assert [path.name for path in (tmp_path / "elsewhere").iterdir()] == ["inner"]


def test_the_users_own_folder_may_be_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    lock = open_lock(tmp_path / "out", "lock")
    os.write(lock, b"1")
    os.close(lock)
    lock = open_lock(tmp_path / "out", "lock")
    os.write(lock, b"2")
    os.close(lock)
    assert read_file(tmp_path / "out", "lock", limit=2) == b"12"
    with pytest.raises(ValueError, match="too large"):
        read_file(tmp_path / "out", "lock", limit=1)
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "out", "none", limit=1)
    check_tree(tmp_path / "out")
    check_tree(tmp_path / "out", "none")


def test_folders_within_folders_without_end(tmp_path: Path) -> None:
    deep = tmp_path.joinpath("out", *["d"] * 200)
    deep.mkdir(parents=True)
    with pytest.raises(NotOrdinary, match="nested more than"):
        check_tree(tmp_path / "out")


def test_a_users_input_may_be_a_link_and_no_pipe(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "to pipe").symlink_to(tmp_path / "pipe")
    check_readable(tmp_path / "link")
    check_readable(tmp_path)
    for name in ("pipe", "to pipe"):
        with pytest.raises(OSError, match="named pipe and no file"):
            check_readable(tmp_path / name)
