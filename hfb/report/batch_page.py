"""A batch of clips as one HTML file: what became of each, a picture of it, and where its own page is."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from hfb.report.page import Html, element, joined, page, picture, section, small_picture, table

_WIDTH_PX = 1200
_CLASSES = {"done": "good", "set aside": "bad"}
_FIGURES = (
    ("frames", "frames", "d"), ("sub-frames", "sub_frames", "d"), ("gaps", "gaps", ""), ("IoU", "matte_iou", ".3f"),
    ("PSNR [dB]", "psnr_db", ".1f"), ("MPJPE [mm]", "mpjpe_mm", ".1f"), ("seconds", "seconds", ".0f"),
)  # fmt: skip


@dataclass(frozen=True)
class BatchClip:
    """What became of one clip.

    Attributes:
        status: ``done``, ``set aside`` or anything else that says what it waits for.
        reason: of a clip that is not done.
        figures: the content of its result.json, as far as there is one.
        strip: its picture. report: its own page, from the folder of this one.
        link: its page in MLflow.
        person: one of several people in the clip of the row above, not counted.
    """

    name: str
    status: str
    reason: str
    figures: dict
    strip: Path | None = None
    link: str | None = None
    person: bool = False
    report: Path | None = None


def batch_page(title: str, clips: Sequence[BatchClip]) -> str:
    """The page."""
    whole = [clip for clip in clips if not clip.person]
    done = sum(clip.status == "done" for clip in whole)
    aside = sum(clip.status == "set aside" for clip in whole)
    head = ["clip", "state", *(label for label, _, _ in _FIGURES), ""]
    return page(
        title,
        element("p", f"{len(whole)} clips: {done} done, {aside} set aside, {len(whole) - done - aside} waiting."),
        table([_row(clip) for clip in clips], head, "figures"),
        *(_picture(clip, clip.strip) for clip in clips if clip.strip is not None),
    )


def _row(clip: BatchClip) -> list[object]:
    state = element("span", clip.status, class_=_CLASSES.get(clip.status, "warn"))
    links = [element("a", "MLflow", href=clip.link)] if clip.link and clip.link.startswith("http") else []
    told = joined([element("span", clip.reason, class_="said"), " ", *links])
    return [_named(clip), state, *(_figure(clip.figures.get(key), form) for _, key, form in _FIGURES), told]


def _named(clip: BatchClip) -> Html:
    """The clip's name, which leads to its page."""
    if clip.report is None:
        return element("span", clip.name)
    return element("a", clip.name, href=quote(clip.report.as_posix()))


def _figure(value: object, form: str) -> str:
    if isinstance(value, list):  # gaps: first and last frame of each
        return ", ".join(f"{first}-{last}" for first, last in value) or "none"
    return format(value, form) if isinstance(value, int | float) else "-"


def _picture(clip: BatchClip, strip: Path) -> Html:
    return section(clip.name, picture(small_picture(strip, _WIDTH_PX), clip.name))
