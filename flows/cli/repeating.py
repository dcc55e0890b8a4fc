"""The commands `hfb rerun` and `hfb compare`. Light to import."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hfb.errors import InputError
from hfb.flows.cli.judging import cores, positive
from hfb.flows.runtime.session import Chain, libraries, open_session, tell, through_prefect, when_ready
from hfb.flows.runtime.summary import number_text

DIFFERS = 3
"""Exit code: the repeated run has a different result."""

_RUN = "a run's id, the beginning of it, or the folder of its result"
_SHOWN_OPTIONS = 30
_SHOWN_FIGURES = ("eval/", "rerun/", "time/", "loss/total")
_WIDTH, _NARROWEST, _WIDEST = 34, 14, 60


def add_rerun_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb rerun`.

    Args:
        parser: of the command.
    """
    parser.add_argument("run_id", metavar="RUN_ID", help=_RUN)
    parser.add_argument(
        "--inputs", type=Path, metavar="DIR", help="where inputs lie that were moved; they are told by their content"
    )
    parser.add_argument(
        "--workers", type=positive, default=cores(), metavar="K", help="processes; changes no digit [all cores]"
    )
    parser.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option that held a secret, which the record hides, as in init.person=VALUE; may be repeated",
    )


def add_compare_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb compare`.

    Args:
        parser: of the command.
    """
    parser.add_argument("run_a", metavar="RUN_A", help=_RUN)
    parser.add_argument("run_b", metavar="RUN_B", help="another one")
    parser.add_argument("more", nargs="*", metavar="RUN_C", help="and others")


def rerun(args: argparse.Namespace) -> int:
    """Run `hfb rerun`; returns the exit code.

    Args:
        args: the parsed options.
    """
    if args.seed is not None:
        raise InputError("a repetition keeps its run's seed: leave --seed out")
    options = _named(args.option)

    def load() -> Chain:
        from hfb.flows.rerun import plan_rerun, repeat

        plan = plan_rerun(args.run_id, args.inputs, args.out, workers=args.workers, options=options)
        return when_ready(lambda: repeat(plan))

    verdict = through_prefect(args, args.out or Path("runs"), load)
    tell(args, verdict, rerun_text(verdict))
    return 0 if verdict["bit_equal"] else DIFFERS


def _named(options: Sequence[str]) -> dict[str, str]:
    """Parse NAME=VALUE into a mapping; names may also be written as flags."""
    for option in options:
        if not option.partition("=")[1]:
            raise InputError("--option takes NAME=VALUE, as in --option init.person=VALUE")
    split = (option.partition("=") for option in options)
    return {name.removeprefix("--").replace("-", "_"): value for name, _, value in split}


def compare(args: argparse.Namespace) -> None:
    """Run `hfb compare`.

    Args:
        args: the parsed options.
    """
    with open_session(args, args.out or Path("runs")):
        with libraries():
            from hfb.flows.compare import compare_runs
        result = compare_runs((args.run_a, args.run_b, *args.more), args.out)
    tell(args, result, compare_text(result))


def rerun_text(verdict: Mapping[str, Any]) -> str:
    """Return the lines printed at the end of `hfb rerun`.

    Args:
        verdict: content of rerun.json.
    """
    lines = ["", _sentence(verdict)]
    if verdict["changed"]:
        lines.append("not as it was then: " + "; ".join(verdict["changed"]))
    others = [name for name in verdict["files_that_differ"] if verdict["bit_equal"]]
    if others:
        lines.append(f"other files differ: {', '.join(others)}")
    return "\n".join([*lines, "", f"seconds  {verdict['seconds']:.1f}", f"result   {verdict['out']}"])


def compare_text(comparison: Mapping[str, Any]) -> str:
    """Return the tables printed at the end of `hfb compare`.

    Args:
        comparison: content of comparison.json.
    """
    width = max(_NARROWEST, _WIDEST // len(comparison["names"]))
    lines = ["", *comparison["sentences"], "", _row("", comparison["names"], width)]
    for title, entry in (("options", "config"), ("machine and versions", "environment")):
        rows = comparison[entry]
        lines.append(f"{title}: {f'{len(rows)} differ' if rows else 'the same'}")
        for row in rows[:_SHOWN_OPTIONS]:
            words = ["-" if value is None else value for value in _values(row)]
            lines.append(_row(f"  {row['name']}", words, width))
    lines.append("figures")
    for row in comparison["metrics"]:
        if row["name"].startswith(_SHOWN_FIGURES):
            lines.append(_row(f"  {row['name']}", [number_text(value) for value in _values(row)], width))
    picture = [f"picture  {comparison['picture']}"] if comparison["picture"] else []
    return "\n".join([*lines, "", f"page     {comparison['page']}", *picture])


def _values(row: Mapping[str, Any]) -> list[Any]:
    """Return the values of all runs."""
    return [row["a"], row["b"], *row.get("more", [])]


def _sentence(verdict: Mapping[str, Any]) -> str:
    run = verdict["run_id"][:8]
    if verdict["bit_equal"]:
        return f"The same motion as run {run}, bit for bit."
    if verdict["mean_mm"] is None:
        return f"Not the same motion as run {run}; how far it is cannot be told, since the recorded one is gone."
    far = f"{number_text(verdict['mean_mm'])} mm on average and {number_text(verdict['max_mm'])} mm at most"
    why = (
        "though machine and versions are the same: that should not be, please report it"
        if verdict["same_environment"]
        else "as is to be expected where something else computes"
    )
    return f"The joints are {far} from those of run {run}, {why}."


def _row(name: str, words: Sequence[str], width: int) -> str:
    cells = (word if len(word) <= width else word[: width - 3] + "..." for word in words)
    return f"{name:<{_WIDTH}} {'  '.join(f'{cell:<{width}}' for cell in cells)}".rstrip()
