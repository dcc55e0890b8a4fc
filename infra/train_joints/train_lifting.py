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
from bank import FURTHER_SUBJECTS, TRAINING_SUBJECTS
from safetensors.torch import load_file, save

from hfb.body.skeleton import JOINT_NAMES, MIRROR, PARENTS
from hfb.initialize.lifting_network import LiftingNetwork, as_large
from hfb.media.array_files import read_arrays
from hfb.rotations import axis_angle_to_matrix

_STEPS_MM = {
    "hip": 6, "knee": 11, "ankle": 8, "foot": 8, "collar": 7, "shoulder": 7, "elbow": 10, "wrist": 16, "hand": 15,
    "spine1": 4, "spine2": 5, "spine3": 6, "neck": 7, "head": 5, "pelvis": 0,
}  # fmt: skip
"""How far a fit's joints are off across the view, added at each joint: measured on 160 frames of held-out motions.

16 mm in the mean; 25 until 2026-11-24.
"""

_INHERITED = 0.6
_TOWARDS_START = 0.15
_COMMON = 0.7
"""A parent's share in a joint's error; the largest share of the first guess' error that a fit keeps; what two frames
have in common of the errors' variance: 33.8 of the 44.4 mm that 30 pairs were off is the same in both."""

_ALONE = 0.4
_PITCH_YAW_ROLL = (0.0, 0.2, 0.15)
_ASLANT, _PITCH_YAW_ROLL_ASLANT = 0.25, (0.25, 0.2, 0.3)
"""Turns of whole people [rad]; a share as cameras see them that look down or are held aslant."""
_LEANING, _LEAN = 0.3, 0.25
"""Share of first guesses that are tilted as a whole into depth, as real estimators do, and how far [rad]."""
_COORDINATES = (0.5, 0.5, 2.0)
"""Weights of x, y and z: a fit asks for depth alone."""
_CHECK_EVERY = 2000


class Bank:
    """Joints with first guesses in two frames each, several files as one."""

    def __init__(self, paths: list[Path]) -> None:
        """Read files of lifting_bank.py, and folders of bank.py, whose people stand for two frames, too."""
        files = [_of_pictures(path) if path.is_dir() else read_arrays(path) for path in paths]
        self.joints, self.starts, self.unit_m = (
            torch.from_numpy(np.concatenate([file[name] for file in files])) for name in ("joints", "starts", "unit_m")
        )

    def __len__(self) -> int:
        return len(self.joints)


def _of_pictures(folder: Path) -> dict[str, np.ndarray]:
    """The middle and one end of each exposure as two frames: nearer to each other than two exposures are."""
    file = read_arrays(folder / "joints.npz")
    done = int(file["done"])
    truth, starts, unit_m = (file[name][:done] for name in ("truth", "starts", "unit_m"))
    end = 2 * np.random.default_rng(3).integers(2, size=done)
    joints = np.stack([truth[:, 1], truth[np.arange(done), end]], 1)
    return {"joints": joints, "starts": starts, "unit_m": np.repeat(unit_m[:, None], 2, 1)}


