"""The command `hfb app`. Light to import."""

from __future__ import annotations

import argparse
import json
import secrets
import socket
import sys
from contextlib import suppress
from pathlib import Path

from hfb.errors import InputError
from hfb.flows.cli.options import CONFIG_PREFIX, run_config

HOST = "127.0.0.1"
_LARGEST_PORT = 65535


def app(args: argparse.Namespace) -> None:
    """Run `hfb app`: serve the page on this machine alone, until Ctrl-C.

    Args:
        args: the parsed options.
    """
    from hfb.tasks.results.workspace import check_writable

    config, out = run_config(args), (args.out or Path("runs") / "app").absolute()
    check_writable(out)
    with listen(args.port) as listening:
        import uvicorn

        from hfb.flows.app.jobs import Jobs
        from hfb.flows.app.site import site

        jobs = Jobs(out, _base_words(args))
        try:
            port, key = listening.getsockname()[1], secrets.token_urlsafe(24)
            url = f"http://{HOST}:{port}/{key}/"
            served = uvicorn.Config(
                site(jobs, config, key, port),
                log_level="warning",
                access_log=False,
                server_header=False,
                limit_concurrency=64,
                ws="none",
                timeout_graceful_shutdown=3,
            )
            print(json.dumps({"url": url, "out": str(out)}) if args.json else f"{url}  (Ctrl-C ends it)", flush=True)
            with suppress(KeyboardInterrupt):
                uvicorn.Server(served).run(sockets=[listening])
            print("hfb: ending", file=sys.stderr)
        finally:
            jobs.close()


def listen(port: int) -> socket.socket:
    """Return a socket that listens on this machine alone.

    Args:
        port: 0 for any that is free.

    Raises:
        InputError: it is no port, or somebody has it.
    """
    if not 0 <= port <= _LARGEST_PORT:
        raise InputError(f"--port {port} is no port: give one up to {_LARGEST_PORT}, or 0 for any")
    listening = socket.socket()
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((HOST, port))
        listening.listen()  # who follows the printed address at once waits for the page, and is not refused
    except OSError as error:
        listening.close()
        raise InputError(f"--port {port} cannot be had ({error.strerror}): give another one, or 0 for any") from None
    return listening


def _base_words(args: argparse.Namespace) -> list[str]:
    """Return the words that repeat the options given to this command."""
    given = {key: value for key, value in vars(args).items() if key.startswith(CONFIG_PREFIX)}
    words = [f"--{key.removeprefix(CONFIG_PREFIX)}={value}" for key, value in given.items()]
    words += [f"--weights={args.weights}"] if "weights" in args else []
    return words + ([f"--config={args.config.absolute()}"] if args.config else [])
