"""Train the joint network: `python train.py --bank b1 b2 --dev dev --out run --iterations 6000`."""

from __future__ import annotations

import argparse
import copy
import itertools
import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
import torch
from measure import as_large, measure
from muon import Muon
from safetensors.torch import load_file
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from hfb.body.skeleton import MIRROR
from hfb.evidence.joint_network import PICTURE_PX, SMALL, WIDE, JointClaim, JointNetwork

_ROUND_SHARES = (0.25, 0.5, 1.0)
_AXES = (1.2, 1.2, 0.6)
"""What an error weighs across the view and in depth, where the lifting network has a word, too."""
_TALL = 0.15
_APART = 2.0
"""What the difference of two views weighs beside each of them."""
_LAST = ("name", "move", "say", "turn", "stature")
"""What Muon leaves to AdamW."""
_CHECKPOINT_S, _READ_AGAIN = 240, 200
_AVERAGE = 0.998
_MOVED, _ROLL_DEG, _ZOOM, _SHIFT = 0.8, 9.0, 0.08, 0.04
_LEANING, _LEAN_DEG = 0.3, 14.0
_LEGS, _ARMS = ((4, 5), (7, 8), (10, 11)), ((18, 19), (20, 21), (22, 23))


class Bank:
    """Pictures with truths and starts, several files as one; what is still being drawn is left out.

    A row of `bank.py` is one view of a person, one of `fits.py` two: as seen, and as a fit has it.
    """

    def __init__(self, folders: list[Path]) -> None:
        """Map the pictures, read the joints."""
        self.folders = folders
        self.pictures = [np.load(folder / "pictures.npy", mmap_mode="r") for folder in folders]
        self.read()

    def read(self) -> None:
        """The joints of all pictures that are drawn by now."""
        parts = []
        for number, folder in enumerate(self.folders):
            with np.load(folder / "joints.npz") as file:
                done = int(file["done"])
                parts.append(
                    (np.full(done, number), *(file[key][:done] for key in ("truth", "starts", "unit_m", "height_m")))
                )
        self.folder, self.truth, self.starts, self.unit_m, self.height_m = (
            np.concatenate(column) for column in zip(*parts, strict=True)
        )
        self.row = np.concatenate([np.arange(len(part[0])) for part in parts])

    def __len__(self) -> int:
        return len(self.row)

    def draw(self, rng: np.random.Generator, count: int, last: float) -> np.ndarray:
        """Numbers of pictures (count,), a share of them of the last folder."""
        ours = int(last * count)
        newest = np.flatnonzero(self.folder == len(self.folders) - 1)
        return np.concatenate([rng.choice(newest, ours), rng.integers(len(self), size=count - ours)])

    def batch(self, chosen: np.ndarray) -> np.ndarray:
        """(N, *views, C, H, W) uint8."""
        return np.stack([self.pictures[self.folder[index]][self.row[index]] for index in chosen])


