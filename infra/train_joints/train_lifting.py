"""Train and ship the lifting network: `python train_lifting.py --bank l1.npz --held-out dev.npz --out FOLDER`."""

import argparse
import copy
import hashlib
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
from bank import TRAINING_SUBJECTS
from safetensors.torch import load_file, save

from hfb.body.skeleton import JOINT_NAMES, MIRROR, PARENTS
from hfb.initialize.lifting_network import LiftingNetwork, as_large
from hfb.media.array_files import read_arrays

_STEPS_MM = {
    "hip": 7, "knee": 12, "ankle": 14, "foot": 10, "collar": 5, "shoulder": 9, "elbow": 20, "wrist": 33, "hand": 25,
    "spine1": 5, "spine2": 5, "spine3": 5, "neck": 8, "head": 5, "pelvis": 0,
}  # fmt: skip
"""How far a fit's joints are off across the view, added at each joint: measured on 40 fits of held-out motions."""

_INHERITED = 0.6
_TOWARDS_START = 0.28
"""A parent's share in a joint's error; the largest share of the first guess' error that a fit keeps."""

_ROLL, _YAW = 0.15, 0.2
_CHECK_EVERY = 2000


class People:
    """Joints with first guesses, several files as one."""

    def __init__(self, paths: list[Path]) -> None:
        """Read everything."""
        files = [read_arrays(path) for path in paths]
        self.joints, self.starts, self.unit_m = (
            torch.from_numpy(np.concatenate([file[name] for file in files])) for name in ("joints", "starts", "unit_m")
        )


