"""A batch's pages: a hundred clips each, and a finished clip costs its own page and the first."""

import json
import time
from pathlib import Path
from urllib.parse import unquote, urlsplit

import cv2
import numpy as np
import pytest

from hfb.report.pages.batch_page import CLIPS_PER_PAGE, strip_thumbnail
from hfb.tasks.batch.batch_summary import BatchSummary
from tests.browser import CHROMIUM, browser, opened

LINK = "http://127.0.0.1:5000/#/experiments/1"


def finished(out: Path, name: str, **more: object) -> None:
    """A result, as far as pages show it."""
    folder = out / name
    folder.mkdir(parents=True)
    facts = {"frames": 300, "sub_frames": 2400, "gaps": [[3, 9]], "matte_iou": 0.9, "psnr_db": 30.25, "seconds": 99.0}
    facts |= more
    (folder / "result.json").write_text(json.dumps(facts))
    (folder / "report.html").write_text("its page")
    across, down = np.meshgrid(np.arange(1200), np.arange(560))
    cv2.imwrite(str(folder / "strip.png"), np.dstack([across % 256, down % 256, across // 5]).astype(np.uint8))


def summary_of(out: Path) -> BatchSummary:
    return BatchSummary("Clips of here", out, out / "intermediate" / "thumbnails")


def modified(out: Path) -> dict[str, int]:
    return {path.name: path.stat().st_ino for path in out.glob("summary*.html")}


def test_a_finished_clip_touches_its_page_and_the_first(tmp_path: Path) -> None:
    names = [f"clip {number:04}" for number in range(250)]
    for number in (0, 120, 249):
        finished(tmp_path, names[number])
    summary = summary_of(tmp_path)
    summary.show_all([(name, "new", "", None) for name in names])
    assert modified(tmp_path).keys() == {"summary.html", "summary-2.html", "summary-3.html"}
    before = modified(tmp_path)
    summary.show(names[120], "done", link=LINK)
    after = modified(tmp_path)
    assert {name for name in after if after[name] != before[name]} == {"summary.html", "summary-2.html"}
    summary.show(names[249], "set aside", "its <video> is damaged")

    first, second = ((tmp_path / name).read_text() for name in ("summary.html", "summary-2.html"))
    assert "250 clips: 1 done, 1 set aside, 248 waiting" in first
    assert 'href="summary-3.html">clip 0249</a>: its &lt;video&gt; is damaged' in first
    assert 'href="clip%200120/report.html"' in second
    assert LINK in second
    assert second.count("data:image/jpeg;base64,") == 1
    assert len(second) < 200_000

    names = names[:90]
    summary.show_all([(name, "new", "", None) for name in names])
    assert modified(tmp_path).keys() == {"summary.html"}, "pages that no clip is on are gone"
    assert "Page" not in (tmp_path / "summary.html").read_text()


def warning(code: str, message: str) -> dict[str, object]:
    return {"code": code, "value": 0.5, "frames": [], "message": message}


def test_what_a_result_warns_of_is_on_the_page(tmp_path: Path) -> None:
    """Of a clip, and of each of several people in one; a result that was well has no word."""
    spin, light = warning("trunk_spin", "the <trunk> turns by 150 degrees"), warning("light", "the light changed")
    finished(tmp_path, "walk", warnings=[spin, light])
    finished(tmp_path, "well", warnings=[])
    finished(tmp_path, "older")
    people = [{"name": "person 1", "error": None, "warnings": [light]}, {"name": "person 2", "error": "hidden"}]
    finished(tmp_path, "two", people=people)
    finished(tmp_path, "many", warnings=[warning("light", f"remark {number}") for number in range(12)])
    summary_of(tmp_path).show_all([(name, "done", "", None) for name in ("walk", "well", "older", "two", "many")])
    page = (tmp_path / "summary.html").read_text()
    assert "5 clips: 5 done, 0 set aside, 0 waiting. Of those done, 3 with warnings." in page
    assert "done, 2 warnings</span>" in page
    assert page.count(">done</span>") == 3, "well, older, and the clip of two people as a whole"
    assert page.count("done, 1 warning</span>") == 1, "person 1"
    assert "the &lt;trunk&gt; turns by 150 degrees" in page
    assert page.count("the light changed") == 2
    assert "remark 9" in page
    assert "remark 10" not in page
    assert "and 2 more" in page


@pytest.mark.parametrize("wrong", [["text"], {"message": "text"}, [{"code": "light"}], [{"message": 3}], "text"])
def test_warnings_that_hfb_did_not_write_are_that_clips_trouble(tmp_path: Path, wrong: object) -> None:
    finished(tmp_path, "walk", warnings=wrong)
    finished(tmp_path, "well")
    summary_of(tmp_path).show_all([(name, "done", "", None) for name in ("walk", "well")])
    page = (tmp_path / "summary.html").read_text()
    assert "2 clips: 1 done, 1 set aside" in page
    assert "is damaged (warnings" in page


def test_pages_that_are_somebody_elses_stay(tmp_path: Path) -> None:
    (tmp_path / "summary-7.html").write_text("<title>mine</title>")
    summary_of(tmp_path).show_all([("walk", "new", "", None)])
    assert (tmp_path / "summary-7.html").read_text() == "<title>mine</title>"


def test_small_pictures_are_made_once_per_strip(tmp_path: Path) -> None:
    finished(tmp_path, "walk")
    summary_of(tmp_path).show_all([("walk", "done", "", None)])
    (made,) = (tmp_path / "intermediate" / "thumbnails").iterdir()
    decoded = cv2.imread(str(made))
    assert decoded.shape[1] == 480
    assert decoded.shape[0] <= 110
    stamp = made.stat().st_ino
    summary_of(tmp_path).show_all([("walk", "done", "", None)])
    assert made.stat().st_ino == stamp
    cv2.imwrite(str(tmp_path / "walk" / "strip.png"), np.zeros((20, 3000, 3), np.uint8))
    summary_of(tmp_path).show_all([("walk", "done", "", None)])
    (again,) = (tmp_path / "intermediate" / "thumbnails").iterdir()
    assert again.name != made.name
    made.write_bytes(b"<script>")  # of a folder that somebody else sent
    again.write_bytes(b"<script>")
    summary_of(tmp_path).show_all([("walk", "done", "", None)])
    strip = tmp_path / "walk" / "strip.png"
    assert again.read_bytes() == strip_thumbnail(strip, strip.read_bytes())


def test_cost_per_clip_does_not_grow_with_their_number(tmp_path: Path) -> None:
    seconds = []
    finished(tmp_path, "walk")
    for count in (100, 2000):
        summary = summary_of(tmp_path)
        names = ["walk", *(f"wave {number}" for number in range(count - 1))]
        summary.show_all([(name, "new", "", None) for name in names])
        began = time.process_time()
        for _ in range(5):
            summary.show("walk", "new")
            summary.show("walk", "done")
        seconds.append((time.process_time() - began) / 10)
    assert seconds[1] < 1
    assert seconds[1] < 5 * seconds[0] + 0.05


@pytest.mark.integration
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_the_pages_lead_to_each_other_and_to_reports(tmp_path: Path) -> None:
    names = [f"clip {number:04}" for number in range(CLIPS_PER_PAGE + 5)]
    for name in (names[0], names[CLIPS_PER_PAGE + 2]):
        finished(tmp_path, name)
    summary = summary_of(tmp_path)
    done = {names[0], names[CLIPS_PER_PAGE + 2]}
    summary.show_all([(name, "done" if name in done else "new", "", None) for name in names])
    with browser() as chromium:
        shown = opened(chromium, (tmp_path / "summary.html").as_uri(), 1400)
        assert shown.tab.locator("td img").count() == 1
        assert shown.tab.locator("td img").evaluate("one => one.naturalWidth") == 480
        assert shown.tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
        shown.tab.locator("a", has_text="2").first.click()
        shown.tab.get_by_role("link", name=names[CLIPS_PER_PAGE + 2]).click()
        assert unquote(urlsplit(shown.tab.url).path).endswith(f"{names[CLIPS_PER_PAGE + 2]}/report.html")
        assert shown.errors == []
