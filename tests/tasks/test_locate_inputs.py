"""A run's inputs are found where they are, by what they hold."""

from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.results.reload_inputs import locate_inputs
from hfb.tasks.tracking.recipe import GivenFile


@pytest.fixture
def files(tmp_path: Path) -> dict[str, GivenFile]:
    given = {}
    for role, content in (("frame_0", b"one"), ("frame_1", b"two"), ("background", b"three")):
        path = tmp_path / "then" / f"{role}.png"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
        given[role] = GivenFile(path=path, sha256=FileHandle.of(path).sha256, bytes=len(content))
    return given


def test_at_their_places(files: dict[str, GivenFile]) -> None:
    assert locate_inputs(files, None) == {file.sha256: file.path for file in files.values()}


def test_moved_and_renamed(files: dict[str, GivenFile], tmp_path: Path) -> None:
    deep = tmp_path / "now" / "deep"
    deep.mkdir(parents=True)
    (deep / "same length").write_bytes(b"eno")
    files["frame_0"].path.rename(deep / "renamed")
    files["background"].path.rename(tmp_path / "now" / "plate.png")
    found = locate_inputs(files, tmp_path / "now")
    assert found[files["frame_0"].sha256] == deep / "renamed"
    assert found[files["background"].sha256] == tmp_path / "now" / "plate.png"
    assert found[files["frame_1"].sha256] == files["frame_1"].path


def test_what_is_gone_and_what_was_changed_is_named(files: dict[str, GivenFile], tmp_path: Path) -> None:
    files["frame_0"].path.unlink()
    files["background"].path.write_bytes(b"other")
    with pytest.raises(InputError) as said:
        locate_inputs(files, None)
    text = str(said.value)
    assert f"frame_0 ({files['frame_0'].path}) is gone" in text
    assert f"background ({files['background'].path}) was changed" in text
    assert "frame_1" not in text
    assert "--inputs DIR" in text
    with pytest.raises(InputError, match="nor are they in"):
        locate_inputs(files, tmp_path / "then")
    with pytest.raises(InputError, match="is no folder"):
        locate_inputs(files, tmp_path / "nowhere")


def test_many_are_not_all_listed(files: dict[str, GivenFile]) -> None:
    lost = {f"frame_{k}": files["frame_0"].model_copy(update={"path": Path("none")}) for k in range(300)}
    with pytest.raises(InputError, match="and 295 more"):
        locate_inputs(lost, None)
