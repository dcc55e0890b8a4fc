"""Cut long recordings into clips: `hfb train clips --bvh DIR --out DIR` (CMU's, as cgspeed converts)."""

import argparse
from pathlib import Path

from hfb.errors import InputError
from hfb.training.flags import folder

_SECONDS, _SHORTEST_S = 8.0, 0.7


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    parser.add_argument("--bvh", type=folder, required=True, metavar="DIR", help="recordings SUBJECT_TRIAL.bvh")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the clips go")
    parser.add_argument("--hz", type=float, help="of all recordings, where their files state a wrong rate")


def run(options: argparse.Namespace) -> None:
    """Write every recording without its first frame, a T-pose, in equal parts of at most eight seconds.

    Args:
        options: the parsed options.
    """
    options.out.mkdir(parents=True, exist_ok=True)
    recordings = sorted(options.bvh.rglob("*.bvh"))
    if not recordings:
        raise InputError(f"{options.bvh} has no .bvh file; give a folder of recordings")
    for path in recordings:
        head, motion, body = path.read_text().partition("MOTION")
        _, step, *frames = [line for line in body.splitlines() if line.strip()] or ["", ""]
        if not motion or not step.startswith("Frame Time:"):
            raise InputError(f"{path} is no BVH recording: it has no MOTION with a frame time")
        step = f"Frame Time: {1 / options.hz:.8f}" if options.hz else step
        frames, seconds = frames[1:], float(step.split(":")[1])
        parts = max(1, round(len(frames) * seconds / _SECONDS))
        for part in range(parts):
            cut = frames[round(part * len(frames) / parts) : round((part + 1) * len(frames) / parts)]
            if len(cut) * seconds >= _SHORTEST_S:
                letter = f"_{chr(ord('a') + part)}" if parts > 1 else ""
                text = "\n".join([f"{head}MOTION", f"Frames: {len(cut)}", step, *cut, ""])
                (options.out / f"cmu_{path.stem}_daz{letter}.bvh").write_text(text)
