"""Measure the third network: `python beside.py --bank held_out.npy --photos FOLDER... --out table.json`.

The bank is one of `bank.py --doubles --held-out`. Of every scene the shipped method finds a matte; the third network
finds it again beside a double.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from measure import held_out_scenes, network_of

from hfb.errors import InputError
from hfb.matting.network import NetworkMatting, RenderConditionedMatting
from hfb.matting.third_look import FIT_CHANNELS, SHARED_CHANNELS


def main() -> None:
    """Print a table; write every figure to --out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--photos", type=Path, nargs="+", required=True)
    parser.add_argument("--weights", type=Path, help="folded.pt or .safetensors; the shipped ones if not given")
    parser.add_argument("--per-family", type=int, default=15)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    matting, network = NetworkMatting(), network_of(options.weights, SHARED_CHANNELS + FIT_CHANNELS)
    errors: dict[str, list[list[float]]] = {}
    for family, _, scene in held_out_scenes(options.bank, options.photos, options.per_family):
        if scene.double is None:
            parser.error(f"{options.bank} has no doubles; make it with bank.py --doubles")
        try:
            before = matting(scene.frame, scene.plate)
        except InputError:
            continue
        after = RenderConditionedMatting(scene.frame, scene.plate, before).matte(scene.double, network)
        off = [
            float(np.abs(one - scene.alpha).sum() / scene.alpha.sum()) for one in (before, scene.double[..., 3], after)
        ]
        for group in (family, "all"):
            errors.setdefault(group, []).append(off)
    table = {}
    for group, rows in errors.items():
        before, double, after = np.mean(rows, 0)
        table[group] = {"before": before, "double": double, "after": after, "n": len(rows)}
        print(f"{group:28s} {len(rows):4d}  before {before:.4f}  double {double:.4f}  after {after:.4f}")
    if options.out:
        options.out.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
