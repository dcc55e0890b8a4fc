"""The page's frame: what gets in is escaped, what runs is ours, and nothing points elsewhere."""

import base64
import hashlib
import json
import re

import cv2
import numpy as np
import pytest

from hfb.report.page import Html, data_block, element, folded, joined, page, picture, section, small_picture, table

NASTY = """</script><script>alert(1)</script>"' onload=x <img src=//evil>"""


def test_every_text_and_attribute_is_escaped() -> None:
    parts = [
        element("p", NASTY, title=NASTY, data_name=NASTY), table([[NASTY, 1, None]], [NASTY], NASTY),
        section(NASTY, NASTY, id=NASTY), folded(NASTY, NASTY), picture(b"\x89PNG", NASTY),
    ]  # fmt: skip
    whole = page(NASTY, *parts, NASTY)
    assert "<script" not in whole
    assert "<img src=//" not in whole
    assert set(re.findall(r"<(\w+)", whole.partition("<body>")[2])) <= {
        "main", "h1", "h2", "p", "div", "table", "thead", "tbody", "tr", "th", "td", "section",
        "details", "summary", "img",
    }  # fmt: skip
    assert '"data:image/png;base64,' in whole
    assert not re.search(r"(src|href)=\"(?!data:)", whole)


def test_attributes_and_voids() -> None:
    assert element("video", controls=True, loop=False, src=None) == "<video controls></video>"
    assert (
        element("input", type="range", class_="when", data_sync=3) == '<input type="range" class="when" data-sync="3">'
    )
    assert joined(["a<", None, Html("<b>c</b>"), 2]) == "a&lt;<b>c</b>2"


def test_data_for_scripts_cannot_end_its_block() -> None:
    content = {"name": NASTY + "\u2028&", "number": [1.5, None]}
    block = data_block(content, class_="scene")
    inside = block.partition(">")[2].removesuffix("</script>")
    assert "<" not in inside
    assert "\u2028" not in inside
    assert json.loads(inside) == content
    with pytest.raises(ValueError, match="not JSON compliant"):
        data_block([float("nan")])


def test_only_the_given_scripts_may_run() -> None:
    script = "console.log('ours' && 1 < 2)"
    whole = page("x", scripts=[script])
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', whole)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.replace("&#x27;", "'").split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
    assert "http" not in policy
    assert f"<script>{script}</script>" in whole
    assert "script-src &#x27;none&#x27;" in page("x")


def test_pictures_shrink_but_do_not_grow() -> None:
    wide = np.linspace(0, 1, 400 * 30 * 3).reshape(30, 400, 3)
    for asked, width in ((100, 100), (1000, 400)):
        small = cv2.imdecode(np.frombuffer(small_picture(wide, asked), np.uint8), cv2.IMREAD_COLOR)
        assert small.shape[:2] == (round(30 * width / 400), width)
        assert abs(float(small[..., 2].mean()) / 255 - wide[..., 0].mean()) < 0.02
