"""The files that one frame passes from the command line to motion.npz, in the order in which they are entered.

    python -m tests.architecture.walk

Runs a tiny `hfb fit` with the chain's tasks in this process and notes every file of ours whose functions are called.
"""

import sys
import tempfile
import threading
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[2]
_OURS = str(ROOT / "hfb") + "/"
_SURROUNDINGS = ("telemetry", "tracking/", "runtime", "errors.py", "typing.py", "config.py", "__init__.py")
"""What accompanies a frame without touching it: progress, records, servers, option records."""


class Walk:
    """Notes the files of called functions; a profile function for `sys.setprofile`."""

    def __init__(self) -> None:
        self.files: list[str] = []
        self.entries = 0
        self._last: dict[int, str] = {}
        self._known: dict[str, str | None] = {}

    def __call__(self, frame: FrameType, event: str, _argument: object) -> None:
        """Note one call."""
        if event != "call" or frame.f_code.co_name == "<module>":
            return
        name = frame.f_code.co_filename
        if name not in self._known:
            self._known[name] = name.removeprefix(_OURS) if name.startswith(_OURS) else None
        file = self._known[name]
        if file is None:
            return
        if file not in self.files:
            self.files.append(file)
        thread = threading.get_ident()
        self.entries += self._last.get(thread) != file
        self._last[thread] = file

    def passed(self) -> list[str]:
        """Return the files outside kernels and outside what only accompanies a frame."""
        own = [file for file in self.files if "/kernels/" not in file]
        return [file for file in own if not any(one in file for one in _SURROUNDINGS)]


def walk_of_a_fit() -> Walk:
    """Return the walk of a tiny fit of the embedded example."""
    from hfb.flows.cli.cli import main
    from tests.orchestration import TINY_OPTIONS, tiny_problem

    walk = Walk()
    with tempfile.TemporaryDirectory() as folder:
        problem = tiny_problem(Path(folder) / "problem")
        words = ["fit", str(problem.frame), "--background", str(problem.background), "--out", f"{folder}/out"]
        threading.setprofile(walk)
        sys.setprofile(walk)
        try:
            code = main([*words, "--quiet", *TINY_OPTIONS])
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
    if code:
        raise SystemExit(code)
    return walk


if __name__ == "__main__":
    found = walk_of_a_fit()
    print("\n".join(found.passed()))
    print(f"{len(found.passed())} files on the way, {len(found.files)} called in all, entered {found.entries} times")
