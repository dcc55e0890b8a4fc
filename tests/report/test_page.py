"""The page's frame: what gets in is escaped, what runs is ours, and nothing points elsewhere."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from importlib.resources import files

import cv2
import numpy as np
import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from hfb.body.assets import load_default_body
from hfb.report.pages.page import page, small_picture
from hfb.report.pages.viewer import ViewedMotion, viewer
from tests.interop.writers.motions import motion_of

NASTY = """</script><script>alert(1)</script>"' onload=x <img src=//evil>"""


class _Read(HTMLParser):
    """Elements and attributes as a browser takes them."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: set[tuple[str, str | None]] = set()
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes |= set(attrs)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_every_text_and_attribute_is_escaped() -> None:
    table = {"title": NASTY, "rows": [(NASTY, NASTY, NASTY, None)], "empty": ""}
    look = {"name": NASTY, "viewer": None, "picture": b"\x89PNG"}
    whole = page(
        "runs.html",
        NASTY,
        sentences=[NASTY],
        tables=[table],
        looks=[look, look],
        viewers=[],
        overlay=None,
        colours=[NASTY],
    )
    body = _Read(whole.partition("<body>")[2])
    assert set(body.tags) <= {
        "main",
        "h1",
        "h2",
        "p",
        "div",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
        "section",
        "img",
        "figure",
        "figcaption",
        "b",
    }
    assert "<script" not in whole
    assert "<img src=//" not in whole
    assert {("class", NASTY), ("alt", f"what {NASTY} found")} <= body.attributes
    assert body.text.count(NASTY) == 10
    assert "None" not in body.text
    assert not re.search(r"(src|href)=\"(?!data:)", whole)


def test_only_markup_is_taken_as_such() -> None:
    assert "a&lt;b&gt;</main>" in page("base.html", "x", content="a<b>")
    assert "<b>c</b></main>" in page("base.html", "x", content=Markup("<b>c</b>"))


def test_no_template_marks_anything_as_safe() -> None:
    """Values that are markup are so where they are made, which is in Python."""
    templates = [one for one in (files("hfb.report.pages") / "templates").iterdir() if one.name.endswith(".html")]
    assert len(templates) > 5
    for template in templates:
        assert not re.search(r"\|\s*safe|autoescape|http-equiv.*{{ \w+ }}.*unsafe", template.read_text()), template.name


def test_a_value_that_is_missing_is_an_error() -> None:
    with pytest.raises(UndefinedError, match="content"):
        page("base.html", "x")


def test_data_for_scripts_cannot_end_its_block() -> None:
    name = NASTY + "\u2028&"
    shown = viewer([ViewedMotion(name, motion_of(load_default_body()))], None, label=NASTY)
    inside = shown.partition('class="scene">')[2].partition("</script>")[0]
    assert "<" not in inside
    assert "\u2028" not in inside
    assert json.loads(inside)["motions"][0]["name"] == name
    assert ("data-label", NASTY) in _Read(shown).attributes


def test_only_the_given_scripts_may_run() -> None:
    script = "console.log('ours' && 1 < 2)"
    whole = page("base.html", "x", content="", scripts=[script])
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', whole)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
    assert "http" not in policy
    assert f"<script>{script}</script>" in whole
    assert "script-src 'none'" in page("base.html", "x", content="")


def test_pictures_shrink_but_do_not_grow() -> None:
    wide = np.linspace(0, 1, 400 * 30 * 3).reshape(30, 400, 3)
    for asked, width in ((100, 100), (1000, 400)):
        small = cv2.imdecode(np.frombuffer(small_picture(wide, asked), np.uint8), cv2.IMREAD_COLOR)
        assert small.shape[:2] == (round(30 * width / 400), width)
        assert abs(float(small[..., 2].mean()) / 255 - wide[..., 0].mean()) < 0.02
