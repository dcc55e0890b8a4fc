"""Two recorded runs beside each other: a page, a picture of both, and the numbers."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flows.repeating import number_text
from flows.workplace import check_writable
from hfb.errors import InputError
from hfb.evaluate.motion_difference import MotionDifference, motion_difference
from hfb.export.motion_file import load_motion
from hfb.media.atomic import write_bytes_atomic
from hfb.media.pictures import read_picture_srgb
from hfb.motion.sampled import SampledMotion
from hfb.report.run_page import PageTable, run_page
from hfb.report.two_motions import draw_motions, png_bytes, stack_pictures
from tasks import progress
from tasks.run_comparison import Pair, RunComparison, compare_records
from tasks.stored_runs import StoredRun, fetch_file, find_run, readable_store

_PICTURES = ("strip.png", "sheet.png", "gallery.png")
_MOTION = "motion.npz"
PAGE, PICTURE, FIGURES = "comparison.html", "comparison.png", "comparison.json"


def compare_runs(words: tuple[str, str], out: Path | None) -> dict[str, Any]:
    """Compare two runs; leaves comparison.html, comparison.png and comparison.json.

    Args:
        words: of each run its id, the beginning of it, or its result's folder.
        out: a folder; one under runs/ when not given.

    Returns:
        the content of comparison.json.

    Raises:
        InputError: a run is not there, or the folder cannot be written.
    """
    with progress.step("records"):
        one, other = (find_run(word) for word in words)
        comparison = compare_records(one, other)
    folder = out or Path("runs") / f"compare-{one.run_id[:8]}-{other.run_id[:8]}"
    check_writable(folder)
    with progress.step("pictures"), tempfile.TemporaryDirectory() as fetched, readable_store():
        places = [Path(fetched) / side for side in ("one", "other")]
        motions = [_motion(run, place) for run, place in zip((one, other), places, strict=True)]
        strips = [_picture(run, place) for run, place in zip((one, other), places, strict=True)]
    difference = motion_difference(motions[0], motions[1]) if motions[0] and motions[1] else None
    picture = _drawn(comparison, strips, motions, difference)
    result = _result(comparison, difference, folder, picture is not None)
    page = run_page(
        (one.title, other.title), sentence(difference), _tables(comparison), picture, "both, each as it was recorded"
    )
    if picture is not None:
        write_bytes_atomic(folder / PICTURE, picture)
    else:
        (folder / PICTURE).unlink(missing_ok=True)
    write_bytes_atomic(folder / PAGE, page.encode())
    write_bytes_atomic(folder / FIGURES, json.dumps(result, indent=2, allow_nan=False).encode() + b"\n")
    return result


def sentence(difference: MotionDifference | None) -> str:
    """How far the motions are from each other, in words."""
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


def _motion(run: StoredRun, folder: Path) -> SampledMotion | None:
    path = fetch_file(run, _MOTION, folder)
    return load_motion(path)[0] if path else None


def _picture(run: StoredRun, folder: Path) -> Any:
    """The run's own picture of what it found."""
    for name in _PICTURES:
        path = fetch_file(run, name, folder)
        if path is not None:
            try:
                return read_picture_srgb(path)
            except InputError as error:  # one that cannot be shown does not keep the numbers back
                progress.say(f"no picture of run {run.title}: {error}")
    return None


def _drawn(
    comparison: RunComparison,
    strips: Sequence[Any],
    motions: Sequence[SampledMotion | None],
    difference: MotionDifference | None,
) -> bytes | None:
    one, other = comparison.one, comparison.other
    shown = [(run.title, strip) for run, strip in zip((one, other), strips, strict=True) if strip is not None]
    if difference is not None and difference.mean_mm is not None and motions[0] and motions[1]:
        shown.append(("both skeletons", draw_motions(motions[0], motions[1], difference, (one.title, other.title))))
    return png_bytes(stack_pictures(shown)) if shown else None


def _tables(comparison: RunComparison) -> list[PageTable]:
    one, other = comparison.one, comparison.other
    facts = [
        ("run", one.run_id, other.run_id), ("made", f"{one.started} UTC", f"{other.started} UTC"),
        ("state", one.status, other.status), ("MLflow", one.link, other.link),
    ]  # fmt: skip
    metrics = tuple(
        (pair.name, number_text(pair.one), number_text(pair.other), number_text(pair.difference))
        for pair in comparison.metrics
    )
    return [
        PageTable("runs", tuple((*row, "") for row in facts)),
        PageTable("options that differ", _rows(comparison.config), f"all {comparison.same_options} are the same"),
        PageTable("machine and versions that differ", _rows(comparison.environment), "none"),
        PageTable("figures", metrics, "none were recorded"),
    ]


def _rows(pairs: Sequence[Pair]) -> tuple[tuple[str, str, str, str], ...]:
    return tuple((name, "-" if one is None else one, "-" if other is None else other, "") for name, one, other in pairs)


def _result(
    comparison: RunComparison, difference: MotionDifference | None, folder: Path, has_picture: bool
) -> dict[str, Any]:
    motion = difference and {
        "bit_equal": difference.bit_equal, "mean_mm": difference.mean_mm, "max_mm": difference.max_mm,
    }  # fmt: skip
    place = folder.resolve()
    return {
        "run_a": comparison.one.run_id, "run_b": comparison.other.run_id,
        "names": [comparison.one.title, comparison.other.title],
        "config": _plain(comparison.config), "same_options": comparison.same_options,
        "environment": _plain(comparison.environment), "metrics": _plain(comparison.metrics),
        "motion": motion, "sentence": sentence(difference), "out": str(place),
        "page": str(place / PAGE), "picture": str(place / PICTURE) if has_picture else None,
    }  # fmt: skip


def _plain(pairs: Sequence[Any]) -> list[dict[str, Any]]:
    return [{"name": pair.name, "a": pair.one, "b": pair.other} for pair in pairs]
