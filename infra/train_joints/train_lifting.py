"""Train and ship the lifting network: `python train_lifting.py --bank l1.npz --held-out dev.npz --out FOLDER`.

Fits (`lifting_fits.py`), where given, are a share of every batch: a fit follows what networks tell it, so that its
errors are the ones that they do not see, and no noise is like that.
"""

import argparse
import copy
import hashlib
import json
import math
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
from bank import FURTHER_SUBJECTS, TRAINING_SUBJECTS
from safetensors.torch import load_file, save

from hfb.body.skeleton import JOINT_NAMES, MIRROR, PARENTS
from hfb.evidence.lifting_network import LiftingNetwork, match_spread
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.io.array_files import read_arrays

_STEPS_MM = {
    "hip": 6, "knee": 11, "ankle": 8, "foot": 8, "collar": 7, "shoulder": 7, "elbow": 10, "wrist": 16, "hand": 15,
    "spine1": 4, "spine2": 5, "spine3": 6, "neck": 7, "head": 5, "pelvis": 0,
}  # fmt: skip
"""How far a fit's joints are off across the view, added at each joint: measured on 160 frames of held-out motions.

16 mm in the mean; 25 until 2026-11-24.
"""

_INHERITED = 0.6
_TOWARDS_START = 0.15
"""A parent's share in a joint's error; the largest share of the first guess' error that a fit keeps."""

_MOVED_AT_MOST_M, _FORGETS_M = 0.25, 0.145
_STILL, _GROWS_PER_M = 0.65, 5.2
"""The farther joints move from one frame to the other (mean over joints, from the pelvis) the less the errors' variance
is the same in both, exp(-moved / .145 m), and the larger errors are. Measured on 791 fitted pairs of held-out motions:
.94 of the variance is the same and errors are .74 of their mean where joints moved 16 mm, .29 and 1.57 at 175 mm."""

_SIZE, _BONE = 0.015, 0.02
"""How far a fit's bones are off, as logarithms: as far as one unit of the window goes, and each by itself (both sides
alike). Measured on 74 fitted pairs of held-out motions: 1.5 %, and 1 to 3 % (a piece of the spine 6)."""

_ALONE = 0.3
_ROLL_FITS, _SIZES_FITS = 0.25, 0.08
"""Turns [rad] and sizes (logarithms) of fits."""
_OTHER_CAMERAS, _PERSPECTIVE = 0.35, 0.4
"""Share of the people as other cameras see them, from afar (0) to near by (a unit is .4 of the distance)."""
_PITCH_YAW_ROLL = (0.0, 0.2, 0.15)
_ASLANT, _PITCH_YAW_ROLL_ASLANT = 0.25, (0.25, 0.2, 0.3)
"""Turns of whole people [rad]; a share as cameras see them that look down or are held aslant."""
_LEANING, _LEAN = 0.3, 0.25
"""Share of first guesses that are tilted as a whole into depth, as real estimators do, and how far [rad]."""
_COORDINATES = (0.5, 0.5, 2.0)
"""Weights of x, y and z: a fit asks for depth alone."""
_CHECK_EVERY = 500


@dataclass(frozen=True)
class Bank:
    """N people in two frames each, in their windows' units.

    Attributes:
        joints, starts: (N, 2, 24, 3), first guesses among the latter. unit_m, perspective: (N, 2), one unit in metres
            and as a tangent. lengths: (N, 24) of bones [m].
    """

    joints: torch.Tensor
    starts: torch.Tensor
    unit_m: torch.Tensor
    perspective: torch.Tensor
    lengths: torch.Tensor

    @staticmethod
    def read(paths: list[Path]) -> "Bank":
        """Files of lifting_bank.py."""
        files = [read_arrays(path) for path in paths]
        return Bank(*(torch.from_numpy(np.concatenate([file[one.name] for file in files])) for one in fields(Bank)))

    def __len__(self) -> int:
        return len(self.joints)


