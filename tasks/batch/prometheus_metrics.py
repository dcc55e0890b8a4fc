"""Metrics for Prometheus: progress, duration of each step, failures and their reasons.

Served at HFB_METRICS (``9464``, or ``0.0.0.0:9464``) by the process that runs the flow; further processes on one
machine take the following ports. Nothing is served otherwise. infra/observability holds a scrape configuration and a
Grafana dashboard.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hfb.errors import InputError
from hfb.tasks.telemetry import progress
from hfb.tasks.telemetry.progress import Listener, Shown

if TYPE_CHECKING:
    from wsgiref.simple_server import WSGIServer

    from prometheus_client import CollectorRegistry
    from prometheus_client.core import GaugeMetricFamily

VARIABLE = "HFB_METRICS"
_THIS_MACHINE = "127.0.0.1"
_NEIGHBOURS = 16
_PORTS_END = 65536
_PATIENCE_S = 3.0


class Metrics(Listener):
    """Counts the progress of tasks."""

    def __init__(self, registry: CollectorRegistry) -> None:
        """Register the metrics.

        Args:
            registry: of Prometheus' client.
        """
        from prometheus_client import Counter, Gauge, Histogram

        self._done = Counter("hfb_done", "frames, windows or cases that a step has done", ["step"], registry=registry)
        self._left = Gauge("hfb_left", "of the running step, how many are not done yet", ["step"], registry=registry)
        self._failed = Counter("hfb_failures", "what failed, by reason", ["step", "reason"], registry=registry)
        self._seconds = Histogram(
            "hfb_step_seconds", "how long a step took", ["step", "outcome"], registry=registry,
            buckets=(0.1, 1, 3, 10, 30, 100, 300, 1000, 3000, 10_000),
        )  # fmt: skip
        self._busy = Gauge("hfb_workers_busy", "share of the workers' time in which they compute", registry=registry)
        self._counted: dict[Shown, int] = {}
        self._lock = threading.Lock()

    def begin(self, shown: Shown) -> None:
        """Start counting a step.

        Args:
            shown: the step.
        """
        with self._lock:
            self._counted[shown] = 0

    def update(self, shown: Shown) -> None:
        """Count finished inputs of a step over many inputs.

        Args:
            shown: the step.
        """
        if shown.total is None:
            return
        with self._lock:
            new, self._counted[shown] = shown.done - self._counted.get(shown, 0), shown.done
        if new > 0:
            self._done.labels(shown.label).inc(new)
        self._left.labels(shown.label).set(shown.total - shown.done)

    def end(self, shown: Shown, failed: bool) -> None:
        """Record duration and outcome of a step.

        Args:
            shown: the step.
            failed: whether it raised.
        """
        from hfb.tasks.workers.workers import busy_share

        with self._lock:
            self._counted.pop(shown, None)
        outcome = "failed" if failed else "reused" if shown.reused else "done"
        self._seconds.labels(shown.label, outcome).observe(shown.seconds)
        if shown.total is not None:
            self._left.labels(shown.label).set(0)
        if (share := busy_share()) is not None:
            self._busy.set(share)

    def fail(self, step: str, reason: str) -> None:
        """Count a failed input.

        Args:
            step: label of the step.
            reason: kind of the failure.
        """
        self._failed.labels(step, reason).inc()


@contextmanager
def serve_metrics() -> Iterator[None]:
    """Serve metrics inside the block where HFB_METRICS gives an address.

    Raises:
        InputError: HFB_METRICS is no address.
    """
    place = os.environ.get(VARIABLE, "")
    if not place:
        yield
        return
    from prometheus_client import CollectorRegistry, GCCollector, PlatformCollector, ProcessCollector

    host, _, port = place.rpartition(":")
    registry = CollectorRegistry()
    for collect in (ProcessCollector, PlatformCollector, GCCollector):
        collect(registry=registry)
    registry.register(_Machine())
    started = _started(host or _THIS_MACHINE, int(port) if port.isdecimal() else -1, registry)
    try:
        with progress.add_listener(Metrics(registry)):
            yield
    finally:
        if started is not None:
            server, thread = started
            server.shutdown()
            server.server_close()
            thread.join()


def _started(host: str, first: int, registry: CollectorRegistry) -> tuple[WSGIServer, threading.Thread] | None:
    """Start the server on the first free port; None, with a line for the user, where there is none."""
    from prometheus_client import start_http_server

    if not 0 < first < _PORTS_END - _NEIGHBOURS:
        raise InputError(f"{VARIABLE}={os.environ[VARIABLE]} is no place to serve figures: give a port, such as 9464")
    for port in range(first, first + _NEIGHBOURS):
        try:
            return start_http_server(port, host, registry)
        except OSError as error:
            reason = error
    progress.say(f"hfb: no figures are served: {host}, ports {first} to {first + _NEIGHBOURS - 1}: {reason}")
    return None


class _Machine:
    """Memory of the worker processes and load of GPUs, read at every scrape."""

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the metrics."""
        from prometheus_client.core import GaugeMetricFamily

        memory = GaugeMetricFamily("hfb_workers_memory_bytes", "memory of the worker processes of this machine")
        memory.add_metric([], float(sum(map(_resident_bytes, multiprocessing.active_children()))))
        yield memory
        held = GaugeMetricFamily("hfb_gpu_memory_bytes", "memory of a GPU that is taken", labels=["gpu"])
        busy = GaugeMetricFamily("hfb_gpu_busy", "share of the time in which a GPU works", labels=["gpu"])
        for number, share, bytes_ in _gpus():
            held.add_metric([number], bytes_)
            busy.add_metric([number], share)
        yield held
        yield busy


def _resident_bytes(process: multiprocessing.process.BaseProcess) -> int:
    try:
        return int(Path(f"/proc/{process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):  # it has ended, or this is no Linux
        return 0


def _gpus() -> list[tuple[str, float, float]]:
    """Return (number, utilisation, bytes in use) of every GPU; empty without a driver."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return []
    query = ["--query-gpu=index,utilization.gpu,memory.used", "--format=csv,noheader,nounits"]
    try:
        told = subprocess.run([program, *query], capture_output=True, text=True, timeout=_PATIENCE_S, check=True).stdout
        rows = [line.split(",") for line in told.splitlines()]
        return [(number.strip(), float(percent) / 100, float(mb) * (1 << 20)) for number, percent, mb in rows]
    except (OSError, subprocess.SubprocessError, ValueError):  # a figure that is missing ends no run
        return []
