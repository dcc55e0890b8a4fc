"""Train and export the lifting network: `hfb train lifting --bank l1.npz --held-out dev.npz --out DIR`.

Fits (`lifting_fits`), where given, are a share of every batch: a fit's errors are correlated with the evidence it
follows, which synthetic noise does not reproduce.
"""

import argparse
import copy
import json
import math
from pathlib import Path

import torch

from hfb.evidence.lifting_network import LiftingNetwork
from hfb.training.flags import add_schedule_flags, file
from hfb.training.joints.joint_bank import FURTHER_SUBJECTS, TRAINING_SUBJECTS
from hfb.training.lifting.lifting_people import Bank, Fitted, as_fitted, augmented
from hfb.training.schedule import Schedule, cosine, tell, update_average
from hfb.training.weight_files import count_parameters, half, publish, read_weights

_ALONE = 0.3
_COORDINATES = (0.5, 0.5, 2.0)
"""Weights of x, y and z: a fit uses depth alone."""
_CHECK_EVERY = 500


def _looked_at(network: LiftingNetwork, fitted: Fitted, alone: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the network's output for each first frame, some (alone, (N,) bool) without the second."""
    told = (
        torch.stack([one[:, 0], torch.where(alone.view(-1, *[1] * (one.ndim - 2)), one[:, 0], one[:, 1])], 1)
        for one in fitted.told
    )
    said: tuple[torch.Tensor, torch.Tensor] = network(*told)
    return said


def measure(network: LiftingNetwork, fitted: Fitted, alone: bool) -> dict[str, float]:
    """Return errors from the pelvis [mm]: of first estimates, of the fit's joints in the image plane, of the network.

    Args:
        network: in evaluation.
        fitted: held-out people.
        alone: whether the network sees the first frame only.
    """
    across, start, truth = fitted.told[0][:, 0], fitted.told[1][:, 0], fitted.truth[:, 0]
    with torch.no_grad():
        off = _looked_at(network, fitted, torch.full((len(truth),), alone))[0] - truth
    mm = 1000 * fitted.unit_m[:, :1]
    figures = {
        "start": (start - truth).norm(dim=-1),
        "given": (across - truth[..., :2]).norm(dim=-1),
        "joints": off.norm(dim=-1),
        "across": off[..., :2].norm(dim=-1),
        "depth": off[..., 2].abs(),
    }
    return {name: round(float((values * mm).mean()), 1) for name, values in figures.items()}


def measured(network: LiftingNetwork, held_out: dict[str, Fitted]) -> dict[str, dict[str, float]]:
    """Return `measure` of every kind of people, single frames and pairs.

    Args:
        network: in evaluation.
        held_out: name -> people.
    """
    return {
        f"{name}, {kind}": measure(network, people, kind == "alone")
        for name, people in held_out.items()
        for kind in ("alone", "pair")
    }


def held_out_people(bank: Path, fits: Path | None) -> dict[str, Fitted]:
    """Return held-out people by the kind of error: synthetic at two levels, and fits where given.

    Args:
        bank: a file of lifting-bank.
        fits: a file of lifting-fits, or None.
    """
    torch.manual_seed(5)
    people = Bank.read([bank])
    drawn = {f"errors times {level}": as_fitted(people, torch.full((len(people),), level)) for level in (0.5, 1.0)}
    return drawn | ({} if fits is None else {"fits": Fitted.read([fits])})


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_schedule_flags(parser, iterations=1_000_000, batch=512, rate=1.5e-3, seed=0)
    parser.set_defaults(minutes=30.0)
    add = parser.add_argument
    add("--bank", type=file, nargs="+", required=True, metavar="FILE", help="of hfb train lifting-bank")
    add("--held-out", type=file, required=True, metavar="FILE", help="of motions that training never saw")
    add("--fits", type=file, nargs="+", default=[], metavar="FILE", help="of lifting-fits, to learn from, too")
    add("--fits-share", type=float, default=0.2, help="of every batch [0.2]")
    add("--held-out-fits", type=file, metavar="FILE", help="fits to measure on")


def run(options: argparse.Namespace) -> None:
    """Train by AdamW on L1 and a Laplace likelihood with a cosine schedule; averaged weights go to half precision.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(options.threads)
    bank, held_out = Bank.read(options.bank), held_out_people(options.held_out, options.held_out_fits)
    fits = Fitted.read(options.fits) if options.fits else None
    of_fits = round(options.fits_share * options.batch) if fits else 0
    torch.manual_seed(options.seed)
    network = LiftingNetwork()
    if options.go_on is not None:
        network.load_state_dict(read_weights(options.go_on))
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=0.03, fused=True)
    schedule, iteration = Schedule(options.iterations, options.minutes), 0
    while (share := schedule.share(iteration)) < 1:
        optimizer.param_groups[0]["lr"] = options.rate * min(1, (iteration + 1) / 200) * cosine(share) + 1e-6
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
        update_average(average, network, 0.998 if iteration > 1000 else 0.98)
        iteration += 1
        if iteration % _CHECK_EVERY == 0:
            tell(json.dumps({"iteration": iteration} | measured(average, held_out)))
    training = {
        "people": len(bank),
        "fits": 0 if fits is None else len(fits.truth),
        "iterations": iteration,
        "batch": options.batch,
        "of_fits": of_fits,
        "rate": options.rate,
    }
    export(average, held_out, options.out, training)
    tell(f"{iteration} iterations in {schedule.minutes:.1f} minutes: {options.out / 'lifting.safetensors'}")


def export(network: LiftingNetwork, held_out: dict[str, Fitted], folder: Path, training: dict[str, float]) -> None:
    """Write half-precision weights and their provenance.

    Args:
        network: trained.
        held_out: name -> people, to measure on.
        folder: for lifting.safetensors and lifting.json.
        training: facts of the training.
    """
    state = half(network.state_dict())
    network.load_state_dict({name: values.float() for name, values in state.items()})
    about = {
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
    publish(folder, "lifting", state, count_parameters(network), about)
