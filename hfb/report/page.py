"""The one style of our HTML pages, and the only way text gets into them: escaped unless it says that it is markup.

A page is one file that needs nothing else. Its content security policy allows pictures and films that are part of it,
its own style, and the scripts that it was made with, told by their sha256: nothing can be loaded from elsewhere, and
markup that slipped in could not run.
"""

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hfb.io.media.images.image_io import read_picture_srgb
from hfb.typing import Array, Float

_VOID = frozenset({"img", "input", "br", "meta", "col"})
_KINDS = (
    (b"\x89PNG", "image/png"), (b"\xff\xd8", "image/jpeg"), (b"<svg", "image/svg+xml"), (b"<?xml", "image/svg+xml"),
)  # fmt: skip
_SHOWN_BY_BROWSERS = (b"\x89PNG", b"\xff\xd8")
_JPEG_QUALITY = 85
_DATA = "data"


class Html(str):
    """Markup that was made here; any other text is escaped where it meets a page."""

    __slots__ = ()


def element(tag: str, *children: object, **attributes: object) -> Html:
    """An element; children and values of attributes that are not `Html` are escaped.

    Args:
        attributes: ``class_`` is written class, ``data_x`` data-x; None and False leave one out, True writes its name.
    """
    said = "".join(_attribute(name.strip("_").replace("_", "-"), value) for name, value in attributes.items())
    if tag in _VOID:
        return Html(f"<{tag}{said}>")
    return Html(f"<{tag}{said}>{joined(children)}</{tag}>")


def joined(parts: Iterable[object]) -> Html:
    """Parts one after another; None is nothing."""
    return Html("".join(_markup(part) for part in parts if part is not None))


def table(rows: Iterable[Sequence[object]], head: Sequence[object] = (), classes: str = "") -> Html:
    """A table that scrolls sideways by itself where the page is narrow; the first cell of a row names it."""
    above = element("thead", element("tr", *(element("th", cell) for cell in head))) if head else None
    lines = [
        element("tr", *(element("td", cell, class_=None if at else "name") for at, cell in enumerate(row)))
        for row in rows
    ]
    return element("div", element("table", above, element("tbody", *lines), class_=classes or None), class_="wide")


def section(title: str, *children: object, id: str | None = None) -> Html:
    """A part of the page under a heading."""
    return element("section", element("h2", title), *children, id=id)


def folded(summary: str, *children: object) -> Html:
    """What is shown only when asked for."""
    return element("details", element("summary", summary), *children)


def picture(content: bytes, alt: str, wide: bool = False) -> Html:
    """A PNG, JPEG or SVG picture inside the page.

    Args:
        wide: keeps its own size and scrolls sideways on a narrow page, instead of shrinking to nothing.
    """
    kind = next(name for start, name in _KINDS if content.startswith(start))
    shown = element("img", src=data_uri(content, kind), alt=alt)
    return element("div", shown, class_="wide picture") if wide else shown


def small_picture(source: Path | Float[Array, "H W 3"], width_px: int) -> bytes:
    """A picture, or the file of one, as a JPEG that is at most so wide.

    Args:
        source: sRGB in [0, 1] where it is no file.
    """
    pixels = read_picture_srgb(source) if isinstance(source, Path) else source
    height, width = pixels.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        pixels = cv2.resize(np.ascontiguousarray(pixels), size, interpolation=cv2.INTER_AREA)
    levels = np.ascontiguousarray(np.round(np.clip(pixels, 0, 1)[..., ::-1] * 255).astype(np.uint8))
    done, encoded = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    assert done, "OpenCV writes JPEG"
    return encoded.tobytes()


def checked_picture(file: Path, width_px: int, kept_bytes: int) -> bytes:
    """A picture from anywhere, as a file that browsers show: as it is where it is small, else as `small_picture`.

    It is decoded in any case: what is no picture, or one of far too many pixels, must not reach a reader's browser.

    Raises:
        InputError: it is damaged, or no picture.
    """
    pixels = read_picture_srgb(file)
    content = file.read_bytes() if file.stat().st_size <= kept_bytes else b""
    return content if content.startswith(_SHOWN_BY_BROWSERS) else small_picture(pixels, width_px)


def film(content: bytes, caption: str) -> Html:
    """An H.264 film inside the page."""
    shown = element(
        "video", src=data_uri(content, "video/mp4"), controls=True, loop=True, muted=True, playsinline=True,
        preload="auto",
    )  # fmt: skip
    return element("figure", shown, element("figcaption", caption))


def data_block(content: Any, **attributes: object) -> Html:
    """Plain values for the page's scripts; they are data, whatever they contain."""
    safe = json.dumps(content, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        safe = safe.replace(character, f"\\u{ord(character):04x}")
    return element("script", Html(safe), type="application/json", **attributes)


def data_uri(content: bytes, kind: str) -> str:
    """A file as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def page(title: str, *parts: object, scripts: Sequence[str] = ()) -> str:
    """The whole document.

    Args:
        scripts: run in this order when everything is there; nothing else in the page ever runs.
    """
    allowed = " ".join(f"'{_fingerprint(script)}'" for script in scripts) or "'none'"
    policy = (
        f"default-src 'none'; img-src data: blob:; media-src data: blob:; style-src 'unsafe-inline'; "
        f"script-src {allowed}; base-uri 'none'; form-action 'none'"
    )
    head = element(
        "head", element("meta", charset="utf-8"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">'),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title), element("style", Html(page_file("page.css"))),
    )  # fmt: skip
    body = element("body", element("main", element("h1", title), *parts), *(_script(script) for script in scripts))
    document = f"<!doctype html>\n{element('html', head, body, lang='en')}\n"
    return document.encode("utf-8", "backslashreplace").decode()  # a file's name may have bytes that are no text


@cache
def page_file(name: str) -> str:
    """A style sheet or script that comes with the package."""
    return (files("hfb.report") / _DATA / name).read_text(encoding="utf-8")


def _script(script: str) -> Html:
    assert "</script" not in script.lower(), "a script cannot hold its own end"
    return element("script", Html(script))


def _fingerprint(script: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _attribute(name: str, value: object) -> str:
    if value is None or value is False:
        return ""
    return f" {name}" if value is True else f' {name}="{escape(str(value), quote=True)}"'


def _markup(part: object) -> str:
    return part if isinstance(part, Html) else escape(str(part), quote=True)
