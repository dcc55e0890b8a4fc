"""The commands `hfb video` and `hfb batch`. Light to import."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hfb.errors import InputError
from hfb.flows.cli.judging import add_worker_flags, positive
from hfb.flows.cli.options import run_config
from hfb.flows.runtime.session import Chain, open_session, tell, through_prefect, when_ready
from hfb.flows.runtime.summary import figure_text
from hfb.tasks.batch.notifications import FORMS, VARIABLE, addresses_of, enable_notifications
from hfb.tasks.inputs.out_place import check_batch_out, default_out
from hfb.tasks.workers.engine import engine_of

VIDEO_KEYS = (
    "frames",
    "sub_frames",
    "gaps",
    "filled",
    "seconds",
    "total_seconds",
    "out",
    "strip",
    "report",
    "mlflow_run_id",
    "resumed_frames",
    "matte_iou",
    "psnr_db",
    "foot_skate_mm",
    "world",
    "mpjpe_mm",
    "worst_jump_mm",
    "worst_velocity_share",
    "workers_busy",
    "people",
)
_OF_A_SYNTHETIC_CLIP = ("--mp4", "--frames", "--seed", "--size", "--out", "--json", "--quiet", "--verbose")
_PLACES = (("strip", "strip"), ("report", "report"), ("result", "out"))


def add_video_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb video`.

    Args:
        parser: of the command.
    """
    add = parser.add_argument
    add("source", type=Path, metavar="CLIP", help="a video, a folder of its frames, or a folder with a clip.toml")
    add(
        "--background",
        metavar="PLATE|median|still",
        help="a picture of the view without the person, the median over time, or the longest stretch in which nobody "
        "moves [what clip.toml says, a background.png or plate.png beside the clip, median]",
    )
    add("--clip", type=Path, metavar="clip.toml", help="camera, exposure, time range, person [the folder's own]")
    add("--everyone", action="store_true", help="each person who is seen, one after the other, into DIR/person-1 ...")
    add("--truth", type=Path, metavar="FILE", help="a motion file of what really happened: adds errors against it")
    _add_shared_flags(parser)