def as_fitted(
    joints: torch.Tensor, starts: torch.Tensor, unit_m: torch.Tensor, levels: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Joints across the view as a fit would have them, first guesses as large as those, and the truth.

    Args:
        levels: (N,) of the errors; 1 is as measured.
    """
    joints, starts = joints - joints[:, :1], starts - starts[:, :1]
    limbs = torch.tensor([{"left": 0, "right": 1}.get(name.partition("_")[0], 2) for name in JOINT_NAMES])
    legs = torch.tensor([name.rpartition("_")[2] in ("hip", "knee", "ankle", "foot") for name in JOINT_NAMES])
    steps = torch.tensor([_STEPS_MM[name.rpartition("_")[2]] for name in JOINT_NAMES]) / 1000
    spread = torch.exp(0.5 * torch.randn(len(joints), 5))[:, torch.where(limbs == 2, 4, limbs + 2 * legs)]
    own = torch.randn(len(joints), 24, 2) * (levels[:, None] * spread * steps)[..., None]
    off = [own[:, 0]]
    for joint in range(1, 24):
        off.append(_INHERITED * off[PARENTS[joint]] + own[:, joint])
    kept = _TOWARDS_START * torch.rand(len(joints), 1, 1) * (starts - joints)[..., :2]
    across = joints[..., :2] + torch.stack(off, 1) / unit_m[:, None, None] + kept
    return across, as_large(starts, across), joints


def augmented(people: People, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A batch for `as_fitted`: mirrored, turned about the line of sight and the vertical; some guesses nearly right."""
    rows, which = torch.randint(len(people.joints), (count,)), torch.randint(people.starts.shape[1], (count,))
    joints, starts = people.joints[rows], people.starts[rows, which]
    joints, starts = joints - joints[:, :1], starts - starts[:, :1]
    mirrored = (torch.rand(count) < 0.5)[:, None, None]
    turned = torch.tensor([-1.0, 1.0, 1.0])
    joints, starts = (torch.where(mirrored, one[:, list(MIRROR)] * turned, one) for one in (joints, starts))
    share = torch.where(torch.rand(count) < 0.3, torch.rand(count), torch.zeros(count))[:, None, None]
    starts = torch.lerp(starts, joints, share)
    turn = (_about(2, _ROLL * torch.randn(count)) @ _about(1, _YAW * torch.randn(count))).mT
    return joints @ turn, starts @ turn, people.unit_m[rows]


def _about(axis: int, angles: torch.Tensor) -> torch.Tensor:
    """Rotations (N, 3, 3)."""
    one, other = [number for number in range(3) if number != axis]
    turns = torch.eye(3).repeat(len(angles), 1, 1)
    turns[:, one, one] = turns[:, other, other] = angles.cos()
    turns[:, other, one] = angles.sin()
    turns[:, one, other] = -angles.sin()
    return turns


def measure(network: LiftingNetwork, people: People, level: float) -> dict[str, float]:
    """Errors from the pelvis in millimetres: the first guess', the given joints' across the view, the network's."""
    torch.manual_seed(5)
    levels = torch.full((len(people.joints),), level)
    across, start, truth = as_fitted(people.joints, people.starts[:, 0], people.unit_m, levels)
    with torch.no_grad():
        off = network(across, start)[0] - truth
    mm = 1000 * people.unit_m[:, None]
    figures = {
        "start": (start - truth).norm(dim=-1), "given": (across - truth[..., :2]).norm(dim=-1),
        "joints": off.norm(dim=-1), "across": off[..., :2].norm(dim=-1), "depth": off[..., 2].abs(),
    }  # fmt: skip
    return {name: round(float((values * mm).mean()), 1) for name, values in figures.items()}


def main() -> None:
    """AdamW on L1 and a Laplace likelihood, a cosine over the minutes, averaged weights; half precision is shipped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bank", type=Path, nargs="+", required=True)
    parser.add_argument("--held-out", type=Path, required=True, help="of motions that training never saw")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--rate", type=float, default=1.5e-3)
    parser.add_argument("--go-on", type=Path, help="begin with these weights (lifting.safetensors of another run)")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    people, held_out = People(options.bank), People([options.held_out])
    network = LiftingNetwork()
    if options.go_on is not None:
        network.load_state_dict({name: values.float() for name, values in load_file(options.go_on).items()})
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=0.03)
    began, iteration, progress = time.monotonic(), 0, 0.0
    while progress < 1:
        optimizer.param_groups[0]["lr"] = (
            options.rate * min(1, (iteration + 1) / 200) * (1 + math.cos(math.pi * progress)) / 2 + 1e-6
        )
        levels = torch.exp(torch.empty(options.batch).uniform_(math.log(0.5), math.log(1.8)))
        across, start, truth = as_fitted(*augmented(people, options.batch), levels)
        joints, log_scale = network(across, start)
        error = (joints - truth).abs()
        likelihood = (error.detach() * torch.exp(-log_scale) + log_scale).mean()
        optimizer.zero_grad()
        (10 * error.mean() + 0.3 * likelihood).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        with torch.no_grad():
            for mean, new in zip(average.parameters(), network.parameters(), strict=True):
                mean.lerp_(new, 0.002 if iteration > 1000 else 0.02)
        iteration += 1
        progress = (time.monotonic() - began) / 60 / options.minutes
        if iteration % _CHECK_EVERY == 0:
            state = torch.get_rng_state()
            print(json.dumps({"iteration": iteration, **measure(average, held_out, 1.0)}), flush=True)
            torch.set_rng_state(state)
    training = {"people": len(people.joints), "iterations": iteration, "batch": options.batch, "rate": options.rate}
    export(average, held_out, options.out, training)


def export(network: LiftingNetwork, held_out: People, folder: Path, training: dict[str, float]) -> None:
    """Write half-precision weights and, beside them, what made them."""
    state = {name: values.half().contiguous() for name, values in sorted(network.state_dict().items())}
    network.load_state_dict({name: values.float() for name, values in state.items()})
    content = save(state)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "lifting.safetensors").write_bytes(content)
    about = {
        "weights": "lifting.safetensors",
        "sha256": hashlib.sha256(content).hexdigest(),
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "motions": "CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, funding from NSF EIA-0196217), "
        f"subjects {', '.join(map(str, TRAINING_SUBJECTS))} without every fourth clip; limbs lent between clips, "
        "joints bent a little; a quarter generated",
        "starts": "drawn by hfb.datasets.network_errors",
        "training": training,
        "held_out": {f"errors times {level}": measure(network, held_out, level) for level in (0.5, 1.0)},
    }
    (folder / "lifting.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    main()
