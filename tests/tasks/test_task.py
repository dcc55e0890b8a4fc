"""The project's @task: what its key sees, and what it does not."""

from pathlib import Path

import pytest

from hfb.config import FitConfig, MattingConfig
from hfb.tasks.core import task as task_module
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.task import cache_key, code_version
from hfb.tasks.image.matte import matte


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
        key("matte"), key(seed=1), key(config=FitConfig(degree=3)), key(config=MattingConfig()),
        key(frame=handle.model_copy(update={"sha256": "0"})),
    ]  # fmt: skip
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
        patched.setattr(task_module.hfb, "__file__", str(package / "__init__.py"))
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
