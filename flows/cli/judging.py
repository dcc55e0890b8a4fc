"""The commands `hfb synth`, `hfb benchmark` and `hfb reproduce`. Light to import."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hfb.config import OWN_NETWORKS, InitConfig
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.set_spec import SetSpec
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import METHOD_NAMES, MethodSpec, method_spec
from hfb.flows.runtime.summary import figure_text
from hfb.io.toml_file import to_record

if TYPE_CHECKING:
    from hfb.flows.benchmark import BenchmarkPlan

SETS = ("bt-amass", "bc-cape", "b-aist", "real")
_REAL = ("b-aist", "real")
_DEFAULT_METHODS = "best,paper,static"
_REAL_METHODS = "static,best,oracle-middle,best@true-front,best@true-start,oracle-floor"
_REAL_AVERAGES = (1, 3, 5, 9, 15)
_DEFAULT_COUNT = 20


def add_set_flags(parser: argparse.ArgumentParser, count: int | None = _DEFAULT_COUNT) -> None:
    """Declare what a set is made from; hfb's own data replace folders that are not given.

    Args:
        parser: of the command.
        count: default number of cases; None for the experiment's.
    """
    add = parser.add_argument
    shown = "as in the experiment's file" if count is None else str(count)
    add("--count", type=positive, default=count, metavar="N", help=f"how many cases [{shown}]")
    add("--seed", type=partial(_at_least, least=0), default=0, metavar="S", help="of everything that is random [0]")
    add("--motions", type=Path, metavar="DIR", help="AMASS, BVH, DeepMimic, CAPE or hfb's own motion files [built in]")
    add("--backgrounds", type=Path, metavar="DIR", help="pictures to stand in front of [generated rooms]")
    add("--textures", type=Path, metavar="DIR", help="textures for the body's UV map [generated clothes]")
    add(
        "--videos",
        type=Path,
        action="append",
        metavar="DIR",
        help="real, b-aist: videos of a static camera, with measured joints where there are any; may be repeated",
    )
    add(
        "--average",
        type=_averages,
        metavar="K,...",
        help="real, b-aist: frames per exposure, 1 for sharp ones; the cases take turns [b-aist: 9; real: "
        f"{','.join(map(str, _REAL_AVERAGES))}]",
    )
    add("--body", type=Path, metavar="FILE", help="your SMPL file, for the truth and the fit [the embedded body]")
    add("--fill", choices=("paper", "even", "natural"), default="paper", help="cases per blur-rate interval [paper]")
    add("--size", type=positive, metavar="PX", help="side of the pictures; real: the longer one [256; real: 384]")
    add("--easy", action="store_true", help="the fit's own mesh, no noise: for finding errors, never to be quoted")
    add_worker_flags(parser)


def add_worker_flags(parser: argparse.ArgumentParser) -> None:
    """Declare where computations run.

    Args:
        parser: of the command.
    """
    parser.add_argument(
        "--workers",
        default=str(cores()),
        metavar="N|dask:ADDRESS|ray:ADDRESS",
        help="processes, threads:N, or a cluster's workers; changes no digit [all cores]",
    )
    parser.add_argument(
        "--store",
        metavar="URL",
        help="with a cluster whose workers do not see this machine's files: where they are shared, s3://bucket/prefix",
    )


def add_method_flags(parser: argparse.ArgumentParser, of_set: bool = True) -> None:
    """Declare the methods and their starts.

    Args:
        parser: of the command.
        of_set: the default methods are those of the set; False: those of the experiment.
    """
    known = "; ".join(f"{name}: {what}" for name, what in METHOD_NAMES.items()).replace("%", "%%")
    shown = f"{_DEFAULT_METHODS}; real: {_REAL_METHODS}" if of_set else "as in the experiment's file"
    parser.add_argument("--methods", metavar="A,B,...", help=f"{known} [{shown}]")
    parser.add_argument("--chains", type=Path, metavar="FILE.toml", help="deblur-then-estimate chains, by name")
    parser.add_argument(
        "--start",
        choices=("simulated", "estimated"),
        help="what all methods start from: simulated after the paper's METRO, or hfb's estimators "
        "[simulated; real: estimated]",
    )
    parser.add_argument(
        "--init",
        choices=("auto", "mediapipe", "matte", *OWN_NETWORKS),
        help="how starts are estimated, as of `hfb fit`; with it --start is estimated [auto]",
    )
    parser.add_argument("--init-weights", type=Path, metavar="FILE", help="of a network that --init names")


def set_spec(args: argparse.Namespace, frames: int) -> SetSpec | RealSpec:
    """Return the set that the options describe.

    Args:
        args: the parsed options.
        frames: blurred frames per case.

    Raises:
        InputError: a set of real video without videos, or a number that no set takes.
    """
    size = {} if args.size is None else {"size_px": args.size}
    if args.set in _REAL:
        if not args.videos:
            raise InputError(f"{args.set} is made from real video: give a folder with --videos DIR")
        average = args.average or (_REAL_AVERAGES if args.set == "real" else (9,))
        content = {"set": args.set, "videos": args.videos, "average": average} | size
        return to_record(RealSpec, content | {"frames": frames, "seed": args.seed}, "options")
    names = ("set", "seed", "fill", "easy", "motions", "backgrounds", "textures", "body")
    content = {name: getattr(args, name) for name in names}
    return to_record(SetSpec, content | size | {"frames": frames}, "options")


def method_specs(text: str, chains: Path | None) -> tuple[MethodSpec, ...]:
    """Parse a comma-separated list of methods, each once.

    Args:
        text: the list.
        chains: a file of deblur-then-estimate chains; None for none.

    Raises:
        InputError: an unknown name; the sentence lists the known ones.
    """
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise InputError("--methods names no method")
    return tuple(method_spec(name, chains) for name in names)


def methods_of(args: argparse.Namespace) -> tuple[MethodSpec, ...]:
    """Return the methods that the options name, or those of the set.

    Args:
        args: the parsed options.

    Raises:
        InputError: an unknown name; the sentence lists the known ones.
    """
    suitable = _REAL_METHODS if args.set == "real" else _DEFAULT_METHODS
    return method_specs(suitable if args.methods is None else args.methods, args.chains)


def plan_of(args: argparse.Namespace, frames: int) -> BenchmarkPlan:
    """Return everything that decides a benchmark's figures.

    Args:
        args: the parsed options.
        frames: blurred frames per case.
    """
    from hfb.flows.benchmark import BenchmarkPlan

    init = InitConfig(method=args.init or "auto", weights=args.init_weights)
    estimated = args.init is not None or args.init_weights is not None
    if args.start == "simulated" and estimated:
        raise InputError("--init and --init-weights are for estimated starts: leave --start simulated out")
    return BenchmarkPlan(
        spec=set_spec(args, frames),
        count=args.count,
        methods=methods_of(args),
        start=args.start or ("estimated" if estimated or args.set in _REAL else "simulated"),
        init=init,
        body=args.body,
    )


def benchmark_text(result: Mapping[str, Any]) -> str:
    """Return the table printed at the end of a benchmark.

    Args:
        result: content of result.json.
    """
    lines = ["", f"{'method':<24}{'n':>5}{'start':>9}{'fitted':>9}{'ratio':>8}   {'95 %':<14}{'IoU':>6}{'better':>8}"]
    for name, cells in result["methods"].items():
        cell = cells["all"]
        interval = cell["ratio_ci95"]
        low_high = f"[{interval[0]:.2f}, {interval[1]:.2f}]" if interval else "-"
        of = cell["n_pose"] if interval else cell["n"]
        share, iou = figure_text(cell["better_than_start"], ".0%"), figure_text(cell["iou"], ".3f")
        numbers = ((cell["initial_mpjpe_mm"], ".1f", 9), (cell["mpjpe_mm"], ".1f", 9), (cell["ratio"], ".3f", 8))
        text = "".join(f"{figure_text(value, form):>{width}}" for value, form, width in numbers)
        lines.append(f"{name:<24}{of:>5}{text}   {low_high:<14}{iou:>6}{share:>8}")
    lines += ["", f"cases    {result['count']} ({result['skipped']} left out)", f"page     {result['page']}"]
    lines += [f"result   {result['out']}"]
    if result.get("mlflow_link"):
        lines.append(f"MLflow   {result['mlflow_link']}")
    return "\n".join(lines)


def positive(text: str) -> int:
    """Parse an option that is a whole number of 1 or more.

    Args:
        text: as typed.
    """
    return _at_least(text, 1)


def _averages(text: str) -> tuple[int, ...]:
    """Parse whole numbers, 1 or more, separated by commas."""
    return tuple(positive(one) for one in text.split(",") if one.strip()) or (positive(text),)


def _at_least(text: str, least: int) -> int:
    try:
        number = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None
    if number < least:
        raise argparse.ArgumentTypeError(f"must be {least} or more, not {number}")
    return number


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
