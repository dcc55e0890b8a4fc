"""The page of `hfb app` in Chromium: by mouse and by keyboard, wide and narrow, and nothing is asked for elsewhere."""

import json
from base64 import b64encode
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.browser import assert_body_moves, assert_film_plays, browser, opened
from tests.flows.app_pages import ENDLESS, SHORT, body, served
from tests.orchestration import Problem

NASTY = '<img src=x onerror="alert(1)">.png'
_DROP = """async ([area, files]) => {
  const carried = new DataTransfer();
  for (const [name, text] of files) {
    const bytes = Uint8Array.from(atob(text), (one) => one.charCodeAt(0));
    carried.items.add(new File([bytes], name));
  }
  const how = { dataTransfer: carried, bubbles: true, cancelable: true };
  document.querySelector(area).dispatchEvent(new DragEvent("drop", how));
}"""


def drop(tab: Any, area: str, *files: tuple[str, bytes]) -> None:
    """Files from a desktop, dropped on a part of the page."""
    tab.evaluate(_DROP, [area, [(name, b64encode(data).decode()) for name, data in files]])


def said(tab: Any) -> str:
    tab.locator("button.main").click()
    tab.wait_for_selector("#said:not(:empty)")
    return tab.locator("#said").inner_text()


@pytest.mark.usefixtures("store")
def test_a_picture_is_dropped_and_its_result_is_shown(problem: Problem, tmp_path: Path) -> None:
    frame, plate = problem.frame.read_bytes(), problem.background.read_bytes()
    with served(tmp_path / "app", *SHORT) as page, browser() as chromium:
        view = opened(chromium, page.url, 1100)
        tab = view.tab
        tab.on("dialog", lambda dialog: dialog.accept())
        drop(tab, "body", (NASTY, frame), ("room_plate.png", plate))
        assert tab.locator("[data-role=recording] .chosen").inner_text().startswith(NASTY)
        assert tab.locator("[data-role=plate] .chosen").inner_text().startswith("room_plate.png")
        tab.locator("#lens").fill("53.13010235")
        tab.locator("#lens-kind").select_option("degrees")
        tab.locator("#exposure").fill("1/50")
        tab.locator("[id='fit.height_m']").fill("1.75")
        tab.locator("button.main").click()
        tab.wait_for_selector("#job-steps li.running")
        tab.wait_for_selector("#job-result:not([hidden])")
        assert tab.locator("#job-title").inner_text() == NASTY
        assert tab.locator("#job-state").inner_text() == "done"
        assert tab.locator(".jobs a[aria-current]").inner_text().endswith("done")
        report = tab.locator("#report").element_handle().content_frame()
        report.wait_for_load_state("load")  # what is above the viewer has its height
        report.wait_for_selector(".viewer canvas")
        assert report.evaluate("() => origin") == "null", "a report cannot reach the page"
        assert_body_moves(report)
        assert_film_plays(report)
        with tab.expect_download() as download:
            tab.locator("#files a", has_text="motion.glb").click()
        assert Path(download.value.path()).read_bytes().startswith(b"glTF")
        with tab.expect_download() as download:
            tab.locator("#all").click()
        assert download.value.suggested_filename.endswith(".zip")

        name = page.jobs()[0]["name"]
        config = json.loads((tmp_path / "app" / name / "result" / "result.json").read_text())["config"]
        assert config["camera"]["focal_px"] == pytest.approx(96)  # of 96 px, and 53 degrees
        assert config["exposure"]["seconds"] == pytest.approx(0.02)
        assert config["fit"]["height_m"] == 1.75

        tab.locator("#job a", has_text="New recording").click()
        assert tab.locator("[data-role=recording] .chosen").inner_text().startswith(NASTY), "nothing is lost"
        tab.locator(".jobs a").click()
        tab.locator("[data-do=remove]").click()
        tab.wait_for_selector("#none:not([hidden])")
        assert page.jobs() == []
        assert view.hosts() == {"127.0.0.1"}
        assert view.errors == []


