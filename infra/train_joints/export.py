"""Ship what was trained: `python export.py --run FOLDER --held-out BANK --out hfb/evidence/data`."""

import argparse
import hashlib
import json
from pathlib import Path

import torch
from bank import FURTHER_SUBJECTS, TRAINING_SUBJECTS
from measure import measure
from safetensors.torch import load_file, save
from train import Bank

from hfb.evidence.joint_network import JointNetwork

_DATA = {
    "bodies": "the embedded body (CC0 assets), random betas, generated clothing",
    "motions": "CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, funding from NSF EIA-0196217), subjects "
    f"{', '.join(map(str, TRAINING_SUBJECTS))} without every fourth clip (1, 2, 5, 6 and 7 in one "
    f"conversion until run13, all in two since), from run20 on also {', '.join(map(str, FURTHER_SUBJECTS))}; "
    "limbs lent between clips (upper bodies "
    "alone in the first 12,200 pictures), joints bent a little in half of the others; a quarter generated",
    "backgrounds": "Poly Haven HDRI views, Buddies of Budgie backgrounds, scikit-image textures (all CC0); "
    "generated rooms",
    "mattes": "the first matting network's; from run20 on a third to all of its errors",
    "starts": "drawn by hfb.datasets.network_errors, placed beside the person",
    "while learning": "mirrored, colours exchanged, holes in mattes; from run13 on a quarter turned about the "
    "line of sight (10 degrees), three in ten starts leaning as a whole into depth (14 degrees); from run14 on "
    "errors across the view weighed above depth, and the path half as much again; from run15 on the height, too; in "
    "run16 and run17 a half turned (7 degrees), nearer or farther (6 %) and shifted (4 %), in run18 on eight in ten "
    "(9 degrees, 8 %, 4 %); in run19 pictures and what a fit made of them, in seven tenths of every batch",
}


def main() -> None:
    """Write half-precision weights and, beside them, what made them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, required=True, help="of train.py")
    parser.add_argument("--held-out", type=Path, required=True, help="a bank of motions that training never saw")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--share", type=float, default=1.0, help="of the run's weights; the rest stays as it was")
    parser.add_argument("--went-on", action="store_true", help="the run began with what lies in --out: keep its story")
    options = parser.parse_args()
    network = JointNetwork()
    trained = torch.load(options.run / "average.pt", weights_only=True)
    if options.share < 1:
        before = load_file(options.out / "joints.safetensors")
        trained = {
            name: torch.lerp(before[name].float(), values, options.share) if name in before else values
            for name, values in trained.items()
        }
    network.load_state_dict({name: values for name, values in trained.items() if name in network.state_dict()})
    state = {name: values for name, values in sorted(network.state_dict().items()) if values.is_floating_point()}
    content = save({name: values.half().contiguous() for name, values in state.items()})
    network.load_state_dict({name: values.half().float() for name, values in state.items()}, strict=False)
    facts = {"run": options.run.name, **json.loads((options.run / "training.json").read_text()), "share": options.share}
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "joints.safetensors").write_bytes(content)
    story = json.loads((options.out / "joints.json").read_text())["training"] if options.went_on else []
    bank = Bank([options.held_out])
    about = {
        "weights": "joints.safetensors",
        "sha256": hashlib.sha256(content).hexdigest(),
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "data": _DATA,
        "training": [*story, facts],
        "held_out": {"bank": options.held_out.name, "pictures": len(bank), **measure(network, bank, len(bank))},
    }
    (options.out / "joints.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    main()
