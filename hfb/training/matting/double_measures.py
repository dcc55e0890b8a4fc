"""Measure the third matting network: `hfb train matting-doubles --bank held_out.npy --photos DIR...`.

The bank is one of `hfb train matting-bank --doubles --held-out`. The shipped method estimates a matte of every scene;
the third network refines it with a double in place of a fit.
"""

import argparse
import json

import numpy as np
import torch

from hfb.errors import InputError
from hfb.matting.network import NetworkMatting, RenderConditionedMatting
from hfb.matting.third_look import FIT_CHANNELS, SHARED_CHANNELS
from hfb.training.matting.matte_measures import add_scene_flags, held_out_scenes, network_of


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_scene_flags(parser, per_family=15)


def run(options: argparse.Namespace) -> None:
    """Print a table; write every figure to --out.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    matting, network = NetworkMatting(), network_of(options.weights, SHARED_CHANNELS + FIT_CHANNELS)
    errors: dict[str, list[list[float]]] = {}
    for family, _, scene in held_out_scenes(options.bank, options.photos, options.per_family):
        if scene.double is None:
            raise InputError(f"{options.bank} has no doubles; make it with hfb train matting-bank --doubles")
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
