"""report.html: a result's curves, its small film, and the page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hfb.config import ExportConfig, Record
from hfb.errors import InputError
from hfb.interop.writers.export_names import CURVES, LINKED_FILES, PAGE_FILM, REPORT, RESULT
from hfb.io.safe_folder import is_regular
from hfb.tasks.core.environment import environment
from hfb.tasks.core.handles import FileHandle, FitHandle
from hfb.tasks.core.video_handles import WindowHandle
from hfb.tasks.results.exports import ShotHandle, with_progress
from hfb.tasks.task import task
from hfb.tasks.telemetry import progress
from hfb.tasks.telemetry.secrets import hidden_in
from hfb.tasks.tracking import tracking

if TYPE_CHECKING:
    from hfb.body.model import Body
    from hfb.fitting.alternatives import Alternatives
    from hfb.motion.sampled import SampledMotion
    from hfb.report.films.slow_motion import Shot


_OF_MOTION = ", of the motion "
PAGE_FILES = {"texture": "texture.png", "strip": "strip.png", "alternatives": "alternatives.npz"}
"""Part of a page -> the file of a result, which not every result has."""


class ReportParts(Record):
    """The files that a result's page consists of.

    Attributes:
        beside: names of files that the page links to.
    """

    motion: FileHandle
    curves: FileHandle
    body: FileHandle | None = None
    texture: FileHandle | None = None
    strip: FileHandle | None = None
    alternatives: FileHandle | None = None
    film: FileHandle | None = None
    beside: tuple[str, ...] = ()

    @classmethod
    def among(
        cls, files: Mapping[str, FileHandle], film: FileHandle | None, body: FileHandle | None = None
    ) -> ReportParts:
        """Return the parts that lie among a result's files.

        Args:
            files: by the names under which they are published.
            film: the page's small film, if there is one.
            body: the user's body model.
        """
        others = {part: files.get(name) for part, name in PAGE_FILES.items()}
        beside = tuple(name for name in LINKED_FILES if name in (*files, RESULT))
        return cls(motion=files["motion.npz"], curves=files[CURVES], film=film, body=body, beside=beside, **others)

    def in_folder(self, folder: Path) -> ReportParts:
        """Return the parts of a page in some folder, which links to those of the result's files that lie there.

        Args:
            folder: of the page.
        """
        return self.model_copy(update={"beside": tuple(name for name in LINKED_FILES if is_regular(folder / name))})


@task("curves")
def fit_curves(fit: FitHandle, folder: Path) -> FileHandle:
    """Write curves.json of one problem; see `hfb.report.pages.result_curves`.

    Args:
        fit: with its history.
        folder: where the file goes.
    """
    return _curves(folder, {"losses": json.loads(fit.history.path.read_text())})


@task("curves", where="worker")
def clip_curves(
    windows: tuple[WindowHandle, ...], scores: dict[str, tuple[tuple[int, float], ...]], folder: Path
) -> FileHandle:
    """Write curves.json of a clip.

    Args:
        windows: of the clip.
        scores: figure -> (frame, value) of every frame that has one.
        folder: where the file goes.
    """
    from hfb.fitting.clip.windows import load_window

    found = []
    for window in windows:
        total = load_window(window.path).history.get("total", [])
        found.append({"frames": list(window.frames), "total": [float(f"{value:.5g}") for value in total]})
    return _curves(folder, {"windows": found, "frames": {name: list(pairs) for name, pairs in scores.items()}})


@contextmanager
def film_beside(shot: ShotHandle, config: ExportConfig, folder: Path) -> Iterator[Future[FileHandle | None]]:
    """Draw the page's film, where a page is wanted, beside the work inside the block; its errors are the block's.

    Args:
        shot: motion, body, plate and frames.
        config: whether a page is wanted.
        folder: where the film goes.
    """
    with ThreadPoolExecutor(1, "hfb-page-film") as beside:
        drawn = beside.submit(copy_context().run, lambda: draw_page_film(shot, folder) if config.report else None)
        yield drawn
        drawn.result()  # a run whose page has no film is not recorded as finished


@task("report's film", where="worker")
def draw_page_film(shot: ShotHandle, folder: Path) -> FileHandle:
    """Draw the small slow-motion film of the page.

    Args:
        shot: motion, body, plate and frames.
        folder: where it goes.
    """
    return FileHandle.of(write_page_film(shot.load(), shot.motion.sha256, folder))


@task("report", where="worker", cached=False)
def write_report(parts: ReportParts, facts: dict[str, Any], folder: Path) -> FileHandle:
    """Write the page.

    Args:
        parts: its files.
        facts: the content of result.json, the run's id among it.
        folder: where the page goes.
    """
    from hfb.tasks.core.scene import load_chosen_body

    path = folder / REPORT
    write_page(parts, load_chosen_body(parts.body), hidden_in(facts), environment(), path=path)
    return FileHandle.of(path)


def shows_another_motion(film: Path, motion_sha256: str) -> bool:
    """Return whether the page's film was drawn of another motion; films of older versions do not say, and are accepted.

    Args:
        film: the film.
        motion_sha256: of the motion file.
    """
    import av

    try:
        with av.open(str(film), options={"protocol_whitelist": "file", "format_whitelist": "mov"}) as container:
            said = container.metadata.get("comment", "")
    except (OSError, av.FFmpegError):
        return True
    return _OF_MOTION in said and not said.endswith(_OF_MOTION + motion_sha256)


def write_page_film(shot: Shot, motion_sha256: str, folder: Path) -> Path:
    """Draw the page's film with progress; the film's metadata name its motion.

    Args:
        shot: motion, body, plate and frames.
        motion_sha256: of the motion file.
        folder: where it goes.
    """
    from hfb.io.media.video.video_writing import VideoWriter
    from hfb.report.films import page_film as small
    from hfb.report.films.slow_motion import FILM_FPS

    path = folder / PAGE_FILM
    comment = f"hfb, {small.page_slow_factor(shot.motion):g} times slower{_OF_MOTION}{motion_sha256}"
    with VideoWriter(path, float(FILM_FPS), comment, small=True) as writer:
        pictures = ((None, picture) for picture in small.page_pictures(shot))
        for _, picture in with_progress("", pictures, small.page_picture_count(shot.motion)):
            writer.write(picture)
    return path


def write_page(
    parts: ReportParts,
    body: Body | None,
    facts: Mapping[str, Any],
    versions: Mapping[str, str],
    *,
    path: Path,
    name: str | None = None,
) -> None:
    """Write the page atomically. Arguments and errors as in `page_text`.

    Args:
        parts: its files.
        body: the model that was fitted; None where it is not available.
        facts: the content of result.json.
        versions: of the machine that made the result.
        path: where the page goes.
        name: of the result; None for that of the page's folder.
    """
    from hfb.io.atomic import write_bytes_atomic

    write_bytes_atomic(path, page_text(parts, body, facts, versions, name=name or path.parent.name).encode())


def page_text(
    parts: ReportParts, body: Body | None, facts: Mapping[str, Any], versions: Mapping[str, str], *, name: str
) -> str:
    """Render the page.

    Args:
        parts: its files.
        body: the model that was fitted; None where it is not available.
        facts: the content of result.json.
        versions: of the machine that made the result.
        name: of the result, where the facts have none.

    Raises:
        InputError: a file is damaged or of another kind.
    """
    from hfb.io.media.images.image_io import stored_png
    from hfb.motion.motion_file import load_motion
    from hfb.report.films.page_film import page_slow_factor
    from hfb.report.pages.result_curves import read_curves
    from hfb.report.pages.result_page import ResultContents, result_page

    motion, _ = load_motion(parts.motion.path)
    slow = page_slow_factor(motion)
    pace = f"{slow:.0f} times slower" if slow >= 1.5 else "at its own pace" if slow > 0.8 else "faster than it was"
    contents = ResultContents(
        title=_title(facts, name),
        facts=facts,
        motion=motion,
        body=body,
        texture_png=stored_png(parts.texture.path) if parts.texture else None,
        strip=parts.strip.path if parts.strip else None,
        alternatives=alternatives_of(motion, parts.alternatives.path) if parts.alternatives else None,
        curves=read_curves(parts.curves.path),
        film=parts.film.path.read_bytes() if parts.film else None,
        film_caption=f"What was seen, and the body at one instant after another, {pace}.",
        environment=versions,
        repeat=_repeat(facts),
        beside=parts.beside,
    )
    return result_page(contents)


def alternatives_of(motion: SampledMotion, path: Path) -> Alternatives:
    """Load the alternatives of a motion. Raises InputError where they are another motion's.

    Args:
        motion: of the result.
        path: of its alternatives.npz.
    """
    from hfb.fitting.alternatives import load_alternatives

    found = load_alternatives(path)[0]
    if found.frame_index.tolist() != motion.frame_index.tolist():
        raise InputError(f"{path} belongs to another motion: make the result again, or move it away")
    return found


def _title(facts: Mapping[str, Any], name: str) -> str:
    out = facts.get("out")
    return f"Human from Blur: {(Path(out).name if isinstance(out, str) else '') or name}"


def _repeat(facts: Mapping[str, Any]) -> str | None:
    """Return the command that repeats the run."""
    run_id = facts.get("mlflow_run_id")
    return f"hfb rerun {shlex.quote(run_id)}" if isinstance(run_id, str) else None


def _curves(folder: Path, content: Mapping[str, Any]) -> FileHandle:
    from hfb.io.atomic import write_bytes_atomic

    path = folder / CURVES
    write_bytes_atomic(path, json.dumps(content, separators=(",", ":"), allow_nan=False).encode() + b"\n")
    return FileHandle.of(path)


def add_report(run_id: str | None, report: FileHandle) -> None:
    """Add the page to the artifacts of a recorded run; a store that is lost costs a sentence.

    It comes last since it names the run, and every repetition of the command adds it again: a command that was stopped
    between both is thus completed.

    Args:
        run_id: of the run; None where it was not recorded.
        report: the page.
    """
    if run_id is None:
        return
    try:
        with tracking.store_losses():
            tracking.log_files(tracking.open_run(run_id), [report.path])
    except tracking.StoreLost as lost:
        progress.say(f"report.html is not in MLflow, in the result's folder it is: {lost}")
