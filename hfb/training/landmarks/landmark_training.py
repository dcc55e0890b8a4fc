"""Train the landmark lift: `hfb train landmarks --bank b1.npz b2.npz --out DIR`."""

import argparse
import copy
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hfb.initialization.landmark_lift import HIPS, JOINT_POINTS, SWAPPED, LandmarkLift, Sighting, turned_about_axis
from hfb.io.array_files import read_arrays
from hfb.training.flags import add_schedule_flags, file
from hfb.training.schedule import Schedule, cosine, tell, update_average
from hfb.training.weight_files import count_parameters, half, publish

_HELD_OUT_EVERY = 10
_MOST_ACROSS_M = 0.08
"""Mean error across the view beyond which a sighting is not learned from: the start then comes from elsewhere."""
_COORDINATES = (0.7, 0.7, 1.3)
_TURN_RAD, _ACROSS_NOISE_M, _GUESS_NOISE_M = 0.12, 0.016, (0.02, 0.02, 0.04)
_CHECK_EVERY = 500


@dataclass(frozen=True)
class Lessons:
    """Sightings and the true points (N, 19, 3) in their units."""

    seen: Sighting
    truth: torch.Tensor

    @staticmethod
    def read(paths: list[Path]) -> "Lessons":
        """Read files of landmarks-bank, without sightings that err grossly across the view.

        Args:
            paths: the files.
        """
        parts = [read_arrays(path) for path in paths]
        named = {name: torch.from_numpy(np.concatenate([part[name] for part in parts])).float() for name in parts[0]}
        seen = Sighting.of(named["rays"], named["world"], named["visibility"])
        hips = named["truth"][:, HIPS].mean(1)
        truth = (named["truth"] - hips[:, None]) * (seen.distance_m / hips[:, 2])[:, None, None]
        across = (seen.across - truth[..., :2])[:, : len(JOINT_POINTS)].norm(dim=-1).mean(1)
        return Lessons(seen, truth).some(across < _MOST_ACROSS_M)

    def some(self, chosen: torch.Tensor) -> "Lessons":
        """Return chosen ones.

        Args:
            chosen: indices or a mask.
        """
        return Lessons(Sighting(*(getattr(self.seen, name)[chosen] for name in _FIELDS)), self.truth[chosen])

    def varied(self) -> "Lessons":
        """Return each mirrored or not, turned a little in the image, with a little noise."""
        seen, other, count = self.seen, self.seen.mirrored(), len(self.truth)
        turned = torch.tensor([-1.0, 1.0, 1.0])
        flip = torch.rand(count) < 0.5
        rows = [
            torch.where(flip.view(-1, *[1] * (one.ndim - 1)), two, one)
            for one, two in (
                *((getattr(seen, name), getattr(other, name)) for name in _FIELDS),
                (self.truth, self.truth[:, SWAPPED] * turned),
            )
        ]
        across, guess, sure, ray, distance, truth = rows
        angle = _TURN_RAD * torch.randn(count)
        cosine_, sine = angle.cos(), angle.sin()
        R = torch.stack([torch.stack([cosine_, -sine], -1), torch.stack([sine, cosine_], -1)], -2)
        across, ray = across @ R.transpose(1, 2), (ray[:, None] @ R.transpose(1, 2))[:, 0]
        guess, truth = turned_about_axis(guess, R), turned_about_axis(truth, R)
        across = across + _ACROSS_NOISE_M * torch.rand(count, 1, 1) * torch.randn_like(across)
        guess = guess + torch.tensor(_GUESS_NOISE_M) * torch.rand(count, 1, 1) * torch.randn_like(guess)
        return Lessons(Sighting(across, guess, sure, ray, distance), truth)


_FIELDS = ("across", "guess", "sure", "ray", "distance_m")


def measure(network: LandmarkLift, lessons: Lessons) -> dict[str, dict[str, float]]:
    """Return mean errors of the twelve joints about the hips [mm], of the landmarks and of the network.

    Args:
        network: in evaluation.
        lessons: held-out ones.
    """
    with torch.no_grad():
        said, _ = network(lessons.seen)
    landmarks = torch.cat([lessons.seen.across, lessons.seen.guess[..., 2:]], -1)
    figures = {}
    for name, points in (("landmarks", landmarks), ("lifted", said)):
        off = 1000 * (points - lessons.truth)[:, : len(JOINT_POINTS)]
        figures[name] = {
            "joints": round(float(off.norm(dim=-1).mean()), 1),
            "across": round(float(off[..., :2].norm(dim=-1).mean()), 1),
            "depth": round(float(off[..., 2].abs().mean()), 1),
        }
    return figures


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_schedule_flags(parser, iterations=4000, batch=512, rate=1e-3, seed=0)
    parser.add_argument("--bank", type=file, nargs="+", required=True, metavar="FILE", help="of landmarks-bank")


def run(options: argparse.Namespace) -> None:
    """Train by AdamW on L1 and a Laplace likelihood with a cosine schedule; averaged weights go to half precision.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(options.threads)
    every = Lessons.read(options.bank)
    held = torch.arange(len(every.truth)) % _HELD_OUT_EVERY == 0
    lessons, held_out = every.some(~held), every.some(held)
    torch.manual_seed(options.seed)
    network = LandmarkLift()
    average = copy.deepcopy(network).eval()
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=0.1)
    schedule, iteration = Schedule(options.iterations, options.minutes), 0
    while (share := schedule.share(iteration)) < 1:
        optimizer.param_groups[0]["lr"] = options.rate * min(1, (iteration + 1) / 100) * cosine(share) + 1e-6
        batch = lessons.some(torch.randint(len(lessons.truth), (options.batch,))).varied()
        points, log_scale = network(batch.seen)
        error = (points - batch.truth).abs()
        likelihood = error.detach() * torch.exp(-log_scale) + log_scale
        optimizer.zero_grad()
        ((10 * error + 0.3 * likelihood) * torch.tensor(_COORDINATES)).mean().backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        update_average(average, network, 0.99 if iteration > 300 else 0.9)
        iteration += 1
        if iteration % _CHECK_EVERY == 0:
            tell(json.dumps({"iteration": iteration} | measure(average, held_out)))
    state = half(average.state_dict())
    average.load_state_dict({name: values.float() for name, values in state.items()})
    about = {
        "people": "rendered, seen by MediaPipe's heavy landmark network; motions: CMU Graphics Lab "
        "Motion Capture Database (mocap.cs.cmu.edu, funding from NSF EIA-0196217), training subjects alone, limbs lent "
        "between clips, joints bent; a quarter generated",
        "training": {
            "people": len(lessons.truth),
            "iterations": iteration,
            "batch": options.batch,
            "rate": options.rate,
        },
        "held_out": {"people": len(held_out.truth)} | measure(average, held_out),
    }
    publish(options.out, "landmark_lift", state, count_parameters(average), about)
    tell(f"{iteration} iterations in {schedule.minutes:.1f} minutes: {options.out / 'landmark_lift.safetensors'}")
