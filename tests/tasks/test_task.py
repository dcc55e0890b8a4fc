"""The project's @task: what its key sees, and what it does not."""

import os
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from hfb.config import FitConfig, MattingConfig
from hfb.tasks.core import environment
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import Call, FileHandle
from hfb.tasks.image.matte import matte
from hfb.tasks.task import cache_key, task
from hfb.tasks.video.video_frames import find_matte
from hfb.tasks.workers.workers import workers


@pytest.fixture
def handle(tmp_path: Path) -> FileHandle:
    (tmp_path / "a").write_bytes(b"a")
    return FileHandle.of(tmp_path / "a")


def test_key_of_inputs_and_options(handle: FileHandle, tmp_path: Path) -> None:
    def key(name: str = "fit", **changed: object) -> str:
        return cache_key(name, {"frame": handle, "config": FitConfig(), "seed": 0, "folder": tmp_path} | changed)

    moved = handle.model_copy(update={"path": tmp_path / "b"})
    assert key() == key()
    assert key() == key(folder=tmp_path / "elsewhere")  # where results go does not change them
    assert key() == key(frame=moved)
    others = [
        key("matte"),
        key(seed=1),
        key(config=FitConfig(degree=3)),
        key(config=MattingConfig()),
        key(frame=handle.model_copy(update={"sha256": "0"})),
    ]
    assert len({key(), *others}) == 6
    assert "/" not in key()


def test_an_edit_of_the_method_changes_the_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handle: FileHandle
) -> None:
    package = tmp_path / "hfb"
    (package / "losses").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "losses" / "image.py").write_text("weight = 1")

    def key() -> str:
        code_version.cache_clear()
        return cache_key("fit", {"frame": handle})

    with monkeypatch.context() as patched:
        patched.setattr(environment.hfb, "__file__", str(package / "__init__.py"))
        before = key()
        (package / "__pycache__").mkdir()
        (package / "__pycache__" / "image.pyc").write_bytes(b"compiled")
        assert key() == before
        (package / "losses" / "image.py").write_text("weight = 2")
        assert key() != before
    code_version.cache_clear()


def test_the_bare_function_needs_no_server() -> None:
    assert matte.fn.__name__ == "matte"
    assert matte.fn is not matte


@pytest.mark.integration
def test_a_worker_gets_the_function_itself() -> None:
    """By its name, as functions are sent, and without the matter around it."""
    assert pickle.loads(pickle.dumps(find_matte)) is find_matte
    assert len(pickle.dumps(find_matte)) < 100
    with workers(2), ThreadPoolExecutor(1) as threads:
        assert threads.submit(process_of.run, _ProcessCall(number=3)).result() != os.getpid()
    assert process_of.run(_ProcessCall(number=3)) == os.getpid()


class _ProcessCall(Call):
    number: int


@task("process", where="worker")
def process_of(call: _ProcessCall) -> int:
    return os.getpid()


def test_where_a_call_writes_does_not_change_its_key(tmp_path: Path) -> None:
    class Writing(Call):
        number: int
        folder: Path

    def key(number: int, folder: Path) -> str:
        return cache_key("write", {"call": Writing(number=number, folder=folder)})

    assert key(1, tmp_path) == key(1, tmp_path / "elsewhere")
    assert key(1, tmp_path) != key(2, tmp_path)
