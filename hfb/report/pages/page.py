"""HTML pages from the templates of this package, with one style sheet; whatever is not `Markup` is escaped.

A page is one self-contained file. Its content security policy allows embedded images and films, its own style, and the
scripts it was made with, by sha256: nothing is loaded from elsewhere, and injected markup cannot run.
"""

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from hfb.io.media.images.image_access import read_bytes
from hfb.io.media.images.image_decoding import decode_picture
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.typing import Array, Float

_KINDS = (
    (b"\x89PNG", "image/png"),
    (b"\xff\xd8", "image/jpeg"),
    (b"<svg", "image/svg+xml"),
    (b"<?xml", "image/svg+xml"),
)
_SHOWN_BY_BROWSERS = (b"\x89PNG", b"\xff\xd8")
_JPEG_QUALITY = 85


def page(template: str, title: str, *, scripts: Sequence[str] = (), **values: object) -> str:
    """Render a whole HTML document.

    Args:
        template: a file of ``templates/`` that extends ``base.html``.
        title: text of the title and of the first heading.
        scripts: run in this order after loading; no other script in the page ever runs.
        **values: the template's variables; text is escaped, None is empty.
    """
    assert not any("</script" in script.lower() for script in scripts), "a script cannot hold its own end"
    hashes = ["sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    document = render(
        template,
        title=title,
        style=Markup(page_file("page.css")),
        scripts=[Markup(one) for one in scripts],
        hashes=hashes,
        **values,
    )
    return document.encode("utf-8", "backslashreplace").decode()  # a file's name may have bytes that are no text


def render(template: str, **values: object) -> Markup:
    """Render a template of ``templates/``; text among the values is escaped.

    Args:
        template: name of the file.
        **values: the template's variables.
    """
    return Markup(_environment().get_template(template).render(values))


def picture_uri(content: bytes) -> str:
    """Return an image as a data URI.

    Args:
        content: a PNG, JPEG or SVG file.
    """
    return data_uri(content, next(name for start, name in _KINDS if content.startswith(start)))


def data_uri(content: bytes, kind: str) -> str:
    """Return a file as a data URI.

    Args:
        content: the file.
        kind: its media type.
    """
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def small_picture(source: Path | Float[Array, "H W 3"], width_px: int) -> bytes:
    """Return an image as a JPEG of limited width.

    Args:
        source: an image file, or sRGB in [0, 1].
        width_px: the largest width.
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
    """Return an image file of unknown origin in a form that browsers show: unchanged if small, else reduced.

    It is always decoded, so that no damaged file or decompression bomb reaches the reader's browser.

    Args:
        file: the image.
        width_px: the largest width of one that is reduced, see `small_picture`.
        kept_bytes: a file of at most this size stays as it is.

    Raises:
        InputError: it is damaged, or no image.
    """
    content = read_bytes(file)
    pixels = decode_picture(file, data=content).pixels
    kept = len(content) <= kept_bytes and content.startswith(_SHOWN_BY_BROWSERS)
    return content if kept else small_picture(pixels, width_px)


@cache
def page_file(name: str) -> str:
    """Return the text of a style sheet, script or table that comes with the package.

    Args:
        name: file name in ``data/``.
    """
    return _file("data", name)


@cache
def _environment() -> Environment:
    made = Environment(
        loader=FunctionLoader(lambda name: _file("templates", name)),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: "" if value is None else value,
    )
    made.filters |= {"picture_uri": picture_uri, "film_uri": lambda content: data_uri(content, "video/mp4")}
    return made


def _file(folder: str, name: str) -> str:
    return (files("hfb.report.pages") / folder / name).read_text(encoding="utf-8")
