"""A command's publish, killed before each of its steps in a process of its own: run as a script by its test.

    python killed_publish.py fit|video OUT [FRAME PLATE FIRST_BODY]

leaves an earlier result in OUT, the whole new one in OUT-whole, and in OUT-1, OUT-2 ... what a kill before each step
leaves; prints how many steps there are.
"""

import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_STEPS = ("replace", "rename", "unlink", "remove", "rmdir", "mkdir")


def run(kind: str, out: Path, inputs: list[Path], new: bool) -> dict[str, Any]:
    """The command, with options that leave other files the second time."""
    films, formats = ((), ("csv",)) if new else ((), ("bvh", "trc"))
    if kind == "video":
        from tests.small_clips import run_clip, small_clip

        more = ("--fit.subframes", "4" if new else "3", "--export.formats", ",".join(formats))
        return run_clip(small_clip(1).truth.parent, out, *more, workers=1)
    from hfb.config import ExportConfig, FitConfig, InitConfig, RunConfig, Stage
    from hfb.flows.fit_image import fit_image

    fit = FitConfig(subframes=3 if new else 2, texture_px=16, stages=(Stage(size_px=32, iterations=2),))
    export = ExportConfig(films=films, report=False, formats=formats)
    config = RunConfig(init=InitConfig(method="matte"), fit=fit, export=export)
    return fit_image([inputs[0]], inputs[1], out, config, first_bodies=[inputs[2]])


@contextmanager
def before_each_step(told: Callable[[int], None]) -> Iterator[list[int]]:
    """Call ``told`` with the number of every change to a folder, just before it is made."""
    count, real = [0], {name: getattr(os, name) for name in _STEPS}

    def wrapped(name: str) -> Callable[..., Any]:
        def step(*given: Any, **named: Any) -> Any:
            count[0] += 1
            told(count[0])
            return real[name](*given, **named)

        return step

    for name in _STEPS:
        setattr(os, name, wrapped(name))
    try:
        yield count
    finally:
        for name, function in real.items():
            setattr(os, name, function)


def kill_at_each_step(change: Callable[[Path], Any], out: Path) -> int:
    """Change copies of a folder; the first is left to end."""

    def kill(number: int, at: int) -> None:
        if number == at:
            os.kill(os.getpid(), signal.SIGKILL)

    shutil.copytree(out, f"{out}-whole")
    with before_each_step(lambda _: None) as count:
        change(Path(f"{out}-whole"))
    for at in range(1, count[0] + 1):
        shutil.copytree(out, f"{out}-{at}")
        process = os.fork()
        if process == 0:
            with before_each_step(lambda number, at=at: kill(number, at)):
                change(Path(f"{out}-{at}"))
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == -signal.SIGKILL
    return count[0]


def main(kind: str, out: Path, inputs: list[Path]) -> None:
    """Make both results, the second one published as `kill_at_each_step` says."""
    run(kind, out, inputs, new=False)
    module = sys.modules["hfb.flows.video" if kind == "video" else "hfb.flows.fit_image"]
    publish = module.publish
    counted = []

    def killed(out: Path, files: Mapping[str, Path], result: dict[str, Any]) -> None:
        counted.append(kill_at_each_step(lambda copy: publish(copy, files, dict(result)), out))

    module.publish = killed  # type: ignore[attr-defined]
    run(kind, out, inputs, new=True)
    print(f"steps {counted[0]}")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), [Path(word) for word in sys.argv[3:]])
