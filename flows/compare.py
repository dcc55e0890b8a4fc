"""Compare recorded runs: a page with one time slider for all of them, an image, and the numbers."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from hfb.errors import InputError
from hfb.evaluation.motion_difference import MotionDifference, motion_difference
from hfb.flows.runtime.summary import number_text
from hfb.io.media.images.image_io import read_picture_srgb, stored_png
from hfb.io.safe_folder import check_ordinary, read_file
from hfb.motion.motion_file import load_motion
from hfb.motion.sampled import SampledMotion
from hfb.report.images.several_motions import draw_motions, png_bytes, stack_pictures
from hfb.report.pages.page import small_picture
from hfb.report.pages.run_page import PageTable, RunLook, run_page
from hfb.report.pages.viewer import ViewedMotion, viewer, viewer_scripts
from hfb.tasks.inputs.out_place import check_no_clip
from hfb.tasks.results.own_files import put_together
from hfb.tasks.results.resolve_result import find_named_body, load_fitted_body
from hfb.tasks.results.run_comparison import Numbers, RunComparison, Words, compare_records
from hfb.tasks.results.stored_runs import StoredRun, fetch_file, find_run, readable_store
from hfb.tasks.results.workspace import check_writable
from hfb.tasks.telemetry import progress

_PICTURES = ("strip.png", "sheet.png", "gallery.png")
_MOTION, _TEXTURE, _RESULT = "motion.npz", "texture.png", "result.json"
_GROUP = "runs"
_PICTURE_PX = 2400
_FIGURES_LIMIT = 64 << 20
PAGE, PICTURE, FIGURES = "comparison.html", "comparison.png", "comparison.json"


@dataclass(frozen=True)
class _Shown:
    """Motion, image and viewer of a run."""

    run: StoredRun
    motion: SampledMotion | None
    strip: Any
    turning: Markup | None


def compare_runs(words: Sequence[str], out: Path | None) -> dict[str, Any]:
    """Compare two runs or more; writes comparison.html, comparison.png and comparison.json.

    Args:
        words: of each run its id, the beginning of it, or its result's folder.
        out: a folder; None for one under runs/.

    Returns:
        the content of comparison.json.

    Raises:
        InputError: a run is not there, or the folder cannot be written.
    """
    with progress.step("records"):
        comparison = compare_records([find_run(word) for word in words])
    folder = out or Path("runs") / "-".join(["compare", *(run.run_id[:8] for run in comparison.runs)])
    check_writable(folder)
    check_no_clip(folder)
    _check_room(folder)
    shown = []
    with progress.step("pictures"), tempfile.TemporaryDirectory() as fetched, readable_store():
        for number, run in enumerate(comparison.runs):
            progress.advance(number, len(comparison.runs))
            shown.append(_seen(run, Path(fetched) / str(number)))
    with progress.step("page"):
        differences = _differences([one.motion for one in shown])
        overlay = _overlay(shown, differences)
        strips = [(one.run.title, one.strip) for one in shown if one.strip is not None]
        sheet = png_bytes(stack_pictures([*strips, *([("skeletons", overlay)] if overlay is not None else [])]))
        has_picture = bool(strips) or overlay is not None
        result = _result(comparison, differences, folder, has_picture)
        page = _page(comparison, shown, overlay, result)
    _publish(folder, page, sheet if has_picture else None, result)
    return result


def sentence(difference: MotionDifference | None) -> str:
    """Return a sentence on the distance of two motions.

    Args:
        difference: of the motions; None where one is missing.
    """
    if difference is None:
        return "At least one of them has no motion: there is none to compare."
    if difference.bit_equal:
        return "Their motions are bit-equal."
    if difference.mean_mm is None:
        return "Their motions share no frame."
    return (
        f"Their joints are {number_text(difference.mean_mm)} mm apart on average, "
        f"{number_text(difference.max_mm)} mm at most, in camera coordinates."
    )


def _seen(run: StoredRun, folder: Path) -> _Shown:
    path = fetch_file(run, _MOTION, folder)
    if path is None:
        return _Shown(run, None, _picture(run, folder), None)
    motion, space = load_motion(path)
    texture, result = fetch_file(run, _TEXTURE, folder), fetch_file(run, _RESULT, folder)
    try:
        body = load_fitted_body(motion, space, find_named_body(result) if result else None)
    except InputError as error:  # a licensed file that is not here: the skeleton needs none
        progress.say(f"run {run.title} is shown as a skeleton: {error}")
        body = None
    turning = viewer(
        [ViewedMotion(run.title, motion)], body, stored_png(texture) if texture and body else None, run.title, _GROUP
    )
    return _Shown(run, motion, _picture(run, folder), turning)


def _picture(run: StoredRun, folder: Path) -> Any:
    """Return the run's own image of its result."""
    for name in _PICTURES:
        path = fetch_file(run, name, folder)
        if path is not None:
            try:
                return read_picture_srgb(path)
            except InputError as error:  # one that cannot be shown does not keep the numbers back
                progress.say(f"no picture of run {run.title}: {error}")
    return None


