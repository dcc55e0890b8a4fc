"""Train and export the depth fusion: `hfb train fusion --fits f1.npz f2.npz --held-out fdev.npz --out DIR`.

It learns from fits alone (`lifting_fits`), of one frame and of two. The lifting network's depth is computed anew with
the package's weights.
"""

import argparse
import copy
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hfb.body.skeleton import MIRROR
from hfb.evidence.depth_fusion import DepthCues, DepthFusion, facts_both_ways
from hfb.io.array_files import read_arrays
from hfb.training.flags import count, file
from hfb.training.schedule import cosine, tell, update_average
from hfb.training.weight_files import count_parameters, publish

_BATCH = 128
_RATE, _DECAY = 2e-3, 0.1
_CHECK_EVERY = 500


@dataclass(frozen=True)
class Rows:
    """N frames of fits, each with its mirror image, in units of their windows.

    Attributes:
        facts: (N, 2, 24, f) input of the network.
        lifted: (N, 2, 24) depth from the lifting network.
        truth: (N, 2, 24) true depth.
        unit_m: (N, 1, 1) the unit's length.
        other: of held-out rows, other estimates of depth (N, 24) by name.
    """

    facts: torch.Tensor
    lifted: torch.Tensor
    truth: torch.Tensor
    unit_m: torch.Tensor
    other: dict[str, torch.Tensor]

    @staticmethod
    def read(path: Path) -> "Rows":
        """Read a file of `lifting_fits`.

        Args:
            path: the file.
        """
        file = {name: torch.from_numpy(np.asarray(values)) for name, values in read_arrays(path).items()}
        mirror, rows = list(MIRROR), []
        for row in range(len(file["joints"])):
            cues = DepthCues(
                *(
                    file[name][row].float()
                    for name in (
                        "fitted",
                        "starts",
                        "fitted_lengths",
                        "perspective",
                        "unit_m",
                        "claimed",
                        "claimed_scale",
                        "shown",
                    )
                )
            )
            lifted, truth = cues.lifted(), _depth(file["joints"][row])
            both = facts_both_ways(cues, lifted).transpose(0, 1)
            deep = {name: _depth(file[name][row]) for name in ("claimed", "shown", "fitted")}
            lifted, truth = (torch.stack([one, one[:, mirror]], 1) for one in (lifted, truth))
            rows.append(Rows(both, lifted, truth, file["unit_m"][row][:, None, None], deep))
        return Rows.joined(rows)

    @staticmethod
    def joined(parts: "list[Rows]") -> "Rows":
        """Concatenate rows.

        Args:
            parts: at least one.
        """
        facts, lifted, truth, unit_m = (
            torch.cat([getattr(one, name) for one in parts]) for name in ("facts", "lifted", "truth", "unit_m")
        )
        return Rows(
            facts,
            lifted,
            truth,
            unit_m,
            {name: torch.cat([one.other[name] for one in parts]) for name in parts[0].other},
        )

    def __len__(self) -> int:
        return len(self.truth)

    def off_mm(self, depth: torch.Tensor) -> torch.Tensor:
        """Return the mean depth error of all frames [mm].

        Args:
            depth: (n, 2, 24) in units of the windows.
        """
        return 1000 * ((depth - self.truth).abs() * self.unit_m).mean()

    def batch(self, count: int) -> "Rows":
        """Draw random rows.

        Args:
            count: how many.
        """
        chosen = torch.randint(len(self), (count,))
        return Rows(self.facts[chosen], self.lifted[chosen], self.truth[chosen], self.unit_m[chosen], {})


def _depth(joints: torch.Tensor) -> torch.Tensor:
    return (joints - joints[..., :1, :])[..., 2].float()


def measure(network: DepthFusion, rows: Rows) -> dict[str, float]:
    """Return depth errors [mm] of every input estimate, of the earlier fixed shares, and of the network.

    Args:
        network: in training; set to evaluation meanwhile.
        rows: held out.
    """
    network.eval()
    told = rows.other | {"lifted": rows.lifted[:, 0]}
    shares = 0.75 * told["lifted"] + told["claimed"] - 0.75 * told["shown"]
    mirror = list(MIRROR)
    with torch.no_grad():
        said = network(rows.facts)
    fused = rows.lifted[:, 0] + (said[:, 0] + said[:, 1][:, mirror]) / 2
    depths = told | {"fixed shares": shares, "fused": fused}
    figures = {name: rows.off_mm(torch.stack([one, one[:, mirror]], 1)) for name, one in depths.items()}
    network.train()
    return {name: round(float(value), 2) for name, value in figures.items()}


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add = parser.add_argument
    add("--fits", type=file, nargs="+", required=True, metavar="FILE", help="of hfb train lifting-fits")
    add("--held-out", type=file, nargs="+", required=True, metavar="FILE", help="of motions that training never saw")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for depth_fusion.safetensors and .json")
    add("--iterations", type=count, default=2000, metavar="N", help="[2000]")


def run(options: argparse.Namespace) -> None:
    """Train by AdamW on L1 in millimetres with a cosine schedule and averaged weights.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    torch.manual_seed(0)
    rows = Rows.joined([Rows.read(path) for path in options.fits])
    held_out = {path.stem: Rows.read(path) for path in options.held_out}
    network = DepthFusion()
    network.mean.copy_(rows.facts.flatten(0, 2).mean(0))
    network.spread.copy_(rows.facts.flatten(0, 2).std(0) + 1e-3)
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=_DECAY)
    for iteration in range(options.iterations):
        optimizer.param_groups[0]["lr"] = _RATE * cosine(iteration / options.iterations)
        some = rows.batch(_BATCH)
        optimizer.zero_grad()
        some.off_mm(some.lifted + network(some.facts)).backward()
        optimizer.step()
        update_average(average, network, 0.99)
        if (iteration + 1) % _CHECK_EVERY == 0 or iteration + 1 == options.iterations:
            figures = {"learned from": rows, **held_out}
            told = {name: measure(average, one) for name, one in figures.items()}
            tell(json.dumps({"iteration": iteration + 1} | told))
    about = {
        "motions": "as of lifting.json",
        "training": {"frames": len(rows), "iterations": options.iterations, "batch": _BATCH},
        "held_out": {name: measure(average, rows) for name, rows in held_out.items()},
    }
    state = {name: values.contiguous() for name, values in sorted(average.state_dict().items())}
    publish(options.out, "depth_fusion", state, count_parameters(average), about)
