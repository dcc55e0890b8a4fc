"""The commands `hfb models` and `hfb runs`. Light to import."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

from hfb.errors import InputError
from hfb.flows.runtime import summary


def add_models_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb models`.

    Args:
        parser: of the command.
    """
    parser.add_argument("action", nargs="?", choices=("list", "fetch"), default="list", help="[list]")
    parser.add_argument(
        "--from",
        "--wheel",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        dest="files",
        help="take a network, MediaPipe's wheel or npm archive that already lies here; may be given again",
    )
    parser.add_argument("--force", action="store_true", help="fetch again what is there")


def models(args: argparse.Namespace) -> None:
    """Run `hfb models`: list usable networks and files, or fetch missing ones.

    Args:
        args: the parsed options.
    """
    from hfb.networks.fetch import fetch_networks
    from hfb.networks.mediapipe_files import list_networks
    from hfb.networks.registry import list_models

    if args.out is not None:
        os.environ["HFB_MODELS_DIR"] = str(args.out)

    if args.files and args.action != "fetch":
        raise InputError("--from goes with `hfb models fetch`")
    if args.action == "fetch":
        from hfb.tasks.telemetry import displays, progress

        with progress.showing(*displays.displays_for(quiet=args.quiet)), progress.step("pose networks"):
            networks = fetch_networks(progress.say, args.files, args.force)
    else:
        networks = list_networks()
    if args.json:
        known = [model.as_dict() for model in list_models()]
        print(json.dumps({"networks": [network.as_dict() for network in networks], "models": known}))
    elif not args.quiet:
        print(summary.models_text(list_models()))


def runs(args: argparse.Namespace) -> None:
    """Run `hfb runs`: this process becomes the server of MLflow's pages.

    Args:
        args: the parsed options.
    """
    from hfb.tasks.tracking.store_place import SMALL_SERVER, pages_command

    command = pages_command(args.port)
    url = f"http://127.0.0.1:{args.port}"
    print(json.dumps({"url": url, "command": command}) if args.json else f"{url}  (Ctrl-C ends it)", flush=True)
    os.dup2(2, 1)  # the server's own lines are not results
    os.execve(command[0], command, {**os.environ, **SMALL_SERVER})
