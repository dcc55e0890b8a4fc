"""Fixtures of the command line tests: a place of their own on the session's one server."""

import logging
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.orchestration import Problem, orchestrated, tiny_problem


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with orchestrated(tmp_path, monkeypatch) as database:
        yield database


@pytest.fixture(scope="session")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return tiny_problem(tmp_path_factory.mktemp("problem"))


@pytest.fixture(autouse=True)
def _own_logging() -> Iterator[None]:
    """`main` adds handlers and catches SIGTERM; put back what was there."""
    root, before = logging.getLogger(), signal.getsignal(signal.SIGTERM)
    handlers, level = list(root.handlers), root.level
    yield
    for handler in set(root.handlers) - set(handlers):
        root.removeHandler(handler)
        handler.close()
    root.setLevel(level)
    logging.captureWarnings(False)
    signal.signal(signal.SIGTERM, before)