def add_batch_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb batch`.

    Args:
        parser: of the command.
    """
    add = parser.add_argument
    add("folder", type=Path, metavar="FOLDER", help="clips: NAME.mp4 with NAME.toml, folders NAME/ with a clip.toml")
    add("--attempts", type=positive, default=3, metavar="N", help="failures after which a clip is set aside [3]")
    add("--wait", type=positive, default=60, metavar="S", help="before a second attempt, doubled for each further [60]")
    add("--watch", type=positive, metavar="S", help="keep looking for new clips, so often")
    add("--again", action="store_true", help="take clips that were set aside once more")
    add(
        "--notify",
        action="append",
        default=[],
        metavar="URL",
        help=f"tell of clips that fail: {FORMS}; several times for several; also from the variable {VARIABLE}",
    )
    _add_shared_flags(parser)


def _add_shared_flags(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--window", metavar="K", dest="config:video.window", default=argparse.SUPPRESS, help="as --video.window")
    add("--average", metavar="K", dest="config:video.average", default=argparse.SUPPRESS, help="as --video.average")
    add_worker_flags(parser)


def video(args: argparse.Namespace) -> None:
    """Run `hfb video`.

    Args:
        args: the parsed options.
    """
    from hfb.tasks.inputs.video_inputs import take_video_inputs

    config, engine = run_config(args), engine_of(args.workers, args.store)
    out = args.out or default_out(args.source)
    inputs = take_video_inputs(
        args.source, config, args.clip, args.background, truth=args.truth, everyone=args.everyone, out=out
    )

    def load() -> Chain:
        from hfb.flows.everyone import run_clip

        return when_ready(lambda: run_clip(inputs, out, config, engine))

    result = through_prefect(args, out, load)
    result["total_seconds"] = round(time.perf_counter() - args.began, 3)
    shown = {key: result.get(key) for key in VIDEO_KEYS} if args.json else result
    tell(args, shown, "" if args.json else video_text(result))


def batch(args: argparse.Namespace) -> int:
    """Run `hfb batch`; returns 1 where a clip has no result, as for other failures.

    Args:
        args: the parsed options.
    """
    from hfb.tasks.inputs.clip_places import find_clips

    config = run_config(args)
    engine_of(args.workers, args.store)  # what is wrong with it is said at once
    out = args.out or default_out(args.folder)
    check_batch_out(args.folder, out)
    find_clips(args.folder, out)  # a folder that is none is said at once
    addresses = addresses_of(args.notify)

    def load() -> Chain:
        from hfb.flows.batch import batch as every_clip

        options = config.model_dump(mode="json")
        return when_ready(
            lambda: every_clip(
                args.folder,
                out,
                options,
                workers=args.workers,
                attempts=args.attempts,
                wait_s=args.wait,
                watch_s=args.watch,
                again=args.again,
                store=args.store,
            )
        )

    with enable_notifications(addresses):
        result = through_prefect(args, out, load)
    tell(args, result, batch_text(result))
    return int(result["done"] < result["clips"])


def synth_clip(args: argparse.Namespace) -> None:
    """Run `hfb synth clip`: write a blurred clip of a built-in motion, its plate, clip.toml and truth.

    Args:
        args: the parsed options.

    Raises:
        InputError: an option is for the cases of a set.
    """
    flags = [word.partition("=")[0] for word in args.words if word.startswith("--")]
    if other := next((flag for flag in flags if flag not in _OF_A_SYNTHETIC_CLIP), None):
        raise InputError(f"`hfb synth clip` makes one clip, and {other} is for the cases of a set: leave it out")
    out = args.out or Path("runs/clip")
    with open_session(args, out, recorded=False):
        from hfb.tasks.telemetry import progress

        with progress.step("libraries"):
            from hfb.datasets.synthetic.clip_making import make_clip
        wide = 640 if args.size is None else args.size
        even = 2 if args.mp4 else 1  # H.264 takes no odd number of pixels
        height, width = (even * round(side / even) for side in (0.75 * wide, wide))
        with progress.step("frames"):
            made = make_clip(out, args.frames, height, width, args.seed, video=args.mp4, on_progress=progress.advance)
    result = {"frames": args.frames, "out": str(out.resolve()), "source": str(made.source), "truth": str(made.truth)}
    tell(args, result, f"{args.frames} frames with their truth in {out}: hfb video {out} --truth {made.truth}")


def video_text(result: Mapping[str, Any]) -> str:
    """Return the table printed at the end of `hfb video`.

    Args:
        result: content of result.json.
    """
    if result.get("people"):
        return _people_text(result)
    gaps = ", ".join(f"{first} to {last}" for first, last in result["gaps"]) or "none"
    rows = [
        ("frames", f"{result['frames']} ({result['resumed_frames']} from an earlier start)"),
        ("sub-frames", str(result["sub_frames"])),
        ("gaps", gaps),
        ("IoU with the matte", figure_text(result.get("matte_iou"), ".3f")),
        ("image PSNR [dB]", figure_text(result.get("psnr_db"), ".1f")),
        ("MPJPE [mm]", figure_text(result.get("mpjpe_mm"), ".1f")),
        ("jump at an edge [mm]", figure_text(result.get("worst_jump_mm"), ".2f")),
        ("seconds", f"{result['seconds']:.1f}   ({result['seconds'] / result['frames']:.2f} per frame)"),
    ]
    lines = ["", *(f"{name:<24}{value}" for name, value in rows if value != "-"), ""]
    lines += [f"{name:<9}{result[key]}" for name, key in _PLACES if result.get(key)]
    return "\n".join(lines + ([f"MLflow   {result['mlflow_link']}"] if result.get("mlflow_link") else []))


def _people_text(result: Mapping[str, Any]) -> str:
    """Return a line per person."""
    lines = [""]
    for one in result["people"]:
        told = (
            one["error"] or f"{one['sub_frames']} sub-frames, IoU with the matte {figure_text(one['matte_iou'], '.3f')}"
        )
        lines.append(f"{one['name']:<16}seen in {one['seen']} frames; {told}; {one['out']}")
    return "\n".join([*lines, "", f"result   {result['out']}"])


def batch_text(result: Mapping[str, Any]) -> str:
    """Return the lines printed at the end of `hfb batch`.

    Args:
        result: number of clips in each state, and the page.
    """
    counts = f"{result['done']} of {result['clips']} clips done, {result['set_aside']} set aside"
    return f"\n{counts}\npage     {result['page']}\nresult   {result['out']}"
