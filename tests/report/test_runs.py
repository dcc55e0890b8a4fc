"""Two runs on one page: safe to open, complete in itself, and the picture shows both motions."""

import base64
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hfb.evaluate.motion_difference import motion_difference
from hfb.report.run_page import PageTable, run_page
from hfb.report.two_motions import draw_motions, png_bytes, stack_pictures
from tests.evaluate.test_motion_difference import linear_motion

BLUE, ORANGE = (0, 0x72, 0xB2), (0xD5, 0x5E, 0)


def drawn(picture: np.ndarray, colour: tuple[int, int, int]) -> int:
    """Pixels of about a colour."""
    return int((np.abs(picture * 255 - np.array(colour)).max(-1) < 60).sum())


def test_both_skeletons_are_seen() -> None:
    one = linear_motion(3)
    other = replace(one, joints=one.joints + 0.3)
    picture = draw_motions(one, other, motion_difference(one, other), ("one", "other"))
    assert picture.min() >= 0
    assert picture.max() <= 1
    assert drawn(picture, BLUE) > 2000
    assert drawn(picture, ORANGE) > 2000


def test_motions_without_a_shared_frame_cannot_be_drawn() -> None:
    one, other = linear_motion(3, (0,)), linear_motion(3, (1,))
    with pytest.raises(ValueError, match="share no frame"):
        draw_motions(one, other, motion_difference(one, other), ("one", "other"))


def test_pictures_of_any_size_stand_on_one_sheet() -> None:
    small, wide = np.zeros((10, 30, 3), np.float32), np.ones((20, 9000, 3), np.float32)
    sheet = stack_pictures([("small", small), ("wide", wide)])
    assert 3900 < sheet.shape[1] < 4100
    assert sheet.shape[0] > 30
    decoded = cv2.imdecode(np.frombuffer(png_bytes(sheet), np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == sheet.shape


def test_the_page_is_safe_and_needs_nothing_else() -> None:
    picture = png_bytes(np.zeros((4, 5, 3), np.float32))
    tables = [
        PageTable("options that differ", (("clip", "<script>alert(1)</script>", 'a"b', "1"),)),
        PageTable("machine", (), "none"),
    ]
    page = run_page(("a <b>", "c & d"), "They differ.", tables, picture, "both")
    assert "<script" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page
    assert "c &amp; d" in page
    assert "They differ." in page
    assert not re.search(r"(src|href)=\"(?!data:)", page)
    (data,) = re.findall(r"data:image/png;base64,([^\"]+)", page)
    assert base64.b64decode(data) == picture


def test_a_page_without_a_picture() -> None:
    assert "<img" not in run_page(("one", "other"), "", [], None, "both")
