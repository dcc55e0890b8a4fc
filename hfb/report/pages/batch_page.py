"""A batch's summary pages, a hundred clips each: state, thumbnail and a link to each clip's own page."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from hfb.io.media.images.image_decoding import decode_picture
from hfb.report.pages.page import page, picture_uri, small_picture

CLIPS_PER_PAGE = 100
_THUMBNAIL_PX = (480, 110)  # the largest width and height
_MOST_TROUBLES = 50
_LONGEST_REASON = 600
_MOST_WARNINGS = 10
_CLASSES = {"done": "good", "set aside": "bad"}
_FIGURES = (
    ("frames", "frames", "d"),
    ("sub-frames", "sub_frames", "d"),
    ("gaps", "gaps", ""),
    ("IoU", "matte_iou", ".3f"),
    ("PSNR [dB]", "psnr_db", ".1f"),
    ("MPJPE [mm]", "mpjpe_mm", ".1f"),
    ("seconds", "seconds", ".0f"),
)
_MOST_GAPS = 20


@dataclass(frozen=True)
class BatchClip:
    """State and result of one clip.

    Attributes:
        status: ``done``, ``set aside`` or what the clip waits for.
        reason: of a clip that is not done.
        figures: the content of its result.json, as far as there is one (`hfb.report.pages.result_facts`).
        thumbnail: file of `strip_thumbnail`.
        link: its page in MLflow.
        report: its own page, relative to this page's folder.
        people: of a clip of several people, the result of each.
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
        """The warnings in the clip's own result; each of several people has their own."""
        return tuple(one["message"] for one in self.figures.get("warnings") or ()) if self.status == "done" else ()

    @property
    def is_warned_of(self) -> bool:
        """Whether the clip's result, or that of a person in it, has a warning."""
        return bool(self.warnings) or any(one.warnings for one in self.people)


@dataclass(frozen=True)
class BatchCounts:
    """Number of clips in each state."""

    clips: int
    done: int
    set_aside: int
    warned_of: int = 0

    @property
    def waiting(self) -> int:
        """Number of clips that are neither done nor set aside."""
        return self.clips - self.done - self.set_aside


def page_name(number: int) -> str:
    """Return the file name of a page.

    Args:
        number: the page's number, from 0.
    """
    return f"summary-{number + 1}.html" if number else "summary.html"


def page_count(clips: int) -> int:
    """Return the number of pages.

    Args:
        clips: number of clips.
    """
    return max(1, -(-clips // CLIPS_PER_PAGE))


def batch_page(
    title: str, clips: Sequence[BatchClip], number: int, counts: BatchCounts, troubles: Iterable[tuple[int, BatchClip]]
) -> str:
    """Render one page.

    Args:
        title: title of the batch.
        clips: those of this page alone.
        number: the page's number, from 0.
        counts: of the whole batch.
        troubles: (index among all clips, clip) of those set aside; the first page lists them.
    """
    first = number == 0
    listed = list(troubles) if first else []
    return page(
        "batch.html",
        title if first else f"{title}, page {number + 1}",
        number=number,
        pages=page_count(counts.clips),
        page_name=page_name,
        counts=counts,
        troubles=[_trouble(place, clip) for place, clip in listed[:_MOST_TROUBLES]],
        more_troubles=len(listed[_MOST_TROUBLES:]),
        labels=[label for label, _, _ in _FIGURES],
        rows=[row for clip in clips for row in (_row(clip), *(_row(one, clip.name) for one in clip.people))],
    )


def strip_thumbnail(strip: Path, content: bytes) -> bytes:
    """Return the first row of a result's strip as a small JPEG.

    Args:
        strip: the result's strip.png, for messages.
        content: of it.

    Raises:
        InputError: it is damaged, or no image.
    """
    pixels = decode_picture(strip, data=content).pixels
    width_px, height_px = _THUMBNAIL_PX
    height, width = pixels.shape[:2]
    rows = max(1, min(height, round(height_px * max(width, width_px) / width_px)))
    return small_picture(np.ascontiguousarray(pixels[:rows]), width_px)


def _trouble(place: int, clip: BatchClip) -> tuple[str, str | None, str]:
    """Return name, page where that is not the first, and reason."""
    elsewhere = place // CLIPS_PER_PAGE
    return clip.name, page_name(elsewhere) if elsewhere else None, clip.reason[:_LONGEST_REASON]


def _row(clip: BatchClip, whole: str | None = None) -> dict[str, object]:
    """Return the row of a clip, or of one of several people in the clip ``whole``."""
    count = len(clip.warnings)
    warned_of = f", {count} warning{'s' if count > 1 else ''}" if count else ""
    return {
        "name": clip.name if whole is None else f"{whole}: {clip.name}",
        "clip_name": clip.name,
        "href": None if clip.report is None else quote(os.fsencode(clip.report.as_posix())),
        "thumbnail": _thumbnail(clip),
        "reason": clip.reason[:_LONGEST_REASON],
        "warnings": [message[:_LONGEST_REASON] for message in clip.warnings[:_MOST_WARNINGS]],
        "more_warnings": len(clip.warnings[_MOST_WARNINGS:]),
        "state": clip.status + warned_of,
        "state_class": "warn" if count else _CLASSES.get(clip.status, "warn"),
        "figures": [_figure(clip.figures.get(key), form) for _, key, form in _FIGURES],
        "link": clip.link if clip.link and clip.link.startswith("http") else None,
    }


def _figure(value: object, form: str) -> str:
    if isinstance(value, list):  # gaps: first and last frame of each
        shown = ", ".join(f"{first}-{last}" for first, last in value[:_MOST_GAPS])
        return (shown or "none") + (f" and {len(value) - _MOST_GAPS} more" if len(value) > _MOST_GAPS else "")
    return format(value, form) if isinstance(value, int | float) else "-"


def _thumbnail(clip: BatchClip) -> str | None:
    """Return the thumbnail as a data URI."""
    if clip.thumbnail is None:
        return None
    try:
        return picture_uri(clip.thumbnail.read_bytes())
    except (OSError, StopIteration):  # somebody tidied up: it is made again by the next run
        return None
