"""Train and ship the depth fusion: `python train_fusion.py --fits f1.npz f2.npz --held-out fdev.npz --out FOLDER`.

Learns from fits alone (`lifting_fits.py`), of one frame and of two. What the lifting network says of them is asked
anew: its weights are those of the package.
"""

import argparse
import copy
import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save

from hfb.body.skeleton import MIRROR
from hfb.evidence.depth_fusion import DepthCues, DepthFusion, facts_both_ways
from hfb.io.array_files import read_arrays

_BATCH = 128
_RATE, _DECAY = 2e-3, 0.1
_CHECK_EVERY = 500


@dataclass(frozen=True)
class Rows:
    """N frames of fits, each with its mirror image; in units of their windows.

    Attributes:
        facts: (N, 2, 24, f). lifted: (N, 2, 24) depth by the lifting network. truth: (N, 2, 24).
        unit_m: (N, 1, 1). other: of the held-out ones, (N, 24) by what is told of depth and by name.
    """

    facts: torch.Tensor
    lifted: torch.Tensor
    truth: torch.Tensor
    unit_m: torch.Tensor
    other: dict[str, torch.Tensor]

    @staticmethod
    def read(path: Path) -> "Rows":
        """A file of lifting_fits.py."""
        file = {name: torch.from_numpy(np.asarray(values)) for name, values in read_arrays(path).items()}
        mirror, rows = list(MIRROR), []
        for row in range(len(file["joints"])):
            cues = DepthCues(*(file[name][row].float() for name in (
                "fitted", "starts", "fitted_lengths", "perspective", "unit_m", "claimed", "claimed_scale", "shown"
            )))  # fmt: skip
            lifted, truth = cues.lifted(), _depth(file["joints"][row])
            both = facts_both_ways(cues, lifted).transpose(0, 1)
            deep = {name: _depth(file[name][row]) for name in ("claimed", "shown", "fitted")}
            two = (torch.stack([one, one[:, mirror]], 1) for one in (lifted, truth))
            rows.append(Rows(both, *two, file["unit_m"][row][:, None, None], deep))
        return Rows.joined(rows)

    @staticmethod
    def joined(parts: "list[Rows]") -> "Rows":
        """All of them."""
        tensors = (torch.cat([getattr(one, name) for one in parts]) for name in ("facts", "lifted", "truth", "unit_m"))
        return Rows(*tensors, {name: torch.cat([one.other[name] for one in parts]) for name in parts[0].other})

    def __len__(self) -> int:
        return len(self.truth)

    def off_mm(self, depth: torch.Tensor) -> torch.Tensor:
        """Mean error of depths (n, 2, 24) of all frames."""
        return 1000 * ((depth - self.truth).abs() * self.unit_m).mean()

    def batch(self, count: int) -> "Rows":
        """Some of them."""
        chosen = torch.randint(len(self), (count,))
        return Rows(self.facts[chosen], self.lifted[chosen], self.truth[chosen], self.unit_m[chosen], {})


def _depth(joints: torch.Tensor) -> torch.Tensor:
    return (joints - joints[..., :1, :])[..., 2].float()


def measure(network: DepthFusion, rows: Rows) -> dict[str, float]:
    """Errors of depth [mm]: of all that is told, of what shipped before, and of the network."""
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


def main() -> None:
    """AdamW on L1 in millimetres, a cosine over the iterations, averaged weights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=Path, nargs="+", required=True)
    parser.add_argument("--held-out", type=Path, nargs="+", required=True, help="of motions that training never saw")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--iterations", type=int, default=2000)
    options = parser.parse_args()
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
        optimizer.param_groups[0]["lr"] = _RATE * (1 + math.cos(math.pi * iteration / options.iterations)) / 2
        some = rows.batch(_BATCH)
        optimizer.zero_grad()
        some.off_mm(some.lifted + network(some.facts)).backward()
        optimizer.step()
        with torch.no_grad():
            for mean, new in zip(average.parameters(), network.parameters(), strict=True):
                mean.lerp_(new, 0.01)
        if (iteration + 1) % _CHECK_EVERY == 0 or iteration + 1 == options.iterations:
            figures = {"learned from": rows, **held_out}
            told = {name: measure(average, one) for name, one in figures.items()}
            print(json.dumps({"iteration": iteration + 1} | told), flush=True)
    export(average, held_out, options.out, {"frames": len(rows), "iterations": options.iterations, "batch": _BATCH})


def export(network: DepthFusion, held_out: dict[str, Rows], folder: Path, training: dict[str, float]) -> None:
    """Write the weights and, beside them, what made them."""
    content = save({name: values.contiguous() for name, values in sorted(network.state_dict().items())})
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "depth_fusion.safetensors").write_bytes(content)
    about = {
        "weights": "depth_fusion.safetensors",
        "sha256": hashlib.sha256(content).hexdigest(),
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "motions": "as of lifting.json",
        "training": training,
        "held_out": {name: measure(network, rows) for name, rows in held_out.items()},
    }
    (folder / "depth_fusion.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    main()
