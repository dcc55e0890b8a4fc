"""Runs on one page: safe to open, complete in itself, one slider for all, and the picture shows every motion."""

import base64
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.evaluation.motion_difference import motion_difference
from hfb.report.images.several_motions import RUN_COLOURS, draw_motions, png_bytes, stack_pictures
from hfb.report.pages.run_page import PageTable, RunLook, run_page
from hfb.report.pages.viewer import ViewedMotion, viewer, viewer_scripts
from tests.browser import browser, opened, shows
from tests.evaluation.test_motion_difference import linear_motion
from tests.interop.writers.motions import motion_of

HOSTILE = '<script>alert("1")</script> $x$'


def drawn(picture: np.ndarray, colour: str) -> int:
    """Pixels of about a colour."""
    wanted = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
    return int((np.abs(picture * 255 - wanted).max(-1) < 60).sum())


def test_every_skeleton_is_seen() -> None:
    first = linear_motion(3)
    others = [replace(first, joints=first.joints + shift) for shift in (0.3, 0.6)]
    named = [("first", first), *((HOSTILE, other) for other in others)]
    picture = draw_motions(named, [motion_difference(first, other) for other in others])
    assert picture.min() >= 0
    assert picture.max() <= 1
    for colour in RUN_COLOURS[:3]:
        assert drawn(picture, colour) > 2000


def test_motions_without_a_shared_frame_cannot_be_drawn() -> None:
    one, other = linear_motion(3, (0,)), linear_motion(3, (1,))
    with pytest.raises(ValueError, match="share no frame"):
        draw_motions([("one", one), ("other", other)], [motion_difference(one, other)])


def test_pictures_of_any_size_stand_on_one_sheet() -> None:
    small, wide = np.zeros((10, 30, 3), np.float32), np.ones((20, 9000, 3), np.float32)
    sheet = stack_pictures([("small", small), ("wide", wide)])
    assert 3900 < sheet.shape[1] < 4100
    assert sheet.shape[0] > 30
    decoded = cv2.imdecode(np.frombuffer(png_bytes(sheet), np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == sheet.shape


def test_the_page_is_safe_and_needs_nothing_else() -> None:
    picture = png_bytes(np.zeros((4, 5, 3), np.float32))
    tables = [PageTable("Options", (("clip", HOSTILE, 'a"b', "1"),)), PageTable("Machine", (), "none")]
    page = run_page(["They <b>differ</b>."], tables, [RunLook("a <b>", None, picture), RunLook("c & d")], picture)
    assert "<script" not in page
    assert "&lt;script&gt;alert(&#34;1&#34;)&lt;/script&gt;" in page
    assert "a &lt;b&gt; and c &amp; d" in page
    assert "They &lt;b&gt;differ&lt;/b&gt;." in page
    assert not re.search(r"(src|href)=\"(?!data:)", page)
    found = re.findall(r"data:image/png;base64,([^\"]+)", page)
    assert [base64.b64decode(data) for data in found] == [picture, picture]


def test_a_page_without_pictures() -> None:
    assert "<img" not in run_page([""], [], [RunLook("one"), RunLook("other")], None)


@pytest.mark.integration
def test_one_slider_moves_every_run(tmp_path: Path) -> None:
    """In Chromium, from disk: three runs with other sub-frames, one of them without a body model."""
    body = load_default_body(torch.float64)
    motions = [motion_of(body, frames=2), motion_of(body, frames=2, exposure_s=0.025), motion_of(body, frames=1)]
    names = ["one", HOSTILE, "three"]
    looks = [
        RunLook(name, viewer([ViewedMotion(name, motion)], body if name != "three" else None, None, name, "runs"))
        for name, motion in zip(names, motions, strict=True)
    ]
    path = tmp_path / "a <page> & more.html"
    path.write_text(run_page(["far apart"], [], looks, None, viewer_scripts()))
    assert "<script>alert" not in path.read_text()
    with browser() as chromium:
        for width in (1400, 600):
            page = opened(chromium, path.as_uri(), width)
            stages, clocks = page.tab.locator(".viewer canvas"), page.tab.locator(".viewer output.clock")
            assert stages.count() == 3
            before = [shows(stages.nth(number), lambda shown: True) for number in range(3)]
            page.tab.locator(".viewer input.when").nth(1).fill("0")
            for number, shown in enumerate(before):
                assert shows(stages.nth(number), lambda now, shown=shown: now != shown) != shown
            instants = [re.findall(r"t = ([\d.]+)", clocks.nth(number).inner_text()) for number in range(3)]
            assert instants == [["0.0"]] * 3
            assert page.tab.evaluate("document.documentElement.scrollWidth") <= width
            assert (page.requests, page.errors) == ([], [])
