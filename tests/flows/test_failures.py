"""What is told of a run that could not go on."""

from pathlib import Path

import pytest
from prefect.exceptions import TerminationSignal

from hfb.flows.runtime.failures import explain_failures


def fail_at(end: BaseException) -> None:
    """As Prefect 3.8.8 does where it writes down that a task crashed."""
    try:
        raise end
    finally:
        raise ValueError("Task run is not set")


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt()),
        (SystemExit(143), SystemExit(143)),
        (TerminationSignal(15), SystemExit(143)),  # Prefect's, while a flow runs
    ],
    ids=["Ctrl-C", "TERM", "TERM in a flow"],
)
def test_an_end_that_a_library_failed_at_is_an_end(end: BaseException, expected: BaseException, tmp_path: Path) -> None:
    with pytest.raises(type(expected)) as told, explain_failures(tmp_path):
        fail_at(end)
    assert told.value.args == expected.args


def test_what_has_nothing_to_do_with_it_passes(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="mine"), explain_failures(tmp_path):
        raise ValueError("mine")
