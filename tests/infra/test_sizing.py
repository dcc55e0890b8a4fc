"""The sizing page holds what its script computes, and the script computes what its formulas say."""

import subprocess
import sys
from pathlib import Path

import pytest

from infra.sizing.table import Task, limits, load, markdown, rows

_PAGE = Path(__file__).parents[2] / "infra" / "sizing" / "README.md"


def test_the_page_is_what_the_script_says() -> None:
    assert markdown(Task(), load()) in _PAGE.read_text()


def test_amounts_follow_from_measures() -> None:
    measured = load()
    amounts = {row.what: row.amount for row in rows(Task(hours=2, fps=10, days=0.5, minutes=6), measured)}
    assert amounts["frames"] == "7.2e+04"
    assert amounts["clips (MLflow runs)"] == "20"
    half = rows(Task(), measured | {"core_s": measured["core_s"] / 2})
    whole = rows(Task(), measured)
    assert [row.what for row, other in zip(half, whole, strict=True) if row.amount != other.amount] == [
        "cores that compute",
        "their memory",
    ]
    found = limits(measured)
    assert found == sorted(found)


@pytest.mark.parametrize(("words", "says"), [(["--set", "none=3"], "there are core_s"), (["--days", "x"], "--days")])
def test_what_cannot_be(words: list[str], says: str) -> None:
    script = str(_PAGE.with_name("table.py"))
    ended = subprocess.run([sys.executable, script, *words], capture_output=True, text=True)
    assert ended.returncode == 2
    assert says in ended.stderr
