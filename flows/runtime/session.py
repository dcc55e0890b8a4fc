"""Around every command: log, store, display, Prefect's server, and the result on standard output. Light to import."""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any

from hfb.flows.runtime import summary
from hfb.tasks.telemetry.secrets import hidden_in, without_secrets

Chain = Callable[[Callable[[], None]], dict[str, Any]]
"""Does the work; calls what it is given before it needs the server."""


def through_prefect(given: argparse.Namespace, out: Path, load: Callable[[], Chain]) -> dict[str, Any]:
    """Start the server, import the method while it starts, then run the chain."""
    with open_session(given, out):
        from hfb.tasks.telemetry import progress

        with libraries():
            from hfb.flows.runtime.failures import explain_failures
            from hfb.flows.runtime.server import PrefectServer
            from hfb.tasks.tracking import tracking

            server = PrefectServer()
            chain = load()
            tracking.open_store()

        def ready() -> None:
            with progress.step("Prefect's server"):
                server.wait()
            with suppress(Exception):  # tidying up after others must not stop this run
                from hfb.flows.runtime.reaper import end_abandoned_flow_runs

                end_abandoned_flow_runs()

        with explain_failures(out):
            return chain(ready)


@contextmanager
def open_session(given: argparse.Namespace, out: Path, recorded: bool = True) -> Iterator[None]:
    """A log, a folder that can be written, a store that answers (where one is needed), and a display."""
    from hfb.flows.runtime.prefect_home import make_home
    from hfb.flows.runtime.server import check_api_url, keep_log
    from hfb.flows.runtime.workspace import check_writable
    from hfb.tasks.batch.prometheus_metrics import serve_metrics
    from hfb.tasks.telemetry import displays, progress
    from hfb.tasks.tracking.store_place import check_store, tracking_uri

    keep_log(given.verbose)
    check_writable(out)
    check_api_url()
    if recorded:
        check_store(tracking_uri())
    remark = make_home()
    with serve_metrics(), progress.showing(displays.display_for(quiet=given.quiet)), results_alone_on_stdout():
        if remark:
            progress.say(f"hfb: {remark}")
        yield


def output_folder_of(source: str) -> Path:
    """The folder into which something made of an earlier result goes: the result's own; of a recorded run's id, one
    in ``runs``."""
    path = Path(source)
    return path if path.is_dir() else path.parent if path.is_file() else Path("runs")


@contextmanager
def results_alone_on_stdout() -> Iterator[None]:
    """Whatever is printed inside, by a library in C or a worker process too, goes to standard error."""
    sys.stdout.flush()
    with ExitStack() as stack:
        with suppress(OSError):  # closed, as a service may have it
            kept = os.dup(1)
            stack.callback(os.close, kept)
            os.dup2(2, 1)
            stack.callback(os.dup2, kept, 1)
        stack.enter_context(redirect_stdout(sys.stderr))
        yield


@contextmanager
def libraries() -> Iterator[None]:
    """The step in which a command imports what it needs, Prefect first."""
    from hfb.tasks.telemetry import progress

    with progress.step("libraries"), unwatched_by_gc():
        from hfb.flows.runtime.server import load_prefect

        load_prefect()
        yield


@contextmanager
def unwatched_by_gc() -> Iterator[None]:
    """Importing makes millions of objects that live as long as the process.

    Python would search them for garbage while they come, a third of the time, and once more at the end: seconds.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def when_ready(work: Callable[[], dict[str, Any]]) -> Chain:
    """A chain that needs the server from its beginning."""

    def chain(ready: Callable[[], None]) -> dict[str, Any]:
        ready()
        return work()

    return chain


def tell(given: argparse.Namespace, result: dict[str, Any], text: str) -> None:
    """The result as JSON, or in words."""
    if given.json:
        print(json.dumps(hidden_in(result)))
    elif not given.quiet:
        print(without_secrets(text))


def report(
    given: argparse.Namespace, result: dict[str, Any], keys: tuple[str, ...], rows: tuple[summary.Row, ...]
) -> None:
    """The chosen keys as JSON, or a table of scores, times and places.

    Args:
        given: the command's arguments.
        result: the content of result.json.
        keys: that --json prints.
        rows: of the table.
    """
    result = {**result, "total_seconds": round(time.perf_counter() - given.began, 3)}
    if given.json:
        print(json.dumps(hidden_in({key: result.get(key) for key in keys})))
    elif not given.quiet:
        from hfb.tasks.tracking.store_place import on_server, tracking_uri

        local = not on_server(tracking_uri())
        print(without_secrets(summary.text(result, rows, "(`hfb runs` brings this page up)" if local else None)))
