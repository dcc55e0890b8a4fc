"""Command-line options shared by several training programs, and their types."""

import argparse
from pathlib import Path

SPLITS = ("train", "dev", "dev-other", "all", "report")
_NO_END = 1e9


def folder(text: str) -> Path:
    """Parse an option that names an existing folder.

    Args:
        text: as typed.
    """
    if not Path(text).is_dir():
        raise argparse.ArgumentTypeError(f"{text} is no folder")
    return Path(text)


def file(text: str) -> Path:
    """Parse an option that names an existing file.

    Args:
        text: as typed.
    """
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"{text} is no file")
    return Path(text)


def count(text: str) -> int:
    """Parse an option that is a whole number of 1 or more.

    Args:
        text: as typed.
    """
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number of 1 or more")
    return int(text)


def add_drawing_flags(parser: argparse.ArgumentParser, number: int = 1000, backgrounds: bool = True) -> None:
    """Declare what people are drawn from, how many, and where to.

    Args:
        parser: of the program.
        number: default of how many.
        backgrounds: whether images are drawn, which need photographs and a size.
    """
    add = parser.add_argument
    add("--mocap", type=folder, required=True, metavar="DIR", help="clips as BVH files, cmu_SUBJECT_TRIAL*.bvh")
    if backgrounds:
        add("--backgrounds", type=folder, required=True, metavar="DIR", help="with polyhaven, budgie and textures")
        add("--frame-px", type=count, default=256, metavar="PX", help="width of a frame [256]")
    add("--out", type=Path, required=True, help="where the result goes")
    add("--count", type=count, default=number, metavar="N", help=f"[{number}]")
    add("--seed", type=int, default=1, metavar="S", help="of everything that is random [1]")
    add("--split", default="train", choices=SPLITS, help="which motions [train]")


def add_schedule_flags(parser: argparse.ArgumentParser, iterations: int, batch: int, rate: float, seed: int) -> None:
    """Declare duration, learning rate, seed, threads and starting weights of a training.

    Args:
        parser: of the program.
        iterations: default.
        batch: default.
        rate: default learning rate.
        seed: default.
    """
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="DIR", help="folder for weights and facts")
    add("--iterations", type=count, default=iterations, metavar="N", help=f"[{iterations}]")
    add("--minutes", type=float, default=_NO_END, help="shorten the schedule so that it ends by then")
    add("--batch", type=count, default=batch, metavar="N", help=f"[{batch}]")
    add("--rate", type=float, default=rate, help=f"learning rate at its highest [{rate}]")
    add("--seed", type=int, default=seed, metavar="S", help=f"of everything that is random [{seed}]")
    add("--threads", type=count, default=1, metavar="N", help="[1]")
    add("--device", choices=("cpu", "cuda"), default="cpu", help="[cpu]")
    add("--bfloat16", "--half", action="store_true", help="multiply in bfloat16: slow where processors lack it")
    add("--go-on", type=file, metavar="FILE", help="begin with these weights (.safetensors or .pt)")
