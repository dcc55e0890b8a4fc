"""Surroundings of every command: log, store, display, Prefect's server, standard output. Light to import."""

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
"""A command's computation; it calls its argument before it needs the server."""


def through_prefect(args: argparse.Namespace, out: Path, load: Callable[[], Chain]) -> dict[str, Any]:
    """Start the server, import the method meanwhile, then run the chain.

    Args:
        args: the parsed options.
        out: where the results go.
        load: imports the method and returns its chain.
    """
    with open_session(args, out):
        from hfb.tasks.telemetry import progress
        from hfb.tasks.workers.workers import begin_early

        if "workers" in args:
            begin_early(args.workers)
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

        with explain_failures(out), server.quiet():
            return chain(ready)


@contextmanager
def open_session(args: argparse.Namespace, out: Path, recorded: bool = True) -> Iterator[None]:
    """Set up a log, a writable folder, a store that answers (where one is needed), and a display inside the block.

    Args:
        args: the parsed options.
        out: where the results go.
        recorded: whether the command needs the store.
    """
    from hfb.flows.runtime.prefect_home import make_home
    from hfb.flows.runtime.server import check_api_url, keep_log
    from hfb.tasks.batch.prometheus_metrics import serve_metrics
    from hfb.tasks.results.workspace import check_writable
    from hfb.tasks.telemetry import displays, progress
    from hfb.tasks.tracking.store_place import check_store, tracking_uri

    keep_log(args.verbose)
    check_writable(out)
    check_api_url()
    if recorded:
        check_store(tracking_uri())
    remark = make_home()
    with serve_metrics(), progress.showing(*displays.displays_for(quiet=args.quiet)), results_alone_on_stdout():
        if remark:
            progress.say(f"hfb: {remark}")
        try:
            yield
        except OSError:
            from hfb.flows.runtime.failures import explain_failures

            with explain_failures(out):
                raise


def output_folder_of(source: str) -> Path:
    """Return the folder of files made from an earlier result: the result's own, or ``runs`` for a recorded run's id.

    Args:
        source: a folder, a file, or a run's id.
    """
    path = Path(source)
    return path if path.is_dir() else path.parent if path.is_file() else Path("runs")


@contextmanager
def results_alone_on_stdout() -> Iterator[None]:
    """Redirect everything printed inside the block to standard error, including by C libraries and worker processes."""
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
    """Show the imports inside the block as a step; Prefect comes first."""
    from hfb.tasks.telemetry import progress

    with progress.step("libraries"), unwatched_by_gc():
        from hfb.flows.runtime.server import load_prefect

        load_prefect()
        yield


@contextmanager
def unwatched_by_gc() -> Iterator[None]:
    """Disable garbage collection inside the block, for imports.

    Importing creates millions of objects that live as long as the process. Searching them for garbage takes a third of
    the time, and again seconds at the end.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def when_ready(work: Callable[[], dict[str, Any]]) -> Chain:
    """Return a chain that needs the server from its beginning.

    Args:
        work: runs the chain.
    """

    def chain(ready: Callable[[], None]) -> dict[str, Any]:
        ready()
        return work()

    return chain


def tell(args: argparse.Namespace, result: dict[str, Any], text: str) -> None:
    """Print the result as JSON, or as text.

    Args:
        args: the parsed options.
        result: content of the JSON.
        text: for people.
    """
    if args.json:
        print(json.dumps(hidden_in(result)))
    elif not args.quiet:
        print(without_secrets(text))


def report(
    args: argparse.Namespace, result: dict[str, Any], keys: tuple[str, ...], rows: tuple[summary.Row, ...]
) -> None:
    """Print the chosen keys as JSON, or a table of scores, times and places.

    Args:
        args: the parsed options.
        result: the content of result.json.
        keys: that --json prints.
        rows: of the table.
    """
    result = {**result, "total_seconds": round(time.perf_counter() - args.began, 3)}
    if args.json:
        print(json.dumps(hidden_in({key: result.get(key) for key in keys})))
    elif not args.quiet:
        from hfb.tasks.tracking.store_place import on_server, tracking_uri

        local = not on_server(tracking_uri())
        print(without_secrets(summary.text(result, rows, "(`hfb runs` brings this page up)" if local else None)))