@dataclass(frozen=True)
class Fitted:
    """N people in two frames each.

    Attributes:
        told: what the network is told of them. truth: (N, 2, 24, 3) joints from the pelvis. unit_m: (N, 2).
    """

    told: tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
    truth: torch.Tensor
    unit_m: torch.Tensor

    @staticmethod
    def read(paths: list[Path]) -> "Fitted":
        """Files of lifting_fits.py."""
        files = [read_arrays(path) for path in paths]
        file = {name: torch.from_numpy(np.concatenate([one[name] for one in files])) for name in files[0]}
        across, start, truth = (_from_pelvis(file[name]) for name in ("fitted", "starts", "joints"))
        told = (across[..., :2], start, file["fitted_lengths"], file["perspective"])
        return Fitted(told, truth, file["unit_m"]).with_starts_match_spread()

    def with_starts_match_spread(self) -> "Fitted":
        """First guesses that spread as wide as the joints are seen."""
        across, start, *rest = self.told
        large = match_spread(start.flatten(0, 1), across.flatten(0, 1)).unflatten(0, (-1, 2))
        return replace(self, told=(across, large, *rest))

    def some(self, count: int) -> "Fitted":
        """Some of them in either order; mirrored, turned about the line of sight, and of another size."""
        rows = torch.randint(len(self.truth), (count, 1))
        order = torch.tensor([[0, 1], [1, 0]])[torch.randint(2, (count,))]
        across, start, lengths, perspective = (one[rows, order] for one in self.told)
        truth, mirror = self.truth[rows, order], list(MIRROR)
        mirrored = (torch.rand(count) < 0.5)[:, None, None]
        lengths = torch.where(mirrored, lengths[:, :, mirror], lengths)
        turn = axis_angle_to_matrix(torch.tensor([0.0, 0.0, _ROLL_FITS]) * torch.randn(count, 3)).mT[:, None]
        size = torch.exp(_SIZES_FITS * torch.randn(count))

        def changed(joints: torch.Tensor) -> torch.Tensor:
            axes = joints.shape[-1]
            turned = torch.tensor([-1.0, 1.0, 1.0])[:axes]
            seen = torch.where(mirrored[..., None], joints[:, :, mirror] * turned, joints)
            return seen @ turn[..., :axes, :axes] * size[:, None, None, None]

        told = (changed(across), changed(start), lengths * size[:, None, None], perspective / size[:, None])
        return Fitted(told, changed(truth), self.unit_m[rows, order] / size[:, None]).with_starts_match_spread()

    def beside(self, other: "Fitted") -> "Fitted":
        """These and others."""
        told = tuple(torch.cat(two) for two in zip(self.told, other.told, strict=True))
        return Fitted(told, torch.cat([self.truth, other.truth]), torch.cat([self.unit_m, other.unit_m]))  # type: ignore[arg-type]


def as_fitted(people: Bank, levels: torch.Tensor) -> Fitted:
    """Joints across the view and bones as a fit would have them, first guesses as large as those.

    Args:
        levels: (N,) of the errors; 1 is as measured.
    """
    joints, starts = _from_pelvis(people.joints), _from_pelvis(people.starts)
    limbs = torch.tensor([{"left": 0, "right": 1}.get(name.partition("_")[0], 2) for name in JOINT_NAMES])
    legs = torch.tensor([name.rpartition("_")[2] in ("hip", "knee", "ankle", "foot") for name in JOINT_NAMES])
    steps = torch.tensor([_STEPS_MM[name.rpartition("_")[2]] for name in JOINT_NAMES]) / 1000
    spread = torch.exp(0.5 * torch.randn(len(joints), 1, 5))[..., torch.where(limbs == 2, 4, limbs + 2 * legs)]
    moved = ((joints[:, 1] - joints[:, 0]).norm(dim=-1).mean(-1) * people.unit_m[:, 0]).clamp_max(_MOVED_AT_MOST_M)
    same = torch.exp(-moved / _FORGETS_M)[:, None, None, None]
    common, own = torch.randn(len(joints), 1, 24, 2), torch.randn(len(joints), 2, 24, 2)
    step = same.sqrt() * common + (1 - same).sqrt() * own
    sizes = levels * (_STILL + _GROWS_PER_M * moved)
    step = step * (sizes[:, None, None] * spread * steps)[..., None]
    off = [step[:, :, 0]]
    for joint in range(1, 24):
        off.append(_INHERITED * off[PARENTS[joint]] + step[:, :, joint])
    kept = _TOWARDS_START * torch.rand(len(joints), 1, 1, 1) * (starts - joints)[..., :2]
    across = joints[..., :2] + torch.stack(off, 2) / people.unit_m[..., None, None] + kept
    sides = torch.tensor([min(joint, other) for joint, other in enumerate(MIRROR)])
    wrong = _SIZE * torch.randn(len(joints), 1) + (_BONE * torch.randn(len(joints), 24))[:, sides]
    lengths = people.lengths * torch.exp(levels[:, None] * wrong)
    told = (across, starts, lengths[:, None] / people.unit_m[..., None], people.perspective)
    return Fitted(told, joints, people.unit_m).with_starts_match_spread()


def augmented(bank: Bank, count: int) -> Bank:
    """Some of them: mirrored, turned about the line of sight and the vertical, as other cameras see them; some guesses
    nearly right."""
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
    seen = bank.perspective[rows, order]
    other = torch.where(torch.rand(count, 1) < _OTHER_CAMERAS, _PERSPECTIVE * torch.rand(count, 1), seen)
    joints, starts = (
        _by_a_camera(_from_afar(one, seen) @ turned, other)
        for one, turned in ((joints, turn), (starts, turn @ leaning))
    )
    return Bank(joints, starts, bank.unit_m[rows, order], other, bank.lengths[rows[:, 0]])


