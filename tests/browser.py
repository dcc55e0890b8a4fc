"""Pages in the system's Chromium, with everything that they asked for and complained about."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_INSIDE = ("data", "blob", "about", "file")
_FLAGS = (
    "--no-sandbox",
    "--use-angle=swiftshader",  # there is no graphics card: nothing else is tried first
    "--enable-unsafe-swiftshader",
    "--disable-gpu-watchdog",  # on a busy machine it takes slow pictures for none
)
_LOST = "canvas => canvas.getContext('webgl2')?.isContextLost() ?? false"  # of a drawn canvas: it keeps its kind
_PATIENCE_MS = 120_000  # pictures are drawn by the processor, which may be busy


@dataclass
class Opened:
    """A tab, and what it did.

    Attributes:
        requests: addresses that were asked for over a network. errors: what the console and the scripts complained of,
            after the address that it is about.
    """

    tab: Any
    requests: list[str] = field(default_factory=list)
    errors: list[tuple[str, str]] = field(default_factory=list)

    def hosts(self) -> set[str]:
        return {str(urlsplit(address).hostname) for address in self.requests}


@contextmanager
def browser(*flags: str) -> Iterator[Any]:
    """Chromium without a window. Never around a flow: Playwright's loop runs in this thread as long as it is open.

    Skips where there is no Chromium or no Playwright.
    """
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with api.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=CHROMIUM, args=[*_FLAGS, *flags])
        try:
            yield chromium
        finally:
            chromium.close()


def new_tab(chromium: Any, width: int) -> Any:
    """An empty tab."""
    tab = chromium.new_page(viewport={"width": width, "height": 900})
    tab.set_default_timeout(_PATIENCE_MS)
    return tab


def opened(chromium: Any, address: str, width: int) -> Opened:
    """A page at a width, with its listeners in place before anything is loaded."""
    page = Opened(new_tab(chromium, width))

    def asked(request: Any) -> None:
        if urlsplit(request.url).scheme not in _INSIDE:
            page.requests.append(request.url)

    def said(message: Any) -> None:
        if message.type == "error":
            page.errors.append((message.location.get("url", ""), message.text))

    page.tab.on("request", asked)
    page.tab.on("console", said)
    page.tab.on("pageerror", lambda error: page.errors.append(("", str(error))))
    page.tab.goto(address)
    return page


def assert_body_moves(frame: Any) -> None:
    """The slider moves the body in a tab or a frame of one: what the canvas shows changes, and back again."""
    canvas = frame.locator(".viewer canvas").first
    canvas.scroll_into_view_if_needed()
    slider = frame.locator(".viewer input.when").first
    assert canvas.bounding_box()["height"] > 200
    _untick(frame.locator(".viewer input.ghosts").first)  # they stand still
    slider.fill("0")
    seen = [b""]
    first = shows(canvas, lambda shown: seen.append(shown) or shown == seen[-2])  # what was drawn before may still show
    slider.fill(slider.get_attribute("max"))
    assert shows(canvas, lambda shown: shown != first) != first
    slider.fill("0")
    assert shows(canvas, lambda shown: shown == first) == first


def _untick(box: Any) -> None:
    """By the keyboard, whose key a page that still moves the frame about cannot make miss the box; then wait for it."""
    box.press("Space")
    deadline = time.monotonic() + _PATIENCE_MS / 1000
    while box.is_checked():
        assert time.monotonic() < deadline, "the box stays ticked"
        time.sleep(0.05)


def shows(canvas: Any, expected: Callable[[bytes], bool]) -> bytes:
    """What a canvas shows once it is as expected, or after a while: what is on the screen lags behind the script.

    A picture whose WebGL context is lost at that moment is passed over: Chromium starts its graphics process again when
    it likes, and the page has to draw again after it.
    """
    deadline = time.monotonic() + _PATIENCE_MS / 4000
    while True:
        canvas.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        was_lost = canvas.evaluate(_LOST)
        shown = bytes(canvas.screenshot())
        there = not (was_lost or canvas.evaluate(_LOST))
        if (there and expected(shown)) or time.monotonic() > deadline:
            return shown
        time.sleep(0.1)


def assert_film_plays(frame: Any) -> None:
    """The film's time goes on, and it has pictures."""
    film = frame.locator("video").first
    film.scroll_into_view_if_needed()
    began = film.evaluate("video => video.play().then(() => video.currentTime)")
    reached = film.evaluate(
        """(video, [began, patience]) => new Promise((done) => {
          const look = () => (video.currentTime > began + 0.05 ? done(video.currentTime) : setTimeout(look, 20));
          look();
          setTimeout(() => done(video.currentTime), patience);
        })""",
        [began, _PATIENCE_MS],
    )
    assert reached > began
    assert film.evaluate("video => video.videoWidth") > 100
