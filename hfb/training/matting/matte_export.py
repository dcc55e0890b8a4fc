"""Export trained weights for shipping: `hfb train matting-export --run DIR --metrics FILE --out hfb/matting/data`.

The second network (hfb train matting --second) with `--name second_look`, the third with `--name third_look`.
"""

import argparse
from pathlib import Path
from typing import Any

from hfb.matting.matte_network import WIDTHS
from hfb.training.flags import file, folder
from hfb.training.matting.figure_bank import HELD_OUT_SUBJECTS
from hfb.training.weight_files import half, publish, read_story, read_weights

_DATA = {
    "bodies": "the embedded body (CC0 assets), random betas, generated clothing",
    "motions": "CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, funding from NSF EIA-0196217), "
    f"without subjects {', '.join(map(str, HELD_OUT_SUBJECTS))}",
    "backgrounds": "Poly Haven HDRI views, Buddies of Budgie backgrounds, scikit-image textures (all CC0), every "
    "fourth scene held out; rooms and patterns generated",
}


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add = parser.add_argument
    add("--run", type=folder, nargs="+", required=True, metavar="DIR", help="of hfb train matting; the last's weights")
    add(
        "--metrics",
        type=file,
        required=True,
        metavar="FILE.json",
        help="--out of matting-measure, -compare or -doubles",
    )
    add("--name", choices=["matting", "second_look", "third_look"], default="matting", help="which network [matting]")
    add("--went-on", action="store_true", help="the run began with what lies in --out: keep its story")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for NAME.safetensors and NAME.json")


def run(options: argparse.Namespace) -> None:
    """Write half-precision weights and their provenance.

    Args:
        options: the parsed options.
    """
    state = read_weights(options.run[-1] / "folded.pt")
    story = read_story(options.out / f"{options.name}.json")["training"] if options.went_on else []
    about = {
        "channels": state["entry.0.weight"].shape[1],
        "widths": WIDTHS,
        "data": _DATA,
        "training": [*story, *(_stage(read_story(run / "training.json")) for run in options.run)],
        "held_out": read_story(options.metrics),
    }
    publish(options.out, options.name, half(state), sum(weights.numel() for weights in state.values()), about)


def _stage(facts: dict[str, Any]) -> dict[str, Any]:
    kept = ("size", "batch", "fresh", "rate", "seed", "bfloat16")
    return {
        "iterations": facts["iterations"],
        "minutes": round(facts["seconds"] / 60, 1),
        "loss": facts["loss"] and round(facts["loss"], 4),
        **{name: facts["options"][name] for name in kept},
    }
