"""Fixtures of the command line tests: a place of their own on the session's one server."""

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
