"""A batch of clips as one HTML file that needs nothing else: what became of each, and a picture of it."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import cv2
import numpy as np

from hfb.media.pictures import read_picture_srgb

_WIDTH_PX = 900
_QUALITY = 82
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem; color: #222 }
h1 { font-size: 1.4rem } h2 { font-size: 1.1rem; margin: 2rem 0 .4rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: .25rem 1.2rem .25rem 0; border-bottom: 1px solid #ddd; vertical-align: top }
td:last-child { overflow-wrap: anywhere; min-width: 14rem } img { max-width: 100%; border: 1px solid #ddd }
.done { color: #00734f } .waiting { color: #8a6d00 } .aside { color: #b3261e }
"""
_CLASSES = {"done": "done", "set aside": "aside"}
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
        strip: its picture.
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


def batch_page(title: str, clips: Sequence[BatchClip]) -> str:
    """The page."""
    whole = [clip for clip in clips if not clip.person]
    done = sum(clip.status == "done" for clip in whole)
    aside = sum(clip.status == "set aside" for clip in whole)
    head = "".join(f"<th>{escape(name)}</th>" for name in ("clip", "state", *(label for label, _, _ in _FIGURES), ""))
    parts = [
        "<!doctype html>", '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
        f"<p>{len(whole)} clips: {done} done, {aside} set aside, {len(whole) - done - aside} waiting.</p>",
        f"<table><tr>{head}</tr>", *(_row(clip) for clip in clips), "</table>",
        *(_picture(clip) for clip in clips if clip.strip is not None), "</body></html>",
    ]  # fmt: skip
    return "\n".join(part for part in parts if part) + "\n"


def _row(clip: BatchClip) -> str:
    style = _CLASSES.get(clip.status, "waiting")
    cells = [f"<td>{escape(clip.name)}</td>", f'<td class="{style}">{escape(clip.status)}</td>']
    cells += [f"<td>{escape(_figure(clip.figures.get(key), form))}</td>" for _, key, form in _FIGURES]
    told = escape(clip.reason) if clip.reason else ""
    shown = f'<a href="{escape(clip.link, quote=True)}">MLflow</a>' if clip.link else ""
    return f"<tr>{''.join(cells)}<td>{told}{shown}</td></tr>"


def _figure(value: object, form: str) -> str:
    if isinstance(value, list):  # gaps: first and last frame of each
        return ", ".join(f"{first}-{last}" for first, last in value) or "none"
    return format(value, form) if isinstance(value, int | float) else "-"


def _picture(clip: BatchClip) -> str:
    assert clip.strip is not None
    picture = read_picture_srgb(clip.strip)
    height, width = picture.shape[:2]
    if width > _WIDTH_PX:
        size = (_WIDTH_PX, max(1, round(height * _WIDTH_PX / width)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    levels = np.ascontiguousarray(np.round(picture[..., ::-1] * 255).astype(np.uint8))
    done, encoded = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        return ""
    data = base64.b64encode(encoded.tobytes()).decode()
    name = escape(clip.name, quote=True)
    return f'<h2>{escape(clip.name)}</h2><img alt="{name}" src="data:image/jpeg;base64,{data}">'