def augmented(
    bank: Bank, chosen: np.ndarray, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Pictures (N, V, C, H, W), starts (N, 24, 3), truths (N, V, 3, 24, 3): mirrored, recoloured, with other starts.

    All views of a person are changed alike; matters of a single picture, such as a hole in a matte, are the first's.
    """
    count = len(chosen)
    seen, truth = bank.batch(chosen), bank.truth[chosen]
    if seen.ndim == 4:
        seen, truth = seen[:, None], truth[:, None]
    pictures, truth, starts = _moved(seen, truth, _confused(bank, chosen, rng), rng)
    pictures, truth = torch.from_numpy(pictures).float() / 127.5 - 1, torch.from_numpy(truth)
    starts, middle = _leaning(starts, rng), truth[:, 0, 1]
    # A share of starts lies between what was drawn and the truth; estimates of other systems are often that good.
    share = np.where(rng.random(count) < 0.3, rng.random(count), 0)[:, None, None].astype(np.float32)
    starts = as_large(torch.from_numpy(starts), middle, torch.from_numpy(rng.normal(0, 0.04, count)).float())
    share = torch.from_numpy(share)
    starts = starts * (1 - share) + middle * share
    starts = starts + torch.from_numpy(rng.normal(0, 0.02, starts.shape)).float()
    mirrored = torch.from_numpy(rng.random(count) < 0.5)[:, None, None]
    pictures = torch.where(mirrored[..., None, None], pictures.flip(-1), pictures)
    across = torch.tensor([-1.0, 1.0, 1.0])
    truth = torch.where(mirrored[..., None, None], truth[..., list(MIRROR), :] * across, truth)
    starts = torch.where(mirrored, starts[:, list(MIRROR)] * across, starts)
    order = rng.permutation(3)
    if rng.random() < 0.5:
        pictures = pictures[:, :, [0, *(1 + order), *(4 + order)]]
    contrast = torch.from_numpy(np.exp(rng.normal(0, 0.2, (count, 1, 1, 1, 1)))).float()
    pictures[:, :, 1:] *= contrast
    for index in np.flatnonzero(rng.random(count) < 0.3):  # a matte with a hole, or a scrap too much
        height, width = rng.integers(5, 26, 2)
        top, left = rng.integers(0, 96 - height), rng.integers(0, 96 - width)
        pictures[index, 0, 0, top : top + height, left : left + width] = -1 if rng.random() < 0.7 else 1
    return pictures, starts, truth


def _moved(
    pictures: np.ndarray, truth: np.ndarray, starts: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A share of everything turned about the line of sight, nearer or farther, a little aside: other windows."""
    truth, starts = truth.copy(), starts.copy()
    for row in np.flatnonzero(rng.random(len(pictures)) < _MOVED):
        angle = np.deg2rad(np.clip(rng.normal(0, _ROLL_DEG), -30, 30))
        zoom, shift = np.exp(rng.normal(0, _ZOOM)), rng.normal(0, _SHIFT, 2)
        turn = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        middle = (PICTURE_PX - 1) / 2
        move = middle - turn @ (middle, middle) + shift * PICTURE_PX / 2
        matrix = np.concatenate([turn, move[:, None]], 1).astype(np.float32)
        for view, picture in enumerate(pictures[row]):
            layers = picture.transpose(1, 2, 0)
            parts = [
                cv2.warpAffine(
                    np.ascontiguousarray(layers[..., few]), matrix, layers.shape[:2], borderMode=cv2.BORDER_REPLICATE
                )
                for few in (slice(0, 4), slice(4, 7))  # OpenCV turns four channels at most
            ]
            pictures[row, view] = np.concatenate(parts, -1).transpose(2, 0, 1)
        for places in (truth[row], starts[row]):
            places[..., :2] = places[..., :2] @ turn.T + shift
            places[..., 2] *= zoom
    return pictures, truth, starts


def _leaning(starts: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A share of the starts tilted as a whole into depth, about the pelvis: what estimators of real pictures do."""
    for row in np.flatnonzero(rng.random(len(starts)) < _LEANING):
        axis = rng.normal(size=2)
        about = np.array([*(axis / np.linalg.norm(axis)), 0]) * np.deg2rad(rng.normal(0, _LEAN_DEG))
        pelvis = starts[row, :1].copy()
        starts[row] = (starts[row] - pelvis) @ cv2.Rodrigues(about)[0].T.astype(np.float32) + pelvis
    return starts


def _confused(bank: Bank, chosen: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Starts (N, 24, 3): mostly as drawn; some as an outline alone would have them, or of somebody else.

    An outline is the same for a person and for the one reflected in depth with the sides exchanged.
    """
    starts = bank.starts[chosen, rng.integers(bank.starts.shape[1], size=len(chosen))].copy()
    kinds = rng.choice(5, size=len(chosen), p=(0.92, 0.03, 0.02, 0.02, 0.01))
    for row in np.flatnonzero(kinds == 1):
        starts[row] = starts[row][list(MIRROR)] * (1, 1, -1)
    for row in np.flatnonzero((kinds == 2) | (kinds == 3)):
        limbs = _LEGS if kinds[row] == 2 else _ARMS
        order = list(range(24))
        for one, other in limbs:
            order[one], order[other] = other, one
        starts[row] = starts[row][order]
    for row in np.flatnonzero(kinds == 4):
        other = bank.starts[rng.integers(len(bank)), 0]
        starts[row] = other - other[:1] + starts[row][:1]
    return starts.astype(np.float32)


@dataclass(frozen=True)
class Batch:
    """Pictures (N, V, C, H, W) with starts (N, 24, 3), truths (N, V, 3, 24, 3), heights (N, V) [m]; of V views each."""

    pictures: torch.Tensor
    starts: torch.Tensor
    truth: torch.Tensor
    height_m: torch.Tensor

    def on(self, device: str) -> Batch:
        """The same in a device's memory."""
        return Batch(*(getattr(self, one.name).to(device) for one in fields(self)))


class Batches(IterableDataset):
    """Lists of one or two batches for an iteration each, of plain pictures and of pictures beside others, for ever."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options

    def __iter__(self) -> Iterator[list[Batch]]:
        """A function of the options and of what is drawn by then."""
        options, worker = self.options, get_worker_info()
        if worker is not None:
            cv2.setNumThreads(1)
            torch.set_num_threads(1)
        rng = np.random.default_rng(options.seed if worker is None else [options.seed, worker.id])
        banks = [Bank(folders) if folders else None for folders in (options.bank, options.fits)]
        share = options.fits_share if banks[0] else 1.0
        beside = round(share * options.batch / 2) if banks[1] else 0
        for number in itertools.count(1):
            batches = []
            for bank, count, last in zip(banks, (options.batch - 2 * beside, beside), (options.last, 0.0), strict=True):
                if bank is None or count == 0:
                    continue
                chosen = bank.draw(rng, count, last)
                heights = torch.from_numpy(bank.height_m[chosen]).view(count, -1)
                batches.append(Batch(*augmented(bank, chosen, rng), heights))
            yield batches
            if number % _READ_AGAIN == 0:
                for bank in banks:
                    if bank is not None:
                        bank.read()


def loss_of(claim: JointClaim, truth: torch.Tensor, height_m: torch.Tensor, views: int) -> torch.Tensor:
    """L1 of every round, the last one's Laplace likelihood, the path up to its sign, the sign, the height.

    Args:
        claim: about N * views pictures. truth: (N * views, 3, 24, 3). views: of one person, one after the other; with
            two of them their difference counts, too.
    """
    middle, path = truth[:, 1], truth[:, 2] - truth[:, 0]
    axes = truth.new_tensor(_AXES)
    joints = sum(
        share * ((one - middle) * axes).abs().mean() for share, one in zip(_ROUND_SHARES, claim.rounds, strict=True)
    )
    error = (claim.joints.detach() - middle).abs()
    likelihood = (error * torch.exp(-claim.log_scale) + claim.log_scale).mean()
    forth, back = (claim.path - path).abs().mean((1, 2)), (claim.path + path).abs().mean((1, 2))
    agrees = forth < back
    length = path.abs().mean((1, 2))
    sign = torch.nn.functional.binary_cross_entropy_with_logits(claim.log_odds, agrees.float(), reduction="none")
    moved = (length / 0.05).clamp(max=1)
    moved = moved.unflatten(0, (-1, views))[:, 0]  # a fit's own direction is a guess
    sign = sign.unflatten(0, (-1, views))[:, 0]
    tall = ((claim.log_height - height_m.log()) / claim.height_scale).square() / 2 + claim.height_scale.log()
    loss = (
        10 * joints + 5 * (_bones(claim.joints - middle) * axes).abs().mean() + 0.3 * likelihood
        + 6 * torch.minimum(forth, back).mean() + 0.05 * (sign * moved).mean() + _TALL * tall.mean()
    )  # fmt: skip
    if views == 1:
        return loss
    wrong = (claim.joints - middle).unflatten(0, (-1, views))
    wrong = (wrong[:, 0] - wrong[:, 1]) * axes
    height = (claim.log_height - height_m.log()).unflatten(0, (-1, views))
    apart = 10 * wrong.abs().mean() + 5 * _bones(wrong).abs().mean()
    return loss + _APART * (apart + 2 * (height[:, 0] - height[:, 1]).abs().mean())


def _bones(joints: torch.Tensor) -> torch.Tensor:
    return joints - joints[:, :1]


def _weights(path: Path) -> dict[str, torch.Tensor]:
    if path.suffix == ".safetensors":
        return {name: weights.float() for name, weights in load_file(path).items()}
    found: dict[str, torch.Tensor] = torch.load(path, weights_only=True)
    return found


def main() -> None:
    """A cosine over the iterations, averaged weights; at times a checkpoint, figures and newer pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bank", type=Path, nargs="*", default=[], help="of bank.py")
    parser.add_argument("--dev", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--iterations", type=int, default=6000)
    parser.add_argument("--minutes", type=float, default=1e9, help="hurry the schedule so that it ends by then")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rate", type=float, default=1.5e-3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--last", type=float, default=0.0, help="share of every batch that the last bank gets at least")
    parser.add_argument("--fits", type=Path, nargs="*", default=[], help="of fits.py or doubles.py: to compare")
    parser.add_argument("--fits-share", type=float, default=0.6, help="of the pictures of every batch")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--loaders", type=int, default=0, help="processes that change pictures; a GPU needs several")
    parser.add_argument(
        "--bfloat16", action="store_true", help="on processors that compute in it; on others far slower"
    )
    parser.add_argument("--small", action="store_true", help="half the channels, for widen.py")
    parser.add_argument("--go-on", type=Path, help="begin with these weights: average.pt of another run, or what ships")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    network = JointNetwork(SMALL if options.small else WIDE)
    if options.go_on is not None:
        network.load_state_dict(_weights(options.go_on), strict=False)  # layers that are new add nothing at first
    network = network.to(options.device, memory_format=torch.channels_last)
    average = copy.deepcopy(network)
    optimizer = Muon(network, options.rate, 0.05, _LAST)
    dev = Bank([options.dev])
    options.out.mkdir(parents=True, exist_ok=True)
    ahead = 4 if options.loaders else None
    loader = iter(DataLoader(Batches(options), batch_size=None, num_workers=options.loaders, prefetch_factor=ahead))
    began, last, iteration, running = time.monotonic(), 0.0, 0, 0.0
    while iteration < options.iterations and (time.monotonic() - began) / 60 < options.minutes:
        spent = time.monotonic() - began
        progress = min(1.0, max(iteration / options.iterations, spent / 60 / options.minutes))
        rate = options.rate * min(1, (iteration + 1) / 300) * (0.01 + 0.99 * (1 + math.cos(math.pi * progress)) / 2)
        network.train()
        loss = torch.zeros((), device=options.device)
        for batch in next(loader):
            seen = batch.on(options.device)
            views = seen.pictures.shape[1]
            pictures = seen.pictures.flatten(0, 1).contiguous(memory_format=torch.channels_last)
            with torch.autocast(options.device, dtype=torch.bfloat16, enabled=options.bfloat16):
                claim = network(pictures, seen.starts.repeat_interleave(views, 0))
            part = loss_of(claim, seen.truth.flatten(0, 1), seen.height_m.flatten(), views)
            loss = loss + len(pictures) / options.batch * part
        network.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step(rate)
        keep = min(_AVERAGE, (iteration + 1) / (iteration + 10))
        with torch.no_grad():
            for mean, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
                if mean.is_floating_point():
                    mean.lerp_(new, 1 - keep)
        running = 0.98 * running + 0.02 * loss.item()
        iteration += 1
        if spent - last > _CHECKPOINT_S or iteration == 100:
            last = spent
            there = copy.deepcopy(average).cpu()
            figures = measure(there, dev)
            facts = {"iteration": iteration, "minutes": round(spent / 60, 1), "loss": running}
            print(json.dumps(facts | figures), flush=True)
            torch.save(there.state_dict(), options.out / "average.part")
            (options.out / "average.part").rename(options.out / "average.pt")
    average = average.cpu()
    torch.save(average.state_dict(), options.out / "average.pt")
    facts = {
        "iterations": iteration,
        "minutes": round((time.monotonic() - began) / 60, 1),
        "batch": options.batch,
        "rate": options.rate,
        "seed": options.seed,
        "after": options.go_on and options.go_on.parent.name,
        "pictures": len(Bank(options.bank)) if options.bank else 0,
        "beside": len(Bank(options.fits)) if options.fits else 0,
        "dev": measure(average, dev),
    }
    (options.out / "training.json").write_text(json.dumps(facts, indent=1) + "\n")


if __name__ == "__main__":
    main()