def _differences(motions: Sequence[SampledMotion | None]) -> list[MotionDifference | None]:
    """Return the difference of every motion but the first from the first."""
    first, *others = motions
    return [motion_difference(first, other) if first and other else None for other in others]


def _overlay(shown: Sequence[_Shown], differences: Sequence[MotionDifference | None]) -> Any:
    """Draw all skeletons that share a frame with the first; None where there are none."""
    pairs = [(one, far) for one, far in zip(shown[1:], differences, strict=True) if far and far.mean_mm is not None]
    if not pairs:
        return None
    named = [(one.run.title, one.motion) for one in (shown[0], *(one for one, _ in pairs)) if one.motion is not None]
    return draw_motions(named, [far for _, far in pairs])


def _page(comparison: RunComparison, shown: Sequence[_Shown], overlay: Any, result: dict[str, Any]) -> str:
    looks = [
        RunLook(one.run.title, one.turning, small_picture(one.strip, _PICTURE_PX) if one.strip is not None else None)
        for one in shown
    ]
    drawn = png_bytes(overlay) if overlay is not None else None
    return run_page(result["sentences"], _tables(comparison), looks, drawn, viewer_scripts())


def _tables(comparison: RunComparison) -> list[PageTable]:
    runs = comparison.runs
    facts = (
        ("run", *(run.run_id for run in runs)),
        ("made", *(f"{run.started} UTC" for run in runs)),
        ("state", *(run.status for run in runs)),
        ("MLflow", *(run.link for run in runs)),
    )
    metrics = []
    for name, values in comparison.metrics:
        one, other = values[:2]
        apart = [number_text(other - one) if one is not None and other is not None else "-"] if len(runs) == 2 else []
        metrics.append((name, *(number_text(value) for value in values), *apart))
    return [
        PageTable("Options that differ", _rows(comparison.config), f"all {comparison.same_options} are the same"),
        PageTable("Figures", tuple(metrics), "none were recorded"),
        PageTable("Machine and versions that differ", _rows(comparison.environment), "none"),
        PageTable("Runs", facts),
    ]


def _rows(every: Sequence[Words]) -> tuple[tuple[str, ...], ...]:
    return tuple((name, *("-" if value is None else value for value in values)) for name, values in every)


def _result(
    comparison: RunComparison, differences: Sequence[MotionDifference | None], folder: Path, has_picture: bool
) -> dict[str, Any]:
    """Return comparison.json: ``a`` and ``b`` are the first two runs, ``more`` the others."""
    place, runs = folder.resolve(), comparison.runs
    motions = [
        far and {"bit_equal": far.bit_equal, "mean_mm": far.mean_mm, "max_mm": far.max_mm} for far in differences
    ]
    sentences = [sentence(far) for far in differences]
    if len(runs) > 2:
        pairs = zip(runs[1:], sentences, strict=True)
        sentences = [f"{run.title} against {runs[0].title}: {words[0].lower()}{words[1:]}" for run, words in pairs]
    return {
        "run_a": runs[0].run_id,
        "run_b": runs[1].run_id,
        "runs": [run.run_id for run in runs],
        "names": [run.title for run in runs],
        "config": _plain(comparison.config),
        "same_options": comparison.same_options,
        "environment": _plain(comparison.environment),
        "metrics": _plain(comparison.metrics),
        "motion": motions[0],
        "motions": motions,
        "sentence": sentences[0],
        "sentences": sentences,
        "out": str(place),
        "page": str(place / PAGE),
        "picture": str(place / PICTURE) if has_picture else None,
    }


def _plain(every: Sequence[Words] | Sequence[Numbers]) -> list[dict[str, Any]]:
    return [
        {"name": name, "a": values[0], "b": values[1], **({"more": list(values[2:])} if len(values) > 2 else {})}
        for name, values in every
    ]


def _check_room(folder: Path) -> None:
    """Raise InputError if foreign files or an input would be replaced."""
    for name in (FIGURES, PAGE, PICTURE):
        check_ordinary(folder, name)
    try:
        ours = "run_a" in json.loads(read_file(folder, FIGURES, limit=_FIGURES_LIMIT))
    except (OSError, ValueError, TypeError, RecursionError):
        ours = False
    there = [name for name in (FIGURES, PAGE, PICTURE) if (folder / name).exists()]
    if there and not ours:
        raise InputError(
            f"{folder} holds {', '.join(there)}, which `hfb compare` did not put there: move it away, or choose "
            "another --out"
        )


def _publish(folder: Path, page: str, picture: bytes | None, result: dict[str, Any]) -> None:
    figures = json.dumps(result, indent=2, allow_nan=False).encode() + b"\n"
    if picture is None:
        (folder / PICTURE).unlink(missing_ok=True)
    put_together(folder, {FIGURES: figures, PAGE: page.encode(), **({PICTURE: picture} if picture else {})})
