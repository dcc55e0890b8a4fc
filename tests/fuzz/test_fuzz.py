"""Some hundred damaged files of every kind; `python -m tests.fuzz.campaign` opens ten thousand."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hfb.errors import InputError
from tests.fuzz import worker
from tests.fuzz.campaign import Report, run
from tests.fuzz.damage import Case, make_case
from tests.fuzz.hostile import CANARY
from tests.fuzz.readers import READERS
from tests.fuzz.seeds import make_seeds

CASES, CAMPAIGN = 300, 1


def test_damaged_files_are_read_or_refused_in_one_sentence(tmp_path: Path) -> None:
    report = run(range(CASES), CAMPAIGN, 1, tmp_path)
    assert report.failures == []
    assert report.outcomes["read"] + report.outcomes["refused"] == CASES
    assert report.outcomes["read"] > CASES / 20, "damage that nobody survives tests the first line of each reader only"


def test_a_case_is_a_function_of_its_number() -> None:
    seeds = make_seeds()
    assert [make_case(seeds, 3, n) for n in range(60)] == [make_case(seeds, 3, n) for n in range(60)]
    assert {seed.kind for seed in seeds} == set(READERS), "every kind has a whole file, and every file a reader"


def _broken(path: Path) -> None:
    raise ZeroDivisionError(path)


def _chatty(path: Path) -> None:
    raise InputError(f"{path} cannot be used:\nlook at it")


def _runs(path: Path) -> None:
    Path(CANARY).touch()


def _leaves(path: Path) -> None:
    (path.parent / "left").touch()


@pytest.mark.parametrize(
    ("read", "says"),
    [(_broken, "ZeroDivisionError"), (_chatty, "not one sentence"), (_runs, CANARY), (_leaves, "left")],
)
def test_a_failure_is_seen(
    read: Callable[[Path], Any], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(worker.READERS, "case", (read,))
    told = worker.judge(Case("case", "case.json", "none", b"{}"), 0)
    assert told["outcome"] == "failed"
    assert says in told["said"]


@pytest.mark.parametrize(("seconds", "peak_mb", "says"), [(11.0, 1.0, "took 11.0 s"), (1.0, 3000.0, "took 3000 MB")])
def test_what_takes_too_much_is_a_failure(seconds: float, peak_mb: float, says: str) -> None:
    report = Report()
    told = {"number": 0, "kind": "a", "outcome": "refused", "seconds": seconds, "peak_mb": peak_mb, "said": ""}
    report.add(told)
    assert report.failures[0]["said"] == says
