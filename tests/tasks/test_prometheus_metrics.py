"""Figures for Prometheus, scraped from a real endpoint while a real clip is made."""

import json
import os
import random
import re
import socket
import threading
from contextlib import suppress
from pathlib import Path
from urllib.request import urlopen

import pytest

from hfb.errors import InputError
from hfb.tasks.batch.prometheus_metrics import VARIABLE, serve_metrics
from hfb.tasks.telemetry import progress
from hfb.tasks.workers.workers import run_local, workers
from tests.small_clips import run_clip, small_clip


def scraped(port: int) -> dict[str, float]:
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as page:
        lines = page.read().decode().splitlines()
    return {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))}


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> int:
    """It and the next one are free, and below those that the system gives to whoever connects meanwhile."""
    for found in random.SystemRandom().sample(range(20000, 32000), 100):
        with socket.socket() as one, socket.socket() as next_one, suppress(OSError):
            one.bind(("127.0.0.1", found))
            next_one.bind(("127.0.0.1", found + 1))
            monkeypatch.setenv(VARIABLE, str(found))
            return found
    raise RuntimeError("a hundred ports are taken")


def test_a_clip(port: int, store: Path, tmp_path: Path) -> None:
    with serve_metrics():
        run_clip(small_clip().truth.parent, tmp_path / "out", truth=small_clip().truth)
        figures = scraped(port)
        with workers(2, apart=True):
            run_local(os.getpid)
            assert scraped(port)["hfb_workers_memory_bytes"] > 5e7
    assert figures["hfb_workers_memory_bytes"] == 0  # they have ended
    assert figures['hfb_done_total{step="mattes"}'] == 12
    assert figures['hfb_done_total{step="windows"}'] == 11
    assert figures['hfb_left{step="windows"}'] == 0
    assert figures['hfb_step_seconds_count{outcome="done",step="join"}'] == 1
    assert 0 < figures["hfb_workers_busy"] < 1
    assert figures["process_resident_memory_bytes"] > 1e8
    with pytest.raises(OSError, match="refused"):
        scraped(port)  # ends with the run


def test_the_dashboard_asks_for_what_is_served(port: int) -> None:
    dashboard = json.loads((Path(__file__).parents[2] / "infra/observability/grafana.json").read_text())
    asked = {
        name
        for panel in dashboard["panels"]
        for target in panel["targets"]
        for name in re.findall(r"(?:hfb|process)_\w+", target["expr"])
    }
    with serve_metrics(), progress.step("mattes"), urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as page:
        served_names = set(re.findall(r"# TYPE (\w+)", page.read().decode()))
    plain = {name.removesuffix("_sum").removesuffix("_count") for name in asked}
    assert plain <= served_names
    assert len(plain) == 9


@pytest.mark.integration
def test_gpus(port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the driver's program tells of them; there is no GPU where these tests run."""
    program = tmp_path / "nvidia-smi"
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    for told, found in (
        ("echo '0, 25, 100'; echo '1, 0, 3'", {"0": (0.25, 100.0), "1": (0.0, 3.0)}),
        ("exit 9", {}),
        ("echo '0, [N/A], 3'", {}),
    ):
        program.write_text(f"#!/bin/sh\n{told}\n")
        program.chmod(0o755)
        with serve_metrics():
            figures = scraped(port)
        busy = {name: value for name, value in figures.items() if name.startswith("hfb_gpu_busy")}
        assert busy == {f'hfb_gpu_busy{{gpu="{number}"}}': share for number, (share, _) in found.items()}
        for number, (_, megabytes) in found.items():
            assert figures[f'hfb_gpu_memory_bytes{{gpu="{number}"}}'] == megabytes * (1 << 20)


def test_failures_by_reason(port: int) -> None:
    with serve_metrics(), progress.step("mattes"):
        progress.advance(1, 3)
        progress.fail("InputError")
        progress.fail("InputError")
        figures = scraped(port)
    assert figures['hfb_failures_total{reason="InputError",step="mattes"}'] == 2
    assert (figures['hfb_done_total{step="mattes"}'], figures['hfb_left{step="mattes"}']) == (1, 2)


def test_several_at_once_take_the_next_port(port: int) -> None:
    with serve_metrics(), serve_metrics(), progress.step("both"):
        assert scraped(port)["process_resident_memory_bytes"] > 1e8
        assert scraped(port + 1)["process_resident_memory_bytes"] > 1e8


@pytest.mark.parametrize("place", ["everywhere", "0.0.0.0:", "70000", "-1"])
def test_a_place_that_is_none(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, place)
    with pytest.raises(InputError, match="is no place to serve figures: give a port"), serve_metrics():
        pass


def test_nothing_is_served_unless_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    before = threading.active_count()
    with serve_metrics():
        assert threading.active_count() == before
