"""Render a bank of figures: `hfb train matting-bank --mocap DIR --photos DIR... --out bank.npy --count 2000`."""

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.errors import InputError
from hfb.photometry import srgb_to_linear
from hfb.training.flags import count, folder
from hfb.training.matting.bone_directions import read_recording
from hfb.training.matting.figures import CHANNELS, SIZE_PX, Painter, draw_figure
from hfb.training.matting.training_plates import read_photos
from hfb.training.schedule import Counter

HELD_OUT_SUBJECTS = (9, 10, 13)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add = parser.add_argument
    add("--mocap", type=folder, required=True, metavar="DIR", help="clips as BVH files, cmu_SUBJECT_TRIAL*.bvh")
    add("--photos", type=folder, nargs="*", default=[], metavar="DIR", help="pictures to wear")
    add("--out", type=Path, required=True, metavar="FILE.npy", help="where the bank goes")
    add("--count", type=count, default=2000, metavar="N", help="[2000]")
    add("--seed", type=int, default=1, metavar="S", help="of everything that is random [1]")
    add("--doubles", action="store_true", help="beside everybody somebody else, as a fit would be")
    add("--held-out", action="store_true", help="the subjects that training never sees")


def run(options: argparse.Namespace) -> None:
    """Write the bank as one array, and facts on its figures as JSON.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    recordings = [read_recording(path) for path in sorted(options.mocap.glob("*.bvh"))]
    recordings = [one for one in recordings if (one.subject in HELD_OUT_SUBJECTS) == options.held_out]
    if not recordings:
        raise InputError(f"{options.mocap} has no clips of {'held-out' if options.held_out else 'other'} subjects")
    photos = read_photos(options.photos, options.held_out)
    photos = [srgb_to_linear(photo.astype(np.float32) / 255).astype(np.float32) for photo in photos]
    painter, facts = Painter(load_default_body()), []
    channels = CHANNELS * (1 + options.doubles)
    shape = (options.count, channels, SIZE_PX, SIZE_PX)
    bank = np.lib.format.open_memmap(options.out, mode="w+", dtype=np.uint8, shape=shape)
    counter = Counter("figures", 100)
    for number in range(options.count):
        rng = np.random.default_rng([options.seed, number])
        figure = draw_figure(painter, recordings, photos, rng, options.doubles)
        bank[number] = figure.channels
        facts.append({"smear_px": figure.smear_px, "exposure_s": figure.exposure_s, "source": figure.source})
        counter.reached(number + 1)
    bank.flush()
    options.out.with_suffix(".json").write_text(json.dumps({"seed": options.seed, "figures": facts}))
