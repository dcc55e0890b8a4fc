"""Ship what was trained: `python export.py --run FOLDER --metrics FILE --out hfb/matting/data`.

The second network (train.py --second) with `--name second_look`, the third with `--name third_look`.
"""

import argparse
import hashlib
import json
from pathlib import Path

import torch
from bank import HELD_OUT_SUBJECTS
from safetensors.torch import save

from hfb.matting.matte_network import WIDTHS

_DATA = {
    "bodies": "the embedded body (CC0 assets), random betas, generated clothing",
    "motions": "CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, funding from NSF EIA-0196217), "
    f"without subjects {', '.join(map(str, HELD_OUT_SUBJECTS))}",
    "backgrounds": "Poly Haven HDRI views, Buddies of Budgie backgrounds, scikit-image textures (all CC0), every "
    "fourth scene held out; rooms and patterns generated",
}


def main() -> None:
    """Write half-precision weights and, beside them, what made them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, nargs="+", required=True, help="of train.py; the last one's weights")
    parser.add_argument("--metrics", type=Path, required=True, help="what measure.py or compare.py wrote with --out")
    parser.add_argument("--name", choices=["matting", "second_look", "third_look"], default="matting")
    parser.add_argument("--went-on", action="store_true", help="the run began with what lies in --out: keep its story")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    state = torch.load(options.run[-1] / "folded.pt", weights_only=True)
    content = save({name: weights.half().contiguous() for name, weights in sorted(state.items())})
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / f"{options.name}.safetensors").write_bytes(content)
    story = json.loads((options.out / f"{options.name}.json").read_text())["training"] if options.went_on else []
    trained = [json.loads((run / "training.json").read_text()) for run in options.run]
    about = {
        "weights": f"{options.name}.safetensors",
        "sha256": hashlib.sha256(content).hexdigest(),
        "parameters": sum(weights.numel() for weights in state.values()),
        "channels": state["entry.0.weight"].shape[1],
        "widths": WIDTHS,
        "data": _DATA,
        "training": [*story, *(_stage(facts) for facts in trained)],
        "held_out": json.loads(options.metrics.read_text()),
    }
    (options.out / f"{options.name}.json").write_text(json.dumps(about, indent=1) + "\n")


def _stage(facts: dict) -> dict:
    kept = ("size", "batch", "fresh", "rate", "seed", "half")
    return {
        "iterations": facts["iterations"],
        "minutes": round(facts["seconds"] / 60, 1),
        "loss": round(facts["loss"], 4),
        **{name: facts["options"][name] for name in kept},
    }


if __name__ == "__main__":
    main()
