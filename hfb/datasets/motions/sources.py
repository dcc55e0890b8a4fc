"""Sources of motions: a folder of recordings, or the built-in ones."""

from collections.abc import Callable
from pathlib import Path

from hfb.datasets.motions.built_in.procedural import ProceduralMotions
from hfb.datasets.motions.folder import FolderMotions
from hfb.datasets.motions.motion_clip import MotionSource
from hfb.errors import InputError


def open_motions(folder: Path | None, seed: int) -> MotionSource:
    """Return the motions of a folder, or for None built-in ones from the seed.

    Args:
        folder: a folder of recordings, or None.
        seed: seed of the built-in motions.

    Raises:
        InputError: no such folder, or no motion in it.
    """
    return ProceduralMotions(seed) if folder is None else FolderMotions(folder)


def usable(
    source: MotionSource, on_progress: Callable[[int, int], None] | None = None
) -> tuple[list[int], dict[str, str]]:
    """Load each motion once; return the numbers of those that load, and the others' reasons by name.

    Args:
        source: source of the motions.
        on_progress: called with (motions looked at, motions in all) after each.
    """
    good, bad = [], {}
    names = source.names()
    for index, name in enumerate(names):
        try:
            source.load(index)
            good.append(index)
        except InputError as error:
            bad[name] = str(error)
        if on_progress is not None:
            on_progress(index + 1, len(names))
    return good, bad
