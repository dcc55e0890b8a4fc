"""One small fit that the tests of results share."""

from typing import Any

import pytest

import hfb
from tests.orchestration import Problem

TINY: dict[str, Any] = {
    "init": "matte",
    "stages": [{"size_px": 32, "iterations": 3}],
    "subframes": 2,
    "texture_px": 16,
    "settle": 2,
    "both_fronts": False,
    "directions": {"refits": 1, "iterations": 1, "polish": 1},
}
"""The preset `best` with few iterations on small images."""


@pytest.fixture(scope="session")
def fitted(problem: Problem) -> hfb.Result:
    return hfb.fit(problem.frame, problem.background, **TINY)
