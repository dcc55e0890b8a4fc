"""The command that makes the page of an earlier result: `hfb report`. Light to import."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hfb.flows.runtime.running import goes_to, libraries, surrounded, tell


def add_report_flags(parser: argparse.ArgumentParser) -> None:
    """Which result."""
    add = parser.add_argument
    add("source", metavar="RESULT", help="a result's folder, or the id of a recorded run")
    add("--inputs", type=Path, metavar="DIR", help="where the pictures lie, for the film, if they were moved")
    add("--body", type=Path, metavar="FILE", help="the SMPL file that was fitted [the one the result names]")


def report_result(given: argparse.Namespace) -> None:
    """Run `hfb report`."""
    with surrounded(given, given.out or goes_to(given.source), recorded=False):
        with libraries():
            from hfb.flows.report import make_report
        result = make_report(given.source, given.out, given.body, given.inputs)
    tell(given, result, report_text(result))


def report_text(result: Mapping[str, Any]) -> str:
    """Where the page is, and what it lacks."""
    size = f"{result['bytes'] / 1e6:.1f} MB"
    lacks = [f"without {name}" for name in ("film", "surface") if not result[name]]
    return f"report   {result['report']}  ({', '.join([size, *lacks])})"
