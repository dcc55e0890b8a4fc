"""What every call in Python runs in: a private folder, its progress, no server, one thread of torch."""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TypeAlias

from hfb.api.given_images import errors_of_calls
from hfb.errors import InputError
from hfb.kernels.determinism import one_torch_thread
from hfb.tasks.core.caller_parts import NO_PARTS, OwnParts, using
from hfb.tasks.inputs.inputs import Inputs
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.task import without_prefect
from hfb.tasks.telemetry import progress

Progress: TypeAlias = Callable[[str, int, int | None], object]
"""Called with a step's name, how much of it is done, and of how much (None where that is not known)."""


class _Told(progress.Display):
    """Passes the progress of steps to a function of the caller's."""

    def __init__(self, function: Progress) -> None:
        self._function = function

    def update(self, shown: progress.Shown) -> None:
        """See `Display`."""
        self._function(shown.label, shown.done, shown.total)

    begin = update


@contextmanager
def private_call(
    on_progress: Progress | None = None, *, own: OwnParts = NO_PARTS, keep: bool = False
) -> Iterator[Path]:
    """Provide a private folder; tasks run inside the block as plain functions, errors are worded for callers.

    Args:
        on_progress: is told every step.
        own: parts of the caller's own.
        keep: whether the folder stays where nothing failed.
    """
    folder, kept = Path(tempfile.mkdtemp(prefix="hfb-")).resolve(), False
    shown = progress.showing(_Told(on_progress)) if on_progress else nullcontext()
    try:
        with shown, errors_of_calls(folder), one_torch_thread(), without_prefect(), using(own):
            yield folder
        kept = keep
    finally:
        if not kept:
            shutil.rmtree(folder, ignore_errors=True)


def in_memory(inputs: Inputs | VideoInputs, folder: Path) -> tuple[str, ...]:
    """Return a sentence if some images were no files, which no later command can read.

    Args:
        inputs: of the call.
        folder: where images without a file were written.

    Raises:
        InputError: clip.toml says how files store light.
    """
    images = inputs.frames if isinstance(inputs, Inputs) else inputs.video
    if all(one is None or one.path.parent != folder for one in (*images, inputs.background)):
        return ()
    if inputs.clip.transfer != "srgb":
        raise InputError("clip.toml says how files store light, and arrays are no files: give paths, or no transfer")
    return ("its images were given in memory and not as files",)


def options_of(**given: object) -> dict[str, object]:
    """Return those that are options: neither missing nor a function.

    Args:
        **given: parameters of a call.
    """
    return {name: value for name, value in given.items() if value is not None and not callable(value)}
