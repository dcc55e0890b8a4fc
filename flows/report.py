"""The page of an earlier result, made from what it left: its folder, or the files of a recorded run."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flows.workplace import INTERMEDIATE, check_writable
from hfb.body.model import Body
from hfb.config import FitConfig
from hfb.errors import InputError
from hfb.export.motion_file import load_motion
from hfb.export.names import CURVES, FILM_NAMES, PAGE_FILM, REPORT
from hfb.media.atomic import write_bytes_atomic
from tasks import progress, tracking
from tasks.fitted_body import fitted_body, named_body
from tasks.handles import FileHandle
from tasks.result_report import ReportParts, write_page, write_page_film
from tasks.store_place import check_store, tracking_uri
from tasks.stored_runs import StoredRun, fetch_file, find_run, readable_store

_MOTION, _RESULT = "motion.npz", "result.json"
_OTHERS = {"texture": "texture.png", "strip": "strip.png", "alternatives": "alternatives.npz"}
_FETCHED = (_MOTION, _RESULT, CURVES, *_OTHERS.values(), FILM_NAMES["slowmotion"])
_HISTORY = "history.json"  # what results left before there was a curves.json
_LIMIT_BYTES = 64 << 20
_LARGEST_FILM_BYTES = 16 << 20


@dataclass(frozen=True)
class _Source:
    """A result: its folder, its run where it was recorded, and where the page goes unless something else is said."""

    folder: Path
    run: StoredRun | None
    out: Path


def make_report(source: str, out: Path | None, body: Path | None = None, inputs: Path | None = None) -> dict[str, Any]:
    """Write report.html of a result.

    Args:
        source: a result's folder, or a recorded run's id.
        out: the folder that the page goes to; the result's own when not given.
        body: the model that was fitted; when not given the one that the result names, or the embedded one.
        inputs: where the pictures lie, for the film, if they were moved; they are told by their content.

    Returns:
        ``report`` (its path), ``bytes``, and whether it has a ``film`` and the body's ``surface``.

    Raises:
        InputError: there is no such result, it is damaged, or the page cannot be written.
    """
    with _found(source) as place, tempfile.TemporaryDirectory() as made:
        folder = out or place.out
        check_writable(folder)
        facts = _facts(place.folder / _RESULT)
        motion, space = load_motion(place.folder / _MOTION)
        model = _model(motion, space, body or named_body(place.folder / _RESULT))
        film = _film(place, model, inputs, Path(made))
        parts = _parts(place.folder, film, Path(made))
        tags = place.run.tags if place.run else {}
        versions = {
            name: value for name, value in tags.items() if name.startswith(("version.", "platform", "processor"))
        }
        if place.run is not None:
            facts = {**facts, "mlflow_run_id": place.run.run_id, "mlflow_link": place.run.link}
        with progress.step("report"):
            write_page(parts, model, facts, versions, folder / REPORT)
    path = (folder / REPORT).resolve()
    return {"report": str(path), "bytes": path.stat().st_size, "film": film is not None, "surface": model is not None}


@contextmanager
def _found(source: str) -> Iterator[_Source]:
    """The result; a run's files are fetched for as long as they are needed."""
    path = Path(source)
    if path.exists():
        folder = path if path.is_dir() else path.parent
        yield _Source(folder, _run_of(folder), folder)
        return
    if path.suffix or len(path.parts) > 1:
        raise InputError(f"there is no {source}: give a result's folder, or a run's id")
    run = find_run(source)
    with tempfile.TemporaryDirectory() as fetched, readable_store():
        if fetch_file(run, _MOTION, Path(fetched)) is None:
            raise InputError(f"run {run.title} has no {_MOTION}: only results of `hfb fit` and `hfb video` have one")
        for name in _FETCHED:
            fetch_file(run, name, Path(fetched))
        yield _Source(Path(fetched), run, Path("runs") / f"report-{run.run_id[:8]}")


def _run_of(folder: Path) -> StoredRun | None:
    """The folder's run, if it was recorded and the store is there: the page can do without."""
    try:
        check_store(tracking_uri())
        return find_run(str(folder))
    except (InputError, tracking.StoreLost):
        return None


def _facts(path: Path) -> dict[str, Any]:
    """The content of result.json; nothing where there is none.

    Raises:
        InputError: it is something else.
    """
    content = _json(path) if path.is_file() else {}
    if not isinstance(content, dict):
        raise InputError(f"{path} is not a result of hfb: give the folder of one")
    return content


def _json(path: Path) -> Any:
    try:
        if path.stat().st_size > _LIMIT_BYTES:
            raise ValueError("it is too large")
        return json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}): make the result again") from None


def _model(motion: Any, space: str, path: Path | None) -> Body | None:
    """The body that was fitted; None, and a word, where it is not at hand: a skeleton is shown then."""
    try:
        return fitted_body(motion, space, path)
    except InputError as error:
        progress.say(f"hfb: only the skeleton is shown: {error}")
        return None


def _parts(folder: Path, film: Path | None, made: Path) -> ReportParts:
    """What there is."""
    curves, history = folder / CURVES, folder / INTERMEDIATE / _HISTORY
    if not curves.is_file():
        known: Mapping[str, Any] = {"losses": _json(history)} if history.is_file() else {}
        curves = made / CURVES
        write_bytes_atomic(curves, json.dumps(known).encode())
    elif not isinstance(_json(curves), dict):
        raise InputError(f"{curves} holds no curves of hfb: make the result again")
    others = {part: FileHandle.of(folder / name) for part, name in _OTHERS.items() if (folder / name).is_file()}
    return ReportParts(
        motion=FileHandle.of(folder / _MOTION), curves=FileHandle.of(curves),
        film=FileHandle.of(film) if film else None, **others,
    )  # fmt: skip


def _film(place: _Source, body: Body | None, inputs: Path | None, made: Path) -> Path | None:
    """The page's film as it was drawn, drawn again from the pictures, or the result's own; None where there is none."""
    drawn, own = place.folder / INTERMEDIATE / PAGE_FILM, place.folder / FILM_NAMES["slowmotion"]
    if drawn.is_file():
        return drawn
    if place.run is not None and body is not None and (place.folder / _OTHERS["texture"]).is_file():
        try:
            return _drawn_again(place, place.run, body, inputs, made)
        except InputError as error:
            progress.say(f"hfb: no film is drawn: {error}")
    return own if own.is_file() and own.stat().st_size <= _LARGEST_FILM_BYTES else None


def _drawn_again(place: _Source, run: StoredRun, body: Body, inputs: Path | None, made: Path) -> Path:
    from hfb.media.pictures import read_picture_srgb
    from hfb.render.rasterizer import make_rasterizer
    from hfb.report.slow_motion import Shot
    from tasks.earlier_result import pictures_of
    from tasks.scene import in_light

    config = FitConfig()  # what draws: wherever the result was computed, this machine has the default
    with pictures_of(run.run_id, inputs) as seen, progress.step("report's film"):
        shot = Shot(
            motion=load_motion(place.folder / _MOTION)[0],
            body=body,
            texture=in_light(read_picture_srgb(place.folder / _OTHERS["texture"]), "srgb", seen.light),
            rasterizer=make_rasterizer("coverage", config.rasterizer, config.threads),
            camera=seen.camera,
            plate_linear=seen.plate_linear,
            frame_linear=seen.frame_linear,
            light=seen.light,
        )
        return write_page_film(shot, made)
