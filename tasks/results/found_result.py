"""The files of an earlier result, named as users name it: its folder, its motion file, or the id of its run."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hfb.errors import InputError
from hfb.io.safe_folder import check_readable
from hfb.tasks.core.result_folder import check_result

if TYPE_CHECKING:
    from hfb.tasks.results.stored_runs import StoredRun

MOTION, TEXTURE = "motion.npz", "texture.png"


@dataclass(frozen=True)
class FoundResult:
    """A result's files, which may be missing but for the motion.

    Attributes:
        folder: where they lie; for a run that was named by its id, only for as long as they are needed.
        motion: the motion file, in a folder under any name if it was named itself.
        fetched: the run that they came from; None where a folder was named.
    """

    folder: Path
    motion: Path
    fetched: StoredRun | None

    @property
    def name(self) -> str:
        """What to call it."""
        return self.fetched.run_id[:8] if self.fetched else self.folder.resolve().name

    @property
    def run_words(self) -> str:
        """What finds its record."""
        return self.fetched.run_id if self.fetched else str(self.folder)

    def new_folder(self, kind: str, beside: Path) -> Path:
        """Where something made of it goes unless a folder is given: ``beside``, if it is a folder."""
        return Path("runs") / f"{kind}-{self.name}" if self.fetched else beside


@contextmanager
def found_result(source: str, names: Sequence[str], inner: Sequence[str] = ()) -> Iterator[FoundResult]:
    """The result; of a run those of its files are fetched that are named here, and its motion.

    Args:
        inner: further files that are read where the result is a folder.

    Raises:
        InputError: there is no such folder or run, the run has no motion, or the folder holds a link or a special file
            in the place of one of these files, or an unfinished result.
    """
    path = Path(source)
    if path.exists():
        folder = path if path.is_dir() else path.parent
        check_result(folder, [*names, *inner, *([MOTION] if path.is_dir() else [])])
        try:
            check_readable(path)
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror}") from None
        yield FoundResult(folder, path / MOTION if path.is_dir() else path, None)
        return
    if path.suffix or len(path.parts) > 1:
        raise InputError(f"there is no {source}: give a result's folder, its {MOTION}, or a run's id")
    from hfb.tasks.results.stored_runs import fetch_file, find_run, readable_store

    run = find_run(source)
    with tempfile.TemporaryDirectory() as fetched, readable_store():
        folder = Path(fetched)
        if fetch_file(run, MOTION, folder) is None:
            raise InputError(f"run {run.title} has no {MOTION}: only results of `hfb fit` and `hfb video` have one")
        for name in names:
            fetch_file(run, name, folder)
        yield FoundResult(folder, folder / MOTION, run)