def _from_afar(joints: torch.Tensor, perspective: torch.Tensor) -> torch.Tensor:
    """Joints (N, 2, 24, 3) from the pelvis without their perspective, but for what hangs on their way to the axis."""
    return torch.cat([joints[..., :2] * (1 + perspective[..., None, None] * joints[..., 2:]), joints[..., 2:]], -1)


def _by_a_camera(joints: torch.Tensor, perspective: torch.Tensor) -> torch.Tensor:
    """The way back."""
    nearer = (1 + perspective[..., None, None] * joints[..., 2:]).clamp_min(0.2)
    return torch.cat([joints[..., :2] / nearer, joints[..., 2:]], -1)


def _looked_at(network: LiftingNetwork, fitted: Fitted, alone: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """What the network says of each first frame, some (alone, (N,) bool) without the second."""
    told = (
        torch.stack([one[:, 0], torch.where(alone.view(-1, *[1] * (one.ndim - 2)), one[:, 0], one[:, 1])], 1)
        for one in fitted.told
    )
    said: tuple[torch.Tensor, torch.Tensor] = network(*told)
    return said


def _from_pelvis(joints: torch.Tensor) -> torch.Tensor:
    return joints - joints[..., :1, :]


def measure(network: LiftingNetwork, fitted: Fitted, alone: bool) -> dict[str, float]:
    """Errors from the pelvis in millimetres: the first guess', the given joints' across the view, the network's."""
    across, start, truth = fitted.told[0][:, 0], fitted.told[1][:, 0], fitted.truth[:, 0]
    with torch.no_grad():
        off = _looked_at(network, fitted, torch.full((len(truth),), alone))[0] - truth
    mm = 1000 * fitted.unit_m[:, :1]
    figures = {
        "start": (start - truth).norm(dim=-1), "given": (across - truth[..., :2]).norm(dim=-1),
        "joints": off.norm(dim=-1), "across": off[..., :2].norm(dim=-1), "depth": off[..., 2].abs(),
    }  # fmt: skip
    return {name: round(float((values * mm).mean()), 1) for name, values in figures.items()}


def measured(network: LiftingNetwork, held_out: dict[str, Fitted]) -> dict[str, dict[str, float]]:
    """Of every kind of people, alone and in a pair."""
    return {
        f"{name}, {kind}": measure(network, people, kind == "alone")
        for name, people in held_out.items()
        for kind in ("alone", "pair")
    }


def held_out_people(bank: Path, fits: Path | None) -> dict[str, Fitted]:
    """By what is told of them: errors that are drawn, and fits where there are some."""
    torch.manual_seed(5)
    people = Bank.read([bank])
    drawn = {f"errors times {level}": as_fitted(people, torch.full((len(people),), level)) for level in (0.5, 1.0)}
    return drawn | ({} if fits is None else {"fits": Fitted.read([fits])})


def main() -> None:
    """AdamW on L1 and a Laplace likelihood, a cosine over the minutes, averaged weights; half precision is shipped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bank", type=Path, nargs="+", required=True)
    parser.add_argument("--held-out", type=Path, required=True, help="of motions that training never saw")
    parser.add_argument("--fits", type=Path, nargs="+", default=[], help="files of lifting_fits.py to learn from, too")
    parser.add_argument("--fits-share", type=float, default=0.2, help="of every batch")
    parser.add_argument("--held-out-fits", type=Path)
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
    bank, held_out = Bank.read(options.bank), held_out_people(options.held_out, options.held_out_fits)
    fits = Fitted.read(options.fits) if options.fits else None
    of_fits = round(options.fits_share * options.batch) if fits else 0
    torch.manual_seed(0)
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
        drawn = options.batch - of_fits
        levels = torch.exp(torch.empty(drawn).uniform_(math.log(0.5), math.log(1.8)))
        fitted = as_fitted(augmented(bank, drawn), levels)
        fitted = fitted if fits is None else fitted.beside(fits.some(of_fits))
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=options.bfloat16):
            joints, log_scale = _looked_at(network, fitted, torch.rand(options.batch) < _ALONE)
        error = (joints - fitted.truth[:, 0]).abs()
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
            print(json.dumps({"iteration": iteration} | measured(average, held_out)), flush=True)
    training = {
        "people": len(bank), "fits": 0 if fits is None else len(fits.truth), "iterations": iteration,
        "batch": options.batch, "of_fits": of_fits, "rate": options.rate,
    }  # fmt: skip
    export(average, held_out, options.out, training)


def export(network: LiftingNetwork, held_out: dict[str, Fitted], folder: Path, training: dict[str, float]) -> None:
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
        f"where the folder holds them also {', '.join(map(str, FURTHER_SUBJECTS))} "
        "(papagina/Auto_Conditioned_RNN_motion, MIT); "
        "limbs lent between clips, joints bent a little; a quarter generated",
        "starts": "drawn by hfb.datasets.network_errors",
        "training": training,
        "held_out": measured(network, held_out),
    }
    (folder / "lifting.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    main()
