"""A result's folder from elsewhere: its records are data, whatever they say of themselves."""

import json
from pathlib import Path
from typing import Any

import pytest
from prefect import flow, task
from prefect.filesystems import LocalFileSystem
from prefect.results import ResultRecord, ResultStore, get_result_store
from prefect.serializers import JSONSerializer, PickleSerializer

from hfb.tasks.core import result_records
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.result_records import drop_foreign, read_own_records_alone, records_in
from tests.orchestration import orchestrated


class Attack:
    """Opened by pickle, it writes a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return Path.touch, (self.target,)


def store(folder: Path, serializer: Any) -> ResultStore:
    """Where Prefect keeps a task's result."""
    return ResultStore(
        result_storage=LocalFileSystem(basepath=str(folder)), serializer=serializer, cache_result_in_memory=False
    )


@pytest.fixture
def as_prefect_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Undoes what a command did earlier in this process, and afterwards what the test does."""
    monkeypatch.setattr(ResultRecord, "deserialize", result_records._deserialize)


@pytest.mark.usefixtures("as_prefect_reads")
def test_a_pickled_record_is_removed_before_prefect_runs_it(tmp_path: Path) -> None:
    attack = Attack(tmp_path / "attacked")
    store(tmp_path / "records", PickleSerializer()).write(attack, key="hfb-find_matte-0")
    ours = store(tmp_path / "records", JSONSerializer())
    ours.read("hfb-find_matte-0")
    assert attack.target.exists(), "Prefect no longer reads records so: the test shows nothing"
    attack.target.unlink()

    assert drop_foreign(tmp_path / "records") == 1
    assert not (tmp_path / "records" / "hfb-find_matte-0").exists()
    assert not attack.target.exists()


@pytest.mark.usefixtures("as_prefect_reads")
def test_a_record_is_looked_at_again_when_it_is_read(tmp_path: Path) -> None:
    """Put there after the folder was looked at, or anywhere, by a run's state that names it as the run's result."""
    attack = Attack(tmp_path / "attacked")
    (tmp_path / "a").write_bytes(b"1")
    theirs, ours = (store(tmp_path / "records", kind) for kind in (PickleSerializer(), JSONSerializer()))
    theirs.write(attack, key="hfb-find_matte-0")
    theirs.write((1, 2), key="hfb-find_matte-1")
    (tmp_path / "records" / "hfb-find_matte-2").write_bytes(PickleSerializer().dumps(attack))
    ours.write(FileHandle.of(tmp_path / "a"), key="hfb-find_matte-3")
    read_own_records_alone()
    for number in range(3):
        for reader in (ours, theirs):
            with pytest.raises(ValueError, match="no record of hfb's"):
                reader.read(f"hfb-find_matte-{number}")
    assert not attack.target.exists()
    assert ours.read("hfb-find_matte-3").result == FileHandle.of(tmp_path / "a")


@pytest.mark.integration
def test_a_flow_within_another_keeps_its_own_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `hfb batch` runs clips, and a deployment any flow."""
    place = str(tmp_path / "clip" / "records")

    def kept() -> str:
        return str(get_result_store().result_storage.basepath)

    def nested() -> tuple[str, str]:
        with records_in(tmp_path / "clip"):
            return flow(kept, persist_result=False)(), kept_by_task()

    kept_by_task = task(kept, name="kept")
    with orchestrated(tmp_path, monkeypatch):
        assert flow(nested, persist_result=False)() == (place, place)


def test_our_own_records_stay(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"1")
    handle = FileHandle.of(tmp_path / "a")
    ours = store(tmp_path / "records", JSONSerializer())
    ours.write((handle, [handle], 3, None), key="hfb-find_matte-1")
    assert drop_foreign(tmp_path / "records") == 0
    assert ours.read("hfb-find_matte-1").result[0] == handle
    assert drop_foreign(tmp_path / "none") == 0


@pytest.mark.parametrize(
    "change",
    [
        {"serializer": {"jsonlib": "os"}},
        {"serializer": {"object_decoder": "os.system"}},
        {"serializer": {"type": "compressed/pickle"}},
        {"serializer": {"loads_kwargs": {"cls": "a"}}},
        {"result": {"__class__": "subprocess.Popen", "data": ["touch", "x"]}},
        {"result": {"__exc_type__": "builtins.SystemExit", "message": "0"}},
        {"result": [{"__class__": 3}]},
        {"name": "other"},
        {"text": "{"},
        {"text": "[" * 100_000},
        {"text": '{"metadata": 3}'},
    ],
    ids=str,
)
def test_whatever_is_not_exactly_ours_goes(tmp_path: Path, change: dict[str, Any]) -> None:
    serializer = JSONSerializer().model_dump(mode="json") | change.get("serializer", {})
    result = change.get("result", {"__class__": "hfb.tasks.core.handles.FileHandle", "data": {}})
    record = {"metadata": {"serializer": serializer}, "result": json.dumps(result)}
    (tmp_path / change.get("name", "hfb-x-1")).write_text(change.get("text", json.dumps(record)))
    assert drop_foreign(tmp_path) == 1
    assert not list(tmp_path.iterdir())