@pytest.mark.usefixtures("store")
def test_the_keyboard_alone_starts_and_cancels(problem: Problem, tmp_path: Path) -> None:
    with served(tmp_path / "app", *ENDLESS) as page, browser() as chromium:
        view = opened(chromium, page.url, 390)
        tab = view.tab
        tab.locator("#recording").set_input_files(problem.frame)  # a browser's own dialog is not the page's
        tab.locator("#plate").set_input_files(problem.background)
        tab.locator("h2").first.focus()
        tab.keyboard.press("Tab")
        assert tab.evaluate("() => document.activeElement.id") == "recording"
        tab.keyboard.press("Tab")
        assert tab.evaluate("() => document.activeElement.ariaLabel") == "leave out frame.png"
        tab.locator("#exposure").focus()
        tab.keyboard.press("Enter")
        tab.wait_for_selector("#job-steps li.running:has-text('fit')")
        assert tab.evaluate("() => document.activeElement.id") == "job-title"
        for _ in range(3):
            if tab.evaluate("() => document.activeElement.dataset.do") == "cancel":
                break
            tab.keyboard.press("Tab")
        tab.keyboard.press("Enter")
        tab.wait_for_selector("#job-message:not(:empty)")
        assert "cancelled" in tab.locator("#job-message").inner_text()
        assert tab.locator("[data-do=again]").is_visible()
        assert tab.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), "no sideways scrolling"
        assert view.errors == []


def test_what_is_wrong_is_told_and_nothing_is_lost(problem: Problem, tmp_path: Path) -> None:
    frame, plate = problem.frame.read_bytes(), problem.background.read_bytes()
    other = cv2.imencode(".png", np.zeros((50, 60, 3), np.uint8))[1].tobytes()
    huge = cv2.imencode(".png", np.zeros((6400, 6400), np.uint8))[1].tobytes()
    with served(tmp_path / "app", *SHORT) as page, browser() as chromium:
        tab = opened(chromium, page.url, 390).tab
        assert said(tab) == "Give a blurred picture or a video first."
        assert tab.evaluate("() => document.activeElement.id") == "recording"
        drop(tab, "[data-role=recording]", ("frame.png", frame))
        assert "Give a picture of the empty scene" in said(tab)
        drop(tab, "[data-role=plate]", ("other.png", other))
        assert "frame.png is 96 x 96 px and the empty scene 60 x 50 px" in said(tab)
        drop(tab, "[data-role=plate]", ("huge.png", huge))
        assert "huge.png has 6400 x 6400 px: at most 40 million" in said(tab)
        drop(tab, "[data-role=plate]", ("plate.png", plate))
        for field, text, sentence in (
            ("[id='fit.height_m']", "3", "Height of the person must lie between 1.4 and 2.4, and 3 was given."),
            ("#exposure", "quick", "Exposure time: quick is no number."),
            ("#exposure", "1/0", "Exposure time: 1/0 is no number."),
            ("#exposure", "NaN", "Exposure time: NaN is no number."),
            ("#lens", "0.5", "camera.focal_px"),
        ):
            tab.locator(field).fill(text)
            assert sentence in said(tab)
            tab.locator(field).fill("")
        drop(tab, "[data-role=recording]", ("notes.pdf", b"%PDF"))
        assert "notes.pdf is neither a picture" in said(tab)
        assert tab.locator("[data-role=recording] .chosen li").count() == 2
        tab.locator("[aria-label='leave out notes.pdf']").click()
        drop(tab, "[data-role=recording]", ("clip.toml", b"[exposure]\nseconds = -1\n"))
        assert "clip.toml: exposure.seconds" in said(tab)
        assert page.jobs() == []
        page.process.kill()
        page.process.wait()
        tab.locator("[aria-label='leave out clip.toml']").click()
        assert "is hfb app still running?" in said(tab)
        assert tab.locator("[data-role=plate] .chosen li").count() == 1


@pytest.mark.usefixtures("store")
def test_a_job_that_failed_is_told(tmp_path: Path) -> None:
    with served(tmp_path / "app", "--init.method", "matte") as page, browser() as chromium:
        files = [("recording", "walk.mp4", b"no video"), ("plate", "plate.png", b"no picture")]
        name = page.post("jobs", body(files)).json()["name"]
        tab = opened(chromium, f"{page.url}#{name}", 390).tab
        tab.wait_for_selector("#job-message:not(:empty)")
        assert tab.locator("#job-state").inner_text() == "cannot be used"
        assert "walk.mp4" in tab.locator("#job-message").inner_text()
        assert not tab.locator("#job-progress").is_visible()
