"""The commands `hfb train NAME` and `hfb train-prior`. Light to import."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hfb.io.toml_file import to_record
from hfb.training.priors.training_spec import MotionTraining, PoseTraining
from hfb.training.programs import PRIORS, PROGRAMS

if TYPE_CHECKING:
    from hfb.flows.train_prior import TrainingPlan

DEFAULT_OUT = {"motion": Path("runs/motion_prior.safetensors"), "pose": Path("runs/pose_prior.safetensors")}


def add_training_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb train-prior`.

    Args:
        parser: of the command.
    """
    add = parser.add_argument
    epochs = f"{MotionTraining().epochs}; of a pose prior {PoseTraining().epochs} at most"
    add(
        "--motions",
        type=Path,
        required=True,
        metavar="DIR",
        help="AMASS, BVH, DeepMimic, CAPE or hfb's own motion files",
    )
    add("--kind", choices=("motion", "pose"), default="motion", help="how people move, or how they stand [motion]")
    add("--epochs", type=int, metavar="N", help=f"passes over the data [{epochs}]")
    add("--seed", type=int, default=0, metavar="S", help="of everything that is random [0]")
    add(
        "--test",
        nargs="+",
        default=[],
        metavar="PATTERN",
        help="names of motions, such as 'cmu_09_*', that are only measured on, at the very end",
    )
    add(
        "--held-out",
        nargs="+",
        default=[],
        metavar="PATTERN",
        help="names that are measured on for choosing, a person or another studio [every fourth motion]",
    )


def add_program_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the program of `hfb train`; its own options follow its name.

    Args:
        parser: of the command.
    """
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    listed = {name: entry.summary for name, entry in PROGRAMS.items()} | PRIORS
    parser.epilog = "\n".join(["programs:", *(f"  {name:<16} {summary}" for name, summary in listed.items())])
    parser.add_argument(
        "name", choices=tuple(listed), metavar="NAME", help="one of the programs below; NAME --help has more"
    )
    parser.add_argument("options", nargs=argparse.REMAINDER, metavar="OPTION", help="options of the program")


def run_program(args: argparse.Namespace) -> None:
    """Run a program of `hfb.training` with its own options.

    Args:
        args: the parsed options.
    """
    program = PROGRAMS[args.name].load()
    summary = PROGRAMS[args.name].summary
    parser = type(args.command)(f"hfb train {args.name}", description=summary)
    program.add_flags(parser)
    program.run(parser.parse_args(args.options))


def plan_of(args: argparse.Namespace) -> TrainingPlan:
    """Return the plan that the options describe.

    Args:
        args: the parsed options.

    Raises:
        InputError: a number that no training takes.
    """
    from hfb.flows.train_prior import TrainingPlan

    content: dict[str, Any] = {"motions": args.motions, "kind": args.kind, "seed": args.seed}
    content |= {"tests": args.test, "held_out": args.held_out}
    if args.epochs is not None:
        content[args.kind] = {"epochs": args.epochs}
    return to_record(TrainingPlan, content, "options")


def training_text(result: Mapping[str, Any]) -> str:
    """Return the lines printed at the end of a training.

    Args:
        result: as `hfb.flows.train_prior.train_prior` returns it.
    """
    data = result["data"]
    counts = ", ".join(f"{len(data[part])} {words}" for part, words in _PARTS.items() if data[part])
    lines = ["", f"motions  {counts}" + (f" ({len(data['refused'])} left out)" if data["refused"] else "")]
    for part, words in _PARTS.items():
        found = result["measures"].get(part)
        if found:
            told = [
                f"{label} {found['all'][name]:{form}}"
                for name, (label, form) in _SHOWN.items()
                if found["all"].get(name) is not None
            ]
            lines.append(f"{words:<14}{', '.join(told)}")
    lines += [f"training {result['training_seconds']:.0f} s", f"result   {result['out']}"]
    if result.get("mlflow_link"):
        lines.append(f"MLflow   {result['mlflow_link']}")
    return "\n".join(lines)


_PARTS = {"trained": "learned from", "held_out": "held out", "tested": "tested"}
_SHOWN = {
    "whole_body": ("direction known: whole body", ".0%"),
    "joint": ("joints", ".0%"),
    "prior_at_50": ("prior's median", ".1f"),
    "prior_at_95": ("at 95 %", ".1f"),
}
