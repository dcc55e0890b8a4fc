"""`hfb view`: a result in viser's viewer in Chromium, for this machine's own page alone; without viser a page."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

import hfb
from hfb.flows.cli.cli import main
from tests.api.conftest import TINY
from tests.browser import assert_body_moves, browser, opened
from tests.orchestration import Problem, made_for_run
from tests.small_clips import FRAMES, finished


@pytest.fixture(scope="module")
def result() -> Path:
    """A saved fit of the tiny problem, whose exports left the plate beside it."""

    def make(folder: Path) -> None:
        from tests.orchestration import tiny_problem

        problem = tiny_problem(folder)
        hfb.fit(problem.frame, problem.background, **TINY).save(folder / "result")

    return made_for_run("viewed", make) / "result"


@pytest.fixture(autouse=True)
def one_core() -> Iterator[None]:
    """A scene without a GPU is drawn by every core all the time: the servers of tests beside this one would starve."""
    cores = os.sched_getaffinity(0)
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])  # two scenes on one core draw too late
    os.sched_setaffinity(0, {sorted(cores)[-1 - worker % len(cores)]})
    yield
    os.sched_setaffinity(0, cores)


@contextmanager
def live(source: Path) -> Iterator[str]:
    """`hfb view` in a process of its own; its address."""
    pytest.importorskip("viser", reason="viser is not installed")
    words = [sys.executable, "-m", "hfb.flows.cli.cli", "view", str(source), "--port", "0", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield json.loads(process.stdout.readline())["url"]
        finally:
            process.terminate()
            assert process.wait(60) == 128 + 15
            assert process.stdout.read() == ""


def scene(tab: Any) -> np.ndarray:
    """The middle of the page, beside the controls, once it is still."""
    where = {"x": 320, "y": 200, "width": 440, "height": 560}
    seen = [b"", tab.screenshot(clip=where)]
    deadline = time.monotonic() + 30
    while seen[-1] != seen[-2] and time.monotonic() < deadline:
        time.sleep(0.3)
        seen.append(tab.screenshot(clip=where))
    return cv2.imdecode(np.frombuffer(seen[-1], np.uint8), cv2.IMREAD_COLOR).astype(float)


def move(tab: Any, key: str, told: str) -> None:
    """Press a key on the slider of sub-frames, and wait until the text tells the instant."""
    tab.get_by_role("slider").first.press(key)
    tab.get_by_text(told).wait_for()


def becomes(tab: Any, wanted: Callable[[np.ndarray], bool]) -> bool:
    """Whether the scene becomes as wanted: a browser without a GPU draws when it has time."""
    deadline = time.monotonic() + 30
    while not (right := wanted(scene(tab))) and time.monotonic() < deadline:
        time.sleep(0.3)
    return right


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """The share of pixels whose colour changed."""
    return float((abs(one - other).max(2) > 16).mean())


def test_a_fit_is_seen_from_all_sides(result: Path) -> None:
    begun, last = (f"frame 0, {1000 * time_s:.1f} ms" for time_s in hfb.load_result(result).times_s[[0, -1]])
    with live(result) as url, browser() as chromium:
        view = opened(chromium, url, 1100)
        tab = view.tab
        move(tab, "Home", begun)
        first = scene(tab)
        move(tab, "End", last)
        assert becomes(tab, lambda now: changed(first, now) > 0.005)
        move(tab, "Home", begun)
        assert becomes(tab, lambda now: changed(first, now) < 0.001)
        tab.get_by_role("checkbox", name="Body").click()
        assert becomes(tab, lambda now: changed(first, now) > 0.02)
        bare = scene(tab)
        tab.get_by_role("checkbox", name="Joints, as large as their radii").click()
        assert becomes(tab, lambda now: changed(now, bare) > 0.002)
        tab.get_by_text("Look through the camera").click()
        assert becomes(tab, lambda now: changed(now, bare) > 0.1)
        tab.get_by_role("checkbox", name="Play").click()
        tab.get_by_text(last).wait_for()
        assert view.hosts() == {"127.0.0.1"}
        assert view.errors == []


def test_a_clip_is_seen(tmp_path: Path) -> None:
    out, _, _ = finished()
    end = hfb.load_result(out).times_s[-1]
    with live(out / "motion.npz") as url, browser() as chromium:
        tab = opened(chromium, url, 1100).tab
        move(tab, "Home", "frame 0, 0.0 ms")
        first = scene(tab)
        move(tab, "End", f"frame {FRAMES - 1}, {1000 * end:.1f} ms")
        assert becomes(tab, lambda now: changed(first, now) > 0.005)


def test_nobody_else_is_answered(result: Path) -> None:
    websockets = pytest.importorskip("websockets.sync.client", reason="viser is not installed")
    from websockets.exceptions import InvalidHandshake

    with live(result) as url:
        place, port = urlsplit(url).netloc, urlsplit(url).port
        spoken = [f"viser-v{version('viser')}"]
        with websockets.connect(f"ws://{place}", origin=url, subprotocols=spoken) as own:
            assert own.recv(timeout=60)
        for origin in ("http://example.org", f"http://example.org:{port}", "null", None):
            with pytest.raises(InvalidHandshake):
                websockets.connect(f"ws://{place}", origin=origin, subprotocols=spoken)
        with pytest.raises(ConnectionRefusedError):  # whoever listens on all addresses has this one, too
            socket.create_connection(("127.0.0.2", port), timeout=20)


def test_without_viser_a_page_is_written(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(result)]) == 0
    said = capsys.readouterr().out
    assert f"page     {result / 'view.html'}\n" in said
    assert "[view]" in said
    assert main(["view", str(result), "--out", str(tmp_path / "page"), "--json"]) == 0
    page = Path(json.loads(capsys.readouterr().out)["page"])
    assert page == tmp_path / "page" / "view.html"
    with browser() as chromium:
        view = opened(chromium, page.as_uri(), 1000)
        assert_body_moves(view.tab)
        assert (view.requests, view.errors) == ([], [])
    again = hfb.load_result(result)  # the page belongs to the result, which is whole
    assert "view.html" in again.facts["files"]


def test_what_cannot_be_shown_is_said(
    result: Path, tmp_path: Path, problem: Problem, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*words: str) -> str:
        assert main(["view", *words]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        return said.err

    assert "there is no some/nowhere" in refused("some/nowhere")
    assert "no motion file" in refused(str(tmp_path))
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "motion.npz").symlink_to(result / "motion.npz")
    assert "symbolic link" in refused(str(linked))
    (tmp_path / "motion.npz").write_bytes(problem.frame.read_bytes())
    assert "motion.npz" in refused(str(tmp_path))
    pytest.importorskip("viser", reason="viser is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"--port {port} cannot be had" in refused(str(result), "--port", str(port))
