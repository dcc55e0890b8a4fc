"""A kill at any moment of publish: the whole old result, the whole new one, or a word that it is unfinished."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.flows.export import export_result
from hfb.flows.report import make_report
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.results.resolve_result import resolve_result
from hfb.tasks.results.stored_runs import find_run
from tests.faults.killed_publish import run
from tests.orchestration import Problem, is_finished

_SCRIPT = Path(__file__).with_name("killed_publish.py")


def contents(out: Path) -> dict[str, str]:
    """sha256 of all that a user sees but result.json."""
    shown = (path for path in out.iterdir() if path.is_file() and not path.name.startswith("."))
    return {path.name: sha256_of(path) for path in shown if path.name != "result.json"}


def is_told_unfinished(out: Path) -> bool:
    """Whether every reader says so."""
    readers = [
        lambda: resolve_result(str(out), ("texture.png", "strip.png")).__enter__(),
        lambda: find_run(str(out)),
        lambda: resolve_result(str(out / "motion.npz"), ("texture.png",)).__enter__(),
        lambda: make_report(str(out), None),
        lambda: export_result(str(out), None, ("csv",), ()),
    ]
    for reader in readers:
        with pytest.raises(InputError, match=r"is unfinished, .*: run the same command again"):
            reader()
    return not is_finished(out)


@pytest.mark.parametrize("kind", ["fit", "video"])
def test_never_a_mixture(kind: str, problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    inputs = [problem.frame, problem.background, problem.first_body]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, str(_SCRIPT), kind, str(out), *map(str, inputs)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr
    steps = int(done.stdout.split()[-1])
    old, new = contents(out), contents(Path(f"{out}-whole"))
    assert steps > 20
    assert "motion.bvh" in old.keys() - new.keys()
    assert all(old[name] != new[name] for name in ("motion.npz", "curves.json", "strip.png"))

    states = []
    for number in range(1, steps + 1):
        killed = Path(f"{out}-{number}")
        if is_finished(killed):
            states.append("old" if contents(killed) == old else "new")
            assert contents(killed) in (old, new)
            assert json.loads((killed / "result.json").read_text())["sha256"] == contents(killed)
            with resolve_result(str(killed), ("texture.png",)) as found:
                assert found.folder == killed
        else:
            states.append("unfinished")
            assert is_told_unfinished(killed)
    unfinished = states.count("unfinished")
    assert unfinished > 3
    begin = states.index("unfinished")
    assert states == ["old"] * begin + ["unfinished"] * unfinished + ["new"] * (steps - begin - unfinished)

    mended = [begin - 1, begin, begin + 1, begin + unfinished // 2, begin + unfinished - 1, steps - 1]
    for number in mended if kind == "fit" else mended[1::3]:
        run(kind, Path(f"{out}-{number + 1}"), inputs, new=True)
        assert is_finished(Path(f"{out}-{number + 1}"))
        assert contents(Path(f"{out}-{number + 1}")) == new, number
        assert not (Path(f"{out}-{number + 1}") / "intermediate" / "publish").exists()