def as_fitted(
    joints: torch.Tensor, starts: torch.Tensor, unit_m: torch.Tensor, levels: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Joints across the view as a fit would have them, first guesses as large as those, and the truth.

    Args:
        joints: (N, 2, 24, 3). levels: (N,) of the errors; 1 is as measured.
    """
    joints, starts = _from_pelvis(joints), _from_pelvis(starts)
    limbs = torch.tensor([{"left": 0, "right": 1}.get(name.partition("_")[0], 2) for name in JOINT_NAMES])
    legs = torch.tensor([name.rpartition("_")[2] in ("hip", "knee", "ankle", "foot") for name in JOINT_NAMES])
    steps = torch.tensor([_STEPS_MM[name.rpartition("_")[2]] for name in JOINT_NAMES]) / 1000
    spread = torch.exp(0.5 * torch.randn(len(joints), 1, 5))[..., torch.where(limbs == 2, 4, limbs + 2 * legs)]
    common, own = torch.randn(len(joints), 1, 24, 2), torch.randn(len(joints), 2, 24, 2)
    step = _COMMON**0.5 * common + (1 - _COMMON) ** 0.5 * own
    step = step * (levels[:, None, None] * spread * steps)[..., None]
    off = [step[:, :, 0]]
    for joint in range(1, 24):
        off.append(_INHERITED * off[PARENTS[joint]] + step[:, :, joint])
    kept = _TOWARDS_START * torch.rand(len(joints), 1, 1, 1) * (starts - joints)[..., :2]
    across = joints[..., :2] + torch.stack(off, 2) / unit_m[..., None, None] + kept
    return across, as_large(starts.flatten(0, 1), across.flatten(0, 1)).unflatten(0, (-1, 2)), joints


def augmented(bank: Bank, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A batch for `as_fitted`: mirrored, turned about the line of sight and the vertical; some guesses nearly right."""
    rows = torch.randint(len(bank), (count, 1))
    order = torch.tensor([[0, 1], [1, 0]])[torch.randint(2, (count,))]
    joints, starts = _from_pelvis(bank.joints[rows, order]), _from_pelvis(bank.starts[rows, order])
    mirrored = (torch.rand(count) < 0.5)[:, None, None, None]
    turned = torch.tensor([-1.0, 1.0, 1.0])
    joints, starts = (torch.where(mirrored, one[:, :, list(MIRROR)] * turned, one) for one in (joints, starts))
    share = torch.where(torch.rand(count) < 0.3, torch.rand(count), torch.zeros(count))[:, None, None, None]
    starts = torch.lerp(starts, joints, share)
    sizes = torch.tensor([_PITCH_YAW_ROLL, _PITCH_YAW_ROLL_ASLANT])[(torch.rand(count) < _ASLANT).long()]
    turn = axis_angle_to_matrix(sizes * torch.randn(count, 3)).mT[:, None]
    tilt = torch.tensor([_LEAN, _LEAN, 0.0]) * torch.randn(count, 3) * (torch.rand(count, 1) < _LEANING)
    leaning = axis_angle_to_matrix(tilt).mT[:, None]
    return joints @ turn, starts @ turn @ leaning, bank.unit_m[rows, order]


def _looked_at(
    network: LiftingNetwork, across: torch.Tensor, start: torch.Tensor, alone: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """What the network says of each first frame, some (alone, (N,) bool) without the second."""
    across, start = (
        torch.stack([one[:, 0], torch.where(alone[:, None, None], one[:, 0], one[:, 1])], 1) for one in (across, start)
    )
    said: tuple[torch.Tensor, torch.Tensor] = network(across, start)
    return said


def _from_pelvis(joints: torch.Tensor) -> torch.Tensor:
    return joints - joints[..., :1, :]


def measure(network: LiftingNetwork, bank: Bank, level: float, alone: bool) -> dict[str, float]:
    """Errors from the pelvis in millimetres: the first guess', the given joints' across the view, the network's."""
    torch.manual_seed(5)
    across, start, truth = as_fitted(bank.joints, bank.starts, bank.unit_m, torch.full((len(bank),), level))
    with torch.no_grad():
        off = _looked_at(network, across, start, torch.full((len(bank),), alone))[0] - truth[:, 0]
    across, start, truth = across[:, 0], start[:, 0], truth[:, 0]
    mm = 1000 * bank.unit_m[:, :1]
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
    parser.add_argument("--batch", type=int, default=512)
    parser.add_argument("--rate", type=float, default=1.5e-3)
    parser.add_argument(
        "--bfloat16", action="store_true", help="on processors that compute in it; on others far slower"
    )
    parser.add_argument("--go-on", type=Path, help="begin with these weights (lifting.safetensors of another run)")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    bank, held_out = Bank(options.bank), Bank([options.held_out])
    network = LiftingNetwork()
    if options.go_on is not None:
        network.load_state_dict({name: values.float() for name, values in load_file(options.go_on).items()})
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=0.03, fused=True)
    began, iteration, progress = time.monotonic(), 0, 0.0
    while progress < 1:
        optimizer.param_groups[0]["lr"] = (
            options.rate * min(1, (iteration + 1) / 200) * (1 + math.cos(math.pi * progress)) / 2 + 1e-6
        )
        levels = torch.exp(torch.empty(options.batch).uniform_(math.log(0.5), math.log(1.8)))
        across, start, truth = as_fitted(*augmented(bank, options.batch), levels)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=options.bfloat16):
            joints, log_scale = _looked_at(network, across, start, torch.rand(options.batch) < _ALONE)
        error = (joints - truth[:, 0]).abs()
        likelihood = error.detach() * torch.exp(-log_scale) + log_scale
        optimizer.zero_grad()
        ((10 * error + 0.3 * likelihood) * torch.tensor(_COORDINATES)).mean().backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        with torch.no_grad():
            for mean, new in zip(average.parameters(), network.parameters(), strict=True):
                mean.lerp_(new, 0.002 if iteration > 1000 else 0.02)
        iteration += 1
        progress = (time.monotonic() - began) / 60 / options.minutes
        if iteration % _CHECK_EVERY == 0:
            state = torch.get_rng_state()
            figures = {kind: measure(average, held_out, 1.0, kind == "alone") for kind in ("alone", "pair")}
            print(json.dumps({"iteration": iteration} | figures), flush=True)
            torch.set_rng_state(state)
    training = {"people": len(bank), "iterations": iteration, "batch": options.batch, "rate": options.rate}
    export(average, held_out, options.out, training)


def export(network: LiftingNetwork, held_out: Bank, folder: Path, training: dict[str, float]) -> None:
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
        f"subjects {', '.join(map(str, TRAINING_SUBJECTS))} without every fourth clip or take, in two "
        "conversions (github DragonForgedTheArtist/IClone-CMU-Mocap; AtelierCircle/CMU-MoCap-01-09 and -10-14, MIT); "
        f"in the last training also {', '.join(map(str, FURTHER_SUBJECTS))} "
        "(papagina/Auto_Conditioned_RNN_motion, MIT); "
        "limbs lent between clips, joints bent a little; a quarter generated",
        "starts": "drawn by hfb.datasets.network_errors",
        "training": training,
        "held_out": {
            f"errors times {level}, {kind}": measure(network, held_out, level, kind == "alone")
            for level in (0.5, 1.0)
            for kind in ("alone", "pair")
        },
    }
    (folder / "lifting.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    main()
