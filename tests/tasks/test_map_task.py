"""Many calls of one task: every one once and in order, each with a result of its own, in few runs of Prefect's."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from hfb.errors import InputError
from hfb.tasks.core.handles import Call, FileHandle
from hfb.tasks.core.result_records import records_in
from hfb.tasks.map_task import Outcome, map_task, split_calls
from hfb.tasks.task import BatchFunction, task
from tests.orchestration import prefect_api

_COUNT = 300
_WRONG = 77


class NumberCall(Call):
    """A number, and the folder for its file."""

    number: int
    folder: Path


def calls_of(numbers: Sequence[int], folder: Path) -> list[NumberCall]:
    return [NumberCall(number=number, folder=folder) for number in numbers]


@task("numbers")
def write_number(call: NumberCall) -> FileHandle:
    """A file with a number; one number cannot be written."""
    number, folder = call.number, call.folder
    if number == _WRONG:
        raise InputError(f"{number} is wrong")
    with (folder / "written").open("a") as told:
        told.write(f"{number}\n")
    path = folder / f"number_{number}"
    path.write_text(str(number))
    return FileHandle.of(path)


def written(folder: Path) -> list[int]:
    """What was written since the last look."""
    told = folder / "written"
    numbers = [int(one) for one in told.read_text().split()] if told.exists() else []
    told.unlink(missing_ok=True)
    return numbers


def run(folder: Path, numbers: range) -> tuple[list[Outcome[FileHandle]], list[int], str]:
    """The outcomes, the order in which they were told, and the flow run."""
    told: list[int] = []

    def many() -> tuple[list[Outcome[FileHandle]], str]:
        from prefect.runtime import flow_run

        calls = calls_of(numbers, folder)
        return map_task(write_number, calls, "numbers", lambda at, outcome: told.append(at)), str(flow_run.id)

    threads: Any = ThreadPoolTaskRunner(max_workers=3)
    with records_in(folder):
        outcomes, this = flow(name="many", task_runner=threads, persist_result=False)(many)()
    return outcomes, told, this


@pytest.mark.parametrize("count", [0, 1, 2, 7, 31, 300, 10_000])
@pytest.mark.parametrize("n_workers", [1, 4, 34])
def test_every_call_is_in_one_chunk_and_the_last_ones_are_small(count: int, n_workers: int) -> None:
    calls = calls_of(range(count), Path())
    made = list(split_calls("x", calls, n_workers))
    assert [call for one in made for call in one.calls] == calls
    assert all(1 <= len(one.calls) <= 16 for one in made)
    at_the_end = made[-4 * n_workers :]
    assert all(len(one.calls) == 1 for one in at_the_end)
    if count == 10_000 and n_workers == 4:
        assert len(made) < count / 14
        assert str(made[1]) == "x 16 to 31"
        assert str(made[-1]) == "x 9999"


def test_each_call_has_its_own_result(store: Path, tmp_path: Path) -> None:
    outcomes, told, first = run(tmp_path, range(_COUNT))
    assert told == list(range(_COUNT))
    assert sorted(written(tmp_path)) == [number for number in range(_COUNT) if number != _WRONG]
    for number, outcome in enumerate(outcomes):
        if number == _WRONG:
            assert isinstance(outcome.error, InputError)
        else:
            assert outcome.result is not None
            assert outcome.result.path.read_text() == str(number)
            assert not outcome.reused

    (tmp_path / "number_5").unlink()
    (tmp_path / "number_6").write_text("7")
    again, _, second = run(tmp_path, range(100, -1, -1))  # others go together now
    assert sorted(written(tmp_path)) == [5, 6], "a result was lost, or damaged, or forgotten"
    assert [one.reused for one in again].count(False) == 3
    assert isinstance(again[100 - _WRONG].error, InputError)
    assert (tmp_path / "number_6").read_text() == "6"

    few, most = task_runs(first, "numbers 299"), task_runs(second, "numbers 100")
    assert 40 < len(few) < _COUNT / 3
    assert {state for _, state in few} == {"Completed", "Failed"}
    assert ("numbers 0 to 15", "Completed") in few
    assert "Cached" in {state for _, state in most}


def test_what_an_outcome_raises_ends_the_rest(store: Path, tmp_path: Path) -> None:
    def many() -> None:
        def stop(at: int, outcome: Outcome[FileHandle]) -> None:
            if outcome.error is not None:
                raise outcome.error

        map_task(write_number, calls_of(range(_COUNT), tmp_path), "numbers", stop)

    threads: Any = ThreadPoolTaskRunner(max_workers=3)
    with records_in(tmp_path), pytest.raises(InputError, match="77 is wrong"):
        flow(name="many", task_runner=threads, persist_result=False)(many)()
    assert _WRONG < len(written(tmp_path)) < _COUNT


def task_runs(flow_run: str, last: str) -> set[tuple[str, str]]:
    """Name and state of the task runs of a flow run, once they are written."""
    from prefect.client.orchestration import SyncPrefectClient
    from prefect.client.schemas.filters import TaskRunFilter

    of_this = TaskRunFilter.model_validate({"flow_run_id": {"any_": [flow_run]}})
    until = time.monotonic() + 60
    with SyncPrefectClient(prefect_api()) as client:
        while True:
            found = client.read_task_runs(task_run_filter=of_this)
            if last in {one.name for one in found} and all(
                one.state is not None and one.state.is_final() for one in found
            ):
                return {(one.name, one.state.name) for one in found if one.state is not None}
            assert time.monotonic() < until
            time.sleep(0.5)


def _write_together(calls: Sequence[NumberCall]) -> list[FileHandle]:
    numbers = [call.number for call in calls]
    with (calls[0].folder / "together").open("a") as told:
        told.write(" ".join(map(str, numbers)) + "\n")
    if _WRONG in numbers:
        raise InputError("one is wrong, so none is made")
    return [write_number.fn(call) for call in calls]


@task("numbers together", batch=BatchFunction(lambda _: 10, _write_together))
def write_together(call: NumberCall) -> FileHandle:
    return write_number.fn(call)


def test_batched_calls_keep_results_of_their_own(store: Path, tmp_path: Path) -> None:
    def several() -> list[Outcome[FileHandle]]:
        return map_task(write_together, calls_of(range(60, 85), tmp_path), "numbers")

    def again() -> list[Outcome[FileHandle]]:
        threads: Any = ThreadPoolTaskRunner(max_workers=3)
        with records_in(tmp_path):
            return flow(name="several", task_runner=threads, persist_result=False)(several)()

    outcomes, told = again(), tmp_path / "together"
    assert sorted(written(tmp_path)) == [number for number in range(60, 85) if number != _WRONG]
    batches = sorted(told.read_text().splitlines())
    assert [len(one.split()) for one in batches] == [10, 10, 5]
    assert [type(one.error) for one in outcomes].count(InputError) == 1, "one that fails took others with it"

    told.unlink()
    (tmp_path / "number_61").unlink()
    (tmp_path / "number_82").write_text("damaged")
    second = again()
    assert sorted(written(tmp_path)) == [61, 82]
    assert [one.reused for one in second].count(False) == 3
    assert all(one.error is not None or one.result.path.exists() for one in second if one.result or one.error)
