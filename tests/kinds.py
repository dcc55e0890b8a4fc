"""The kinds of tests: what a test needs decides its marker, and the order in which files begin.

A test's folder says its kind. A test elsewhere that asks for a server (`store`) or is marked as `integration`, because
it starts a process, is no unit test either; `make test-unit` fails one that starts a process without saying so.
"""

import sys
from collections.abc import Iterator
from pathlib import PurePath
from typing import Any

import pytest

KINDS = {
    "team": "PostgreSQL, nginx, Prefect, MLflow and a store, as infra/compose has them",
    "faults": "processes that are killed and services that are taken away",
    "integration": "a Prefect server, MLflow's database, or processes of their own",
    "bench": "timings, which only `make bench` measures",
    "unit": "neither a server nor a process; everything else",
}
"""In the order in which they begin: what takes long and cannot be divided comes first."""

_FOLDERS = {
    "bench": "bench",
    "cli": "integration",
    "docs": "integration",
    "faults": "faults",
    "flows": "integration",
    "fuzz": "integration",
    "infra": "integration",
}
_FIXTURES = {"here": "team", "store": "integration"}
_PROCESSES = {"os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.system", "subprocess.Popen"}
_OF_LIBRARIES = {"fc-list", "uname"}  # Matplotlib asks the one once per machine, `platform` the other once per process
_FIRST = "test_compilation.py"  # compiles all kernels, where nobody has yet, for the tests after it
_LAST = "test_logins.py"  # after its guesses the services look at no new login for a while
_started: list[str] = []


def kind_of(path: PurePath, fixtures: tuple[str, ...], marks: set[str]) -> str:
    """The one marker of a test.

    Args:
        path: its file, below tests/.
        fixtures: all that it asks for, directly or not.
        marks: the markers that it has already.
    """
    found = {kind for fixture, kind in _FIXTURES.items() if fixture in fixtures} | (marks & KINDS.keys())
    if path.parts[0] in _FOLDERS:
        found.add(_FOLDERS[path.parts[0]])
    return next((kind for kind in KINDS if kind in found), "unit")


def mark(items: list[pytest.Item], folder: PurePath) -> None:
    """Give each test its kind, and bring the files into the order of kinds."""
    first: dict[PurePath, int] = {}
    order = list(KINDS)
    for item in items:
        if folder not in item.path.parents:
            continue
        marks = {one.name for one in item.iter_markers()}
        kind = kind_of(item.path.relative_to(folder), tuple(getattr(item, "fixturenames", ())), marks)
        if kind not in marks:
            item.add_marker(kind)
        first[item.path] = min(order.index(kind), first.get(item.path, len(order)))

    def place(item: pytest.Item) -> tuple[int, bool]:
        name = item.path.name
        return -1 if name == _FIRST else first.get(item.path, len(order)), name == _LAST

    items.sort(key=place)


def shared_by(nodeid: str) -> str:
    """What a test shares with others, for which they run in one process: its file, or the services of a team."""
    file = nodeid.partition("::")[0]
    return "team" if file.startswith("tests/infra/") else file


def scheduling(config: pytest.Config, log: Any) -> Any:
    """Of xdist: tests that share something in one process, in the order of `mark`."""
    from xdist.scheduler import LoadScopeScheduling

    class BySharing(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return shared_by(nodeid)

    config.option.loadscopereorder = False
    return BySharing(config, log)


def _note(event: str, given: tuple[Any, ...]) -> None:
    if event in _PROCESSES and not _OF_LIBRARIES.intersection(given[:1]):
        _started.append(f"{event} {given[:2]}")


sys.addaudithook(_note)


def alone(item: pytest.Item) -> Iterator[None]:
    """Around a test's call: where unit tests alone are run, fails one that started a process.

    In a whole run a library's own process, of which a machine without its caches has more, is no failure.
    """
    _started.clear()
    yield
    if _started and item.config.option.markexpr == "unit":
        pytest.fail(f"a unit test started a process, so mark it as integration: {_started[0]}", pytrace=False)
