"""Train the joint network: `hfb train joints --bank b1 b2 --dev dev --out run --iterations 6000`."""

import argparse
import copy
import json
from typing import Any

import torch
from torch.utils.data import DataLoader

from hfb.errors import InputError
from hfb.evidence.joint_network import SMALL, WIDE, JointClaim, JointNetwork
from hfb.io.atomic import write_bytes_atomic
from hfb.training.flags import add_schedule_flags, folder
from hfb.training.joints.joint_batches import Bank, Batch, Batches
from hfb.training.joints.joint_measures import measure
from hfb.training.muon import Muon
from hfb.training.schedule import Schedule, cosine, tell, update_average
from hfb.training.weight_files import read_weights, write_checkpoint

_ROUND_SHARES = (0.25, 0.5, 1.0)
_AXES = (1.2, 1.2, 0.6)
"""Weights of errors in x, y and depth; the lifting network also estimates depth."""
_TALL = 0.15
_APART = 2.0
"""Weight of the difference of two views relative to each view."""
_LAST = ("name", "move", "say", "turn", "stature")
"""Parameters that AdamW trains instead of Muon."""
_CHECKPOINT_MINUTES = 4.0
_AVERAGE = 0.998


def loss_of(claim: JointClaim, truth: torch.Tensor, height_m: torch.Tensor, views: int) -> torch.Tensor:
    """Return the sum of L1 per round, Laplace likelihood, path up to its sign, the sign, bones and height.

    Args:
        claim: the network's output for N * views images.
        truth: (N * views, 3, 24, 3) joints at u = 0, 1/2 and 1 in the window's units.
        height_m: (N * views,) height of the person.
        views: of one person, in sequence; with two the difference between them counts, too.
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
    loss: torch.Tensor = (
        10 * joints
        + 5 * (_bones(claim.joints - middle) * axes).abs().mean()
        + 0.3 * likelihood
        + 6 * torch.minimum(forth, back).mean()
        + 0.05 * (sign * moved).mean()
        + _TALL * tall.mean()
    )
    if views == 1:
        return loss
    wrong = (claim.joints - middle).unflatten(0, (-1, views))
    wrong = (wrong[:, 0] - wrong[:, 1]) * axes
    height = (claim.log_height - height_m.log()).unflatten(0, (-1, views))
    apart = 10 * wrong.abs().mean() + 5 * _bones(wrong).abs().mean()
    return loss + _APART * (apart + 2 * (height[:, 0] - height[:, 1]).abs().mean())


def _bones(joints: torch.Tensor) -> torch.Tensor:
    return joints - joints[:, :1]


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_schedule_flags(parser, iterations=6000, batch=64, rate=1.5e-3, seed=0)
    add = parser.add_argument
    add("--bank", type=folder, nargs="*", default=[], metavar="DIR", help="of hfb train joints-bank")
    add(
        "--fits", type=folder, nargs="*", default=[], metavar="DIR", help="of joints-fits or joints-doubles: to compare"
    )
    add("--dev", type=folder, required=True, metavar="DIR", help="a bank to measure on while learning")
    add("--last", type=float, default=0.0, help="share of every batch that the last bank gets at least [0]")
    add("--fits-share", type=float, default=0.6, help="of the pictures of every batch [0.6]")
    add("--loaders", type=int, default=0, metavar="N", help="processes that change pictures; a GPU needs several [0]")
    add("--small", action="store_true", help="half the channels, for hfb train joints-widen")


def run(options: argparse.Namespace) -> None:
    """Train with a cosine schedule; periodically save averaged weights, measure, and read newer images.

    Args:
        options: the parsed options.
    """
    if not options.bank and not options.fits:
        raise InputError("nothing to learn from: give --bank or --fits")
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    network = JointNetwork(SMALL if options.small else WIDE)
    if options.go_on is not None:
        network.load_state_dict(read_weights(options.go_on), strict=False)  # layers that are new add nothing at first
    network = network.to(options.device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = copy.deepcopy(network)
    optimizer = Muon(network, options.rate, 0.05, _LAST)
    dev = Bank([options.dev])
    options.out.mkdir(parents=True, exist_ok=True)
    ahead = 4 if options.loaders else None
    loader = iter(DataLoader(Batches(options), batch_size=None, num_workers=options.loaders, prefetch_factor=ahead))
    schedule, last, iteration, running = Schedule(options.iterations, options.minutes), 0.0, 0, 0.0
    while (share := schedule.share(iteration)) < 1:
        network.train()
        loss = sum((_loss(network, batch.on(options.device), options) for batch in next(loader)), torch.zeros(()))
        network.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step(options.rate * min(1, (iteration + 1) / 300) * cosine(share, 0.01))
        update_average(average, network, min(_AVERAGE, (iteration + 1) / (iteration + 10)))
        running = 0.98 * running + 0.02 * loss.item()
        iteration += 1
        if schedule.minutes - last > _CHECKPOINT_MINUTES or iteration == 100:
            last = schedule.minutes
            there = copy.deepcopy(average).cpu()
            facts = {"iteration": iteration, "minutes": round(last, 1), "loss": running}
            tell(json.dumps(facts | measure(there, dev)))
            write_checkpoint(options.out / "average.pt", there.state_dict())
    average = average.cpu()
    write_checkpoint(options.out / "average.pt", average.state_dict())
    facts = _facts(options, iteration, schedule.minutes) | {"dev": measure(average, dev)}
    write_bytes_atomic(options.out / "training.json", json.dumps(facts, indent=1).encode() + b"\n")
    tell(f"{iteration} iterations in {schedule.minutes:.1f} minutes: {options.out / 'average.pt'}")


def _loss(network: JointNetwork, seen: Batch, options: argparse.Namespace) -> torch.Tensor:
    """Return a batch's share of the loss."""
    views = seen.pictures.shape[1]
    pictures = seen.pictures.flatten(0, 1).contiguous(memory_format=torch.channels_last)
    with torch.autocast(options.device, dtype=torch.bfloat16, enabled=options.bfloat16):
        claim = network(pictures, seen.starts.repeat_interleave(views, 0))
    part = loss_of(claim, seen.truth.flatten(0, 1), seen.height_m.flatten(), views)
    return len(pictures) / options.batch * part


def _facts(options: argparse.Namespace, iterations: int, minutes: float) -> dict[str, Any]:
    return {
        "iterations": iterations,
        "minutes": round(minutes, 1),
        "batch": options.batch,
        "rate": options.rate,
        "seed": options.seed,
        "after": options.go_on and options.go_on.parent.name,
        "pictures": len(Bank(options.bank)) if options.bank else 0,
        "beside": len(Bank(options.fits)) if options.fits else 0,
    }
