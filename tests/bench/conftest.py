"""`make bench` measures and writes bench.json; an ordinary test run only sees that each benchmark works."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from tests.bench.figures import Figures

_FIGURES = pytest.StashKey[Figures]()
_MODE = os.environ.get("HFB_BENCH", "")


@dataclass(frozen=True)
class Scale:
    """How much is measured.

    Attributes:
        measures: figures are written; otherwise everything is as small as can be.
        rounds: of what takes milliseconds. fits: of whole fits. clip_frames: of the video.
    """

    measures: bool
    rounds: int
    fits: int
    clip_frames: int


_SCALES = {"": Scale(False, 1, 1, 0), "quick": Scale(True, 10, 1, 2), "full": Scale(True, 60, 5, 100)}


def pytest_configure(config: pytest.Config) -> None:
    if _MODE not in _SCALES:
        raise pytest.UsageError(f"HFB_BENCH={_MODE} is neither quick nor full")
    config.stash[_FIGURES] = Figures()
    load = os.getloadavg()[0]
    if load > 0.5 * (os.cpu_count() or 1):
        config.stash[_FIGURES].say(f"THE MACHINE WAS BUSY when this began (load {load:.1f}): times are too long")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """QUICK=1 is for the figures of bench.json; the table of parts takes seconds for each of its rows."""
    for item in items:
        if _MODE == "quick" and "benchmark" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.skip(reason="make bench without QUICK=1"))


@pytest.fixture(scope="session")
def scale() -> Scale:
    return _SCALES[_MODE]


@pytest.fixture
def thorough(scale: Scale) -> None:
    """For what QUICK=1 has no time for."""
    if scale.measures and scale.fits < 2:
        pytest.skip("make bench without QUICK=1")


@pytest.fixture
def figures(pytestconfig: pytest.Config) -> Figures:
    return pytestconfig.stash[_FIGURES]


@pytest.fixture(autouse=True)
def one_torch_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    found = config.stash[_FIGURES]
    if _SCALES[_MODE].measures and found.lines:
        terminalreporter.section(f"bench ({_MODE}; ratios are of the best rounds, taken in turn)")
        for line in found.lines:
            terminalreporter.write_line(line)
        found.write(Path("bench.json"))
        terminalreporter.write_line("written: bench.json")
