"""The page of an earlier result, made from its folder or from the files of a recorded run."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from hfb.body.model import Body
from hfb.errors import InputError
from hfb.interop.writers.export_names import CURVES, FILM_NAMES, PAGE_FILM, REPORT, RESULT
from hfb.io.atomic import write_bytes_atomic
from hfb.io.json_file import read_json
from hfb.motion.motion_file import load_motion
from hfb.report.pages.result_facts import read_facts
from hfb.tasks.core.handles import FileHandle, sha256_of
from hfb.tasks.inputs.inputs import input_file
from hfb.tasks.results.resolve_result import TEXTURE, FoundResult, find_named_body, load_fitted_body, resolve_result
from hfb.tasks.results.result_report import PAGE_FILES, ReportParts, shows_another_motion, write_page, write_page_film
from hfb.tasks.results.stored_runs import StoredRun, find_run
from hfb.tasks.results.workspace import INTERMEDIATE, beside_result, check_writable
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.store_place import check_store, tracking_uri

_FETCHED = (RESULT, CURVES, *PAGE_FILES.values(), FILM_NAMES["slowmotion"])
_HISTORY = "history.json"  # what results left before there was a curves.json
_INNER = (f"{INTERMEDIATE}/{_HISTORY}", f"{INTERMEDIATE}/{PAGE_FILM}")
_LARGEST_FILM_BYTES = 16 << 20


def make_report(source: str, out: Path | None, body: Path | None = None, inputs: Path | None = None) -> dict[str, Any]:
    """Write report.html of a result.

    Args:
        source: a result's folder, or a recorded run's id.
        out: folder of the page; None for the result's own.
        body: the model that was fitted; None for the one that the result names, or the embedded one.
        inputs: where to look for images that were moved, for the film; they are recognised by their content.

    Returns:
        ``report`` (its path), ``bytes``, and whether it has a ``film`` and the body's ``surface``.

    Raises:
        InputError: there is no such result, it is damaged, or the page cannot be written.
    """
    with resolve_result(source, _FETCHED, _INNER) as place, tempfile.TemporaryDirectory() as made:
        run = place.fetched or _run_of(place.folder)
        folder = out or place.new_folder("report", place.folder)
        check_writable(folder)
        told = place.files / RESULT
        facts = read_facts(told) if told.exists() else {}
        motion, space = load_motion(place.motion)
        model = model_or_none(motion, space, body or find_named_body(place.files / RESULT))
        film = _film(place, run, model, inputs=inputs, made=Path(made))
        parts = _parts(place, film, Path(made)).in_folder(folder)
        tags = run.tags if run else {}
        versions = {
            name: value for name, value in tags.items() if name.startswith(("version.", "platform", "processor"))
        }
        if run is not None:
            facts = {**facts, "mlflow_run_id": run.run_id, "mlflow_link": run.link}
        with progress.step("report"), beside_result(folder, [REPORT]) as target:
            write_page(parts, model, facts, versions, path=target / REPORT, name=folder.resolve().name)
    path = (folder / REPORT).resolve()
    return {"report": str(path), "bytes": path.stat().st_size, "film": film is not None, "surface": model is not None}


def _run_of(folder: Path) -> StoredRun | None:
    """Return the folder's run, if it was recorded and the store is available; the page does not depend on it."""
    try:
        check_store(tracking_uri())
        return find_run(str(folder))
    except (InputError, tracking.StoreLost):
        return None


def model_or_none(motion: Any, space: str, path: Path | None) -> Body | None:
    """Load the body that was fitted; None, with a line for the user, where it is missing: a skeleton is shown.

    Args:
        motion: of the result.
        space: of its betas.
        path: a SMPL file; None for the embedded body.
    """
    try:
        return load_fitted_body(motion, space, path)
    except InputError as error:
        progress.say(f"hfb: only the skeleton is shown: {error}")
        return None


def _parts(place: FoundResult, film: Path | None, made: Path) -> ReportParts:
    """Return the files that exist."""
    folder = place.files
    curves, history = folder / CURVES, folder / INTERMEDIATE / _HISTORY
    if not curves.exists():
        known = {"losses": read_json(history)} if history.is_file() else {}
        curves = made / CURVES
        write_bytes_atomic(curves, json.dumps(known).encode())
    others = {name: input_file(folder / name) for name in PAGE_FILES.values() if (folder / name).exists()}
    files = {"motion.npz": FileHandle.of(place.motion), CURVES: input_file(curves), **others}
    return ReportParts.among(files, FileHandle.of(film) if film else None)


def _film(
    place: FoundResult, run: StoredRun | None, body: Body | None, *, inputs: Path | None, made: Path
) -> Path | None:
    """Return the page's film: as drawn before, drawn again from the images, or the result's own; None without any."""
    drawn, own = place.files / INTERMEDIATE / PAGE_FILM, place.files / FILM_NAMES["slowmotion"]
    if drawn.is_file() and _fits_a_page(drawn) and not shows_another_motion(drawn, sha256_of(place.motion)):
        return drawn
    if run is not None and body is not None and (place.files / TEXTURE).is_file():
        try:
            return _redraw(place, run, body, inputs=inputs, made=made)
        except InputError as error:
            progress.say(f"hfb: no film is drawn: {error}")
    return own if own.is_file() and _fits_a_page(own) else None


def _fits_a_page(film: Path) -> bool:
    """Return whether a file is a film small enough for a page."""
    with film.open("rb") as file:
        return film.stat().st_size <= _LARGEST_FILM_BYTES and file.read(12)[4:8] == b"ftyp"


def _redraw(place: FoundResult, run: StoredRun, body: Body, *, inputs: Path | None, made: Path) -> Path:
    from hfb.tasks.results.reload_inputs import reload_shot

    motion, _ = load_motion(place.motion)
    with (
        reload_shot(run.run_id, inputs, motion=motion, body=body, texture=place.files / TEXTURE) as shot,
        progress.step("report's film"),
    ):
        return write_page_film(shot, sha256_of(place.motion), made)
