"""`hfb record`: put a finished result into MLflow that could not be recorded when it was made. Light to import."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hfb.flows.runtime.running import libraries, surrounded, tell


def add_record_flags(parser: argparse.ArgumentParser) -> None:
    """Which result."""
    parser.add_argument("source", type=Path, metavar="RESULT", help="the folder of a finished result")


def record_result(given: argparse.Namespace) -> None:
    """Run `hfb record`."""
    with surrounded(given, given.source):
        with libraries():
            from hfb.flows.record import record_folder
            from hfb.tasks.tracking import tracking

            tracking.open_store()
        result = record_folder(given.source)
    tell(given, result, record_text(result))


def record_text(result: Mapping[str, Any]) -> str:
    """What became of each run."""
    return "\n".join(
        f"{'recorded' if one['new'] else 'recorded already'}  {one['out']}\nMLflow    {one['mlflow_link']}"
        for one in result["runs"]
    )
