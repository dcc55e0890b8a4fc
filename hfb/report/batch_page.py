"""A batch of clips as pages of a hundred clips: what became of each, a picture of it, and where its own page is."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from hfb.io.media.images.image_io import read_picture_srgb
from hfb.report.page import Html, element, joined, page, picture, section, small_picture, table

CLIPS_PER_PAGE = 100
_THUMBNAIL_PX = (480, 110)  # the largest width and height
_MOST_TROUBLES = 50
_LONGEST_REASON = 600
_MOST_WARNINGS = 10
_CLASSES = {"done": "good", "set aside": "bad"}
_FIGURES = (
    ("frames", "frames", "d"), ("sub-frames", "sub_frames", "d"), ("gaps", "gaps", ""), ("IoU", "matte_iou", ".3f"),
    ("PSNR [dB]", "psnr_db", ".1f"), ("MPJPE [mm]", "mpjpe_mm", ".1f"), ("seconds", "seconds", ".0f"),
)  # fmt: skip
_MOST_GAPS = 20


@dataclass(frozen=True)
class BatchClip:
    """What became of one clip.

    Attributes:
        status: ``done``, ``set aside`` or anything else that says what it waits for.
        reason: of a clip that is not done.
        figures: the content of its result.json, as far as there is one (`hfb.report.result_facts`).
        thumbnail: the file of its small picture (`strip_thumbnail`).
        report: its own page, from the folder of this one. link: its page in MLflow.
        people: of a clip of several people, what became of each.
    """

    name: str
    status: str
    reason: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    thumbnail: Path | None = None
    link: str | None = None
    report: Path | None = None
    people: tuple["BatchClip", ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the clip's own result warns of; of several people each has theirs."""
        return tuple(one["message"] for one in self.figures.get("warnings") or ()) if self.status == "done" else ()

    @property
    def is_warned_of(self) -> bool:
        """Whether the result, or that of somebody in the clip, has a warning."""
        return bool(self.warnings) or any(one.warnings for one in self.people)


@dataclass(frozen=True)
class BatchCounts:
    """How many clips there are of each kind."""

    clips: int
    done: int
    set_aside: int
    warned_of: int = 0

    @property
    def waiting(self) -> int:
        """Neither done nor set aside."""
        return self.clips - self.done - self.set_aside


def page_name(number: int) -> str:
    """The file of a page, counted from 0."""
    return f"summary-{number + 1}.html" if number else "summary.html"


def page_count(clips: int) -> int:
    """How many pages so many clips have."""
    return max(1, -(-clips // CLIPS_PER_PAGE))


def batch_page(
    title: str, clips: Sequence[BatchClip], number: int, counts: BatchCounts, troubles: Iterable[tuple[int, BatchClip]]
) -> str:
    """One page.

    Args:
        clips: those of this page alone. number: of the page, from 0.
        troubles: (place among all clips, clip) of those that were set aside; the first page lists them.
    """
    head = ["clip", "", "state", *(label for label, _, _ in _FIGURES), ""]
    rows = [row for clip in clips for row in (_row(clip), *(_row(one, clip.name) for one in clip.people))]
    told = f"{counts.clips} clips: {counts.done} done, {counts.set_aside} set aside, {counts.waiting} waiting."
    if counts.warned_of:
        told += f" Of those done, {counts.warned_of} with warnings."
    return page(
        title if not number else f"{title}, page {number + 1}",
        element("p", told) if not number else None,
        _troubles(troubles) if not number else None,
        pages := _pages(number, page_count(counts.clips)),
        table(rows, head, "figures"),
        pages,
    )


def strip_thumbnail(strip: Path) -> bytes:
    """The first row of a result's strip as a small JPEG.

    Raises:
        InputError: it is damaged, or no picture.
    """
    pixels = read_picture_srgb(strip)
    width_px, height_px = _THUMBNAIL_PX
    height, width = pixels.shape[:2]
    rows = max(1, min(height, round(height_px * max(width, width_px) / width_px)))
    return small_picture(np.ascontiguousarray(pixels[:rows]), width_px)


def _pages(number: int, count: int) -> Html | None:
    """Links to all pages; None where there is one."""
    if count == 1:
        return None
    links = [
        element("b", str(other + 1)) if other == number else element("a", str(other + 1), href=page_name(other))
        for other in range(count)
    ]
    return element("p", "Page ", *(part for link in links for part in (link, " ")))


def _troubles(troubles: Iterable[tuple[int, BatchClip]]) -> Html | None:
    found = list(troubles)
    if not found:
        return None
    items = []
    for place, clip in found[:_MOST_TROUBLES]:
        elsewhere = place // CLIPS_PER_PAGE
        name = element("a", clip.name, href=page_name(elsewhere)) if elsewhere else element("b", clip.name)
        items.append(element("li", name, ": ", clip.reason[:_LONGEST_REASON]))
    more = len(found) - len(items)
    last = element("p", f"{more} more are on the pages below.", class_="muted") if more else None
    return section("Set aside", element("ul", *items), last)


def _row(clip: BatchClip, whole: str | None = None) -> list[object]:
    """Of a clip; or of one of several people in it, whose ``whole`` clip has the row above."""
    count, kind = len(clip.warnings), _CLASSES.get(clip.status, "warn")
    warned_of = f", {count} warning{'s' if count > 1 else ''}" if count else ""
    state = element("span", clip.status + warned_of, class_="warn" if count else kind)
    link = element("a", "MLflow", href=clip.link) if clip.link and clip.link.startswith("http") else ""
    shown = joined(
        [_picture(clip) or element("span", clip.reason[:_LONGEST_REASON], class_="said"), _warnings(clip.warnings)]
    )
    figures = [_figure(clip.figures.get(key), form) for _, key, form in _FIGURES]
    return [_named(clip, whole), shown, state, *figures, link]


def _warnings(messages: Sequence[str]) -> Html | None:
    if not messages:
        return None
    shown = [element("li", message[:_LONGEST_REASON]) for message in messages[:_MOST_WARNINGS]]
    more = len(messages) - len(shown)
    return element("ul", *shown, element("li", f"and {more} more") if more > 0 else None, class_="said bad")


def _named(clip: BatchClip, whole: str | None) -> Html:
    """The clip's name, which leads to its page."""
    name = clip.name if whole is None else f"{whole}: {clip.name}"
    if clip.report is None:
        return element("span", name, class_="clip")
    return element("a", name, class_="clip", href=quote(os.fsencode(clip.report.as_posix())))


def _figure(value: object, form: str) -> str:
    if isinstance(value, list):  # gaps: first and last frame of each
        shown = ", ".join(f"{first}-{last}" for first, last in value[:_MOST_GAPS])
        return (shown or "none") + (f" and {len(value) - _MOST_GAPS} more" if len(value) > _MOST_GAPS else "")
    return format(value, form) if isinstance(value, int | float) else "-"


def _picture(clip: BatchClip) -> Html | None:
    if clip.thumbnail is None:
        return None
    try:
        return picture(clip.thumbnail.read_bytes(), clip.name)
    except (OSError, StopIteration):  # somebody tidied up: it is made again by the next run
        return None
