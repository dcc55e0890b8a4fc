"""SIGKILL before each step of publish, of plain files; tests/faults/test_publish_kills.py has real results."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.errors import InputError
from hfb.flows.export import export_result
from hfb.motion.motion_file import save_motion
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.core.result_folder import check_result, is_unfinished
from tests.flows.test_workspace import published
from tests.interop.writers.motions import motion_of
from tests.orchestration import is_finished

_SCRIPT = """
import sys
from pathlib import Path
from hfb.tasks.results.workspace import publish, workspace
from tests.faults.killed_publish import kill_at_each_step
out, made = Path(sys.argv[1]), {path.name: path for path in Path(sys.argv[2]).iterdir()}
with workspace(out):
    print(kill_at_each_step(lambda copy: publish(copy, made, {"out": str(copy), "number": 2}), out))
"""
_EXPORT = """
import sys
from pathlib import Path
from hfb.flows.export import export_result
from tests.faults.killed_publish import kill_at_each_step
export = lambda copy: export_result(sys.argv[2], copy, ("csv", "bvh", "trc"), ())
export(Path(sys.argv[1] + "-first"))  # libraries' caches are no step
print(kill_at_each_step(export, Path(sys.argv[1])))
"""


def contents(out: Path) -> dict[str, str]:
    """sha256 of all that a user sees but result.json."""
    shown = (path for path in out.iterdir() if path.is_file() and not path.name.startswith("."))
    return {path.name: sha256_of(path) for path in shown if path.name != "result.json"}


@pytest.mark.parametrize("before", ["nothing", "a result", "a result and the user's files", "an unfinished one"])
def test_every_moment(tmp_path: Path, before: str) -> None:
    out, made = tmp_path / "out", tmp_path / "made"
    first = {"motion.npz": "1", "texture.png": "1", "motion.bvh": "1", "matte_1.png": "1"}
    second = {"motion.npz": "2", "texture.png": "2", "overlay.mp4": "2"}
    if before != "nothing":
        published(out, first, number=1)
    mine = {"notes.txt": "mine", "matte_7.png": "mine"} if "user" in before else {}
    for folder, files in ((out, mine), (made, second)):
        folder.mkdir(exist_ok=True)
        for name, content in files.items():
            (folder / name).write_text(content)
    if before == "an unfinished one":
        note = json.loads((out / "result.json").read_text())
        (out / "result.json").write_text(json.dumps({"unfinished": "killed", **note}))
    old = contents(out)
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, str(out), str(made)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert done.returncode == 0, done.stderr
    steps = int(done.stdout)
    new = contents(Path(f"{out}-whole"))
    assert new.keys() == {*second, *mine}
    states = []
    for number in range(1, steps + 1):
        killed = Path(f"{out}-{number}")
        if is_finished(killed):
            assert contents(killed) in (old, new)
            states.append(json.loads((killed / "result.json").read_text())["number"])
            check_result(killed, ())
        else:
            states.append(0)
            if is_unfinished(killed):
                with pytest.raises(InputError, match=r"is unfinished, .*: run the same command again"):
                    check_result(killed, ())
            else:  # a first result that was not begun with
                assert before == "nothing"
                assert contents(killed) == {}
        published(killed, second, number=3)
        assert contents(killed) == new, number
        assert is_finished(killed)
        assert not (killed / "intermediate" / "publish").exists()
    assert states == sorted(states, key=[0 if states[0] == 0 else 1, 0, 2].index if states[0] else [0, 2].index)
    assert states.count(0) > 5
    assert states[-1] == 2


@pytest.mark.parametrize("place", ["a result", "a folder"])
def test_exports_are_of_one_motion(tmp_path: Path, place: str) -> None:
    out, motion = tmp_path / "out", tmp_path / "motion.npz"
    if place == "a result":
        published(out, {"strip.png": "1"})
    body = load_default_body(torch.float64)
    save_motion(motion, motion_of(body), "hfb")
    export_result(str(motion), out, ("csv", "bvh", "trc"), ())
    save_motion(motion, motion_of(body, frames=1), "hfb")
    done = subprocess.run(
        [sys.executable, "-c", _EXPORT, str(out), str(motion)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert done.returncode == 0, done.stderr
    old, new = contents(out), contents(Path(f"{out}-whole"))
    assert all(old[name] != new[name] for name in ("joints.csv", "motion.bvh", "joints.trc"))
    for number in range(1, int(done.stdout) + 1):
        found = contents(Path(f"{out}-{number}")).items()
        assert found <= old.items() or found <= new.items(), number
        export_result(str(motion), Path(f"{out}-{number}"), ("csv", "bvh", "trc"), ())
        assert contents(Path(f"{out}-{number}")) == new, number
