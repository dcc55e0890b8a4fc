"""Export trained weights for shipping: `hfb train joints-export --run DIR --held-out BANK --out hfb/evidence/data`."""

import argparse
from pathlib import Path

import torch

from hfb.evidence.joint_network import JointNetwork
from hfb.training.flags import folder
from hfb.training.joints.joint_bank import FURTHER_SUBJECTS, TRAINING_SUBJECTS
from hfb.training.joints.joint_batches import Bank
from hfb.training.joints.joint_measures import measure
from hfb.training.weight_files import count_parameters, half, publish, read_story, read_weights

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


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add = parser.add_argument
    add("--run", type=folder, required=True, metavar="DIR", help="of hfb train joints")
    add("--held-out", type=folder, required=True, metavar="DIR", help="a bank of motions that training never saw")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for joints.safetensors and joints.json")
    add("--share", type=float, default=1.0, help="of the run's weights; the rest stays as it was [1]")
    add("--went-on", action="store_true", help="the run began with what lies in --out: keep its story")


def run(options: argparse.Namespace) -> None:
    """Write half-precision weights and their provenance.

    Args:
        options: the parsed options.
    """
    network = JointNetwork()
    trained = read_weights(options.run / "average.pt")
    if options.share < 1:
        before = read_weights(options.out / "joints.safetensors")
        trained = {
            name: torch.lerp(before[name], values, options.share) if name in before else values
            for name, values in trained.items()
        }
    network.load_state_dict({name: values for name, values in trained.items() if name in network.state_dict()})
    state = half({name: values for name, values in network.state_dict().items() if values.is_floating_point()})
    network.load_state_dict({name: values.float() for name, values in state.items()}, strict=False)
    facts = {"run": options.run.name, **read_story(options.run / "training.json"), "share": options.share}
    story = read_story(options.out / "joints.json")["training"] if options.went_on else []
    bank = Bank([options.held_out])
    measured = {"bank": options.held_out.name, "pictures": len(bank), **measure(network, bank, len(bank))}
    about = {"data": _DATA, "training": [*story, facts], "held_out": measured}
    publish(options.out, "joints", state, count_parameters(network), about)
