"""Find an earlier result by the names that users give it: its files, and the body model that it was fitted with."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hfb.errors import InputError
from hfb.io.safe_folder import check_readable, copy_file
from hfb.tasks.core.result_folder import check_result, read_result_content

if TYPE_CHECKING:
    from hfb.body.model import Body
    from hfb.motion.sampled import SampledMotion
    from hfb.tasks.results.stored_runs import StoredRun

MOTION, TEXTURE = "motion.npz", "texture.png"


@dataclass(frozen=True)
class FoundResult:
    """A result's files; any but the motion may be missing.

    Attributes:
        folder: of the result; for a run that was named by its id, only inside the block.
        files: folder of copies of its files, which nobody else can replace; only inside the block.
        motion: the motion file, under any name if it was named itself.
        fetched: the run that they came from; None where a folder was named.
    """

    folder: Path
    files: Path
    motion: Path
    fetched: StoredRun | None

    @property
    def name(self) -> str:
        """Name of the result for titles."""
        return self.fetched.run_id[:8] if self.fetched else self.folder.resolve().name

    @property
    def run_words(self) -> str:
        """Id or folder that finds its record."""
        return self.fetched.run_id if self.fetched else str(self.folder)

    def new_folder(self, kind: str, beside: Path) -> Path:
        """Return where further files go unless a folder is given.

        Args:
            kind: beginning of the folder's name for a run named by its id.
            beside: the place for a result that is a folder.
        """
        return Path("runs") / f"{kind}-{self.name}" if self.fetched else beside


@contextmanager
def resolve_result(source: str, names: Sequence[str], inner: Sequence[str] = ()) -> Iterator[FoundResult]:
    """Provide a result inside the block: copies of its motion and the named files, of a run as MLflow has them.

    Args:
        source: a result's folder, its motion file, or a run's id.
        names: files that are read.
        inner: further files that are read where the result is a folder.

    Raises:
        InputError: there is no such folder or run, the run has no motion, or the folder holds a link or a special file
            in the place of one of these files, or an unfinished result.
    """
    path = Path(source)
    if path.exists():
        with tempfile.TemporaryDirectory() as private:
            try:
                yield _copied(path, Path(private), [*names, *inner])
            except InputError as error:  # the user knows the files of the folder
                raise type(error)(str(error).replace(private, str(_folder_of(path)))) from None
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
        yield FoundResult(folder, folder, folder / MOTION, run)


def _folder_of(path: Path) -> Path:
    return path if path.is_dir() else path.parent


def _copied(path: Path, private: Path, names: Sequence[str]) -> FoundResult:
    folder = _folder_of(path)
    wanted = [*names, *([MOTION] if path.is_dir() else [])]
    check_result(folder, wanted)
    try:
        check_readable(path)
        for name in wanted:
            with suppress(FileNotFoundError):
                copy_file(folder, *Path(name).parts, to=private)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    return FoundResult(folder, private, private / MOTION if path.is_dir() else path, None)


_SAME_BODY_M = 1e-3


def find_named_body(result: Path) -> Path | None:
    """Return the body model that result.json names; None where it names none or cannot be read.

    Args:
        result: path of result.json's sibling files, such as the motion.
    """
    try:
        named = read_result_content(result.parent)["config"]["body"]["model"]
    except (InputError, KeyError, TypeError):
        return None
    return Path(named) if isinstance(named, str) else None


def load_fitted_body(motion: SampledMotion, space: str, path: Path | None) -> Body:
    """Load the body model that a motion was fitted with.

    Args:
        motion: of the result.
        space: of the motion's betas.
        path: a SMPL file; None for the embedded body.

    Raises:
        InputError: the motion's SMPL file is not given, or a different one is.
    """
    import numpy as np
    import torch

    from hfb.body.assets import load_body
    from hfb.interop.writers.keys import rest_joints

    if path is None and space == "smpl":
        raise InputError("this motion was fitted with a SMPL file: give it with --body for formats with a surface")
    body = load_body(path)
    betas = torch.from_numpy(motion.betas).to(body.template.dtype)
    if body.betas_space != space or body.shape_count < len(motion.betas):
        raise InputError(
            f"the betas of this motion are {space}'s, and {body.name} has others: give the body that was fitted"
        )
    fitted = body.rest_joints(betas).double().numpy()
    far = float(np.abs(fitted - rest_joints(motion)).max())
    if far > _SAME_BODY_M:
        raise InputError(f"{body.name} is not the body that was fitted (joints {1000 * far:.0f} mm off): give that one")
    return body
