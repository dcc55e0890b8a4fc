"""Render a bank of figures: `python bank.py --mocap FOLDER --photos FOLDER... --out bank.npy --count 2000 --seed 1`."""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from figures import CHANNELS, SIZE_PX, Painter, draw_figure
from motions import read_recording
from plates import read_photos

from hfb.body.assets import load_default_body
from hfb.photometry import srgb_to_linear

HELD_OUT_SUBJECTS = (9, 10, 13)


def main() -> None:
    """Write the bank as one array and its facts beside it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--photos", type=Path, nargs="*", default=[])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--doubles", action="store_true", help="beside everybody somebody else, as a fit would be")
    parser.add_argument("--held-out", action="store_true", help="the subjects that training never sees")
    options = parser.parse_args()
    torch.set_num_threads(1)
    recordings = [read_recording(path) for path in sorted(options.mocap.glob("*.bvh"))]
    recordings = [one for one in recordings if (one.subject in HELD_OUT_SUBJECTS) == options.held_out]
    photos = read_photos(options.photos, options.held_out)
    photos = [srgb_to_linear(photo.astype(np.float32) / 255).astype(np.float32) for photo in photos]
    painter, facts = Painter(load_default_body()), []
    channels = CHANNELS * (1 + options.doubles)
    bank = np.lib.format.open_memmap(
        options.out, mode="w+", dtype=np.uint8, shape=(options.count, channels, SIZE_PX, SIZE_PX)
    )
    started = time.monotonic()
    for number in range(options.count):
        rng = np.random.default_rng([options.seed, number])
        figure = draw_figure(painter, recordings, photos, rng, options.doubles)
        bank[number] = figure.channels
        facts.append({"smear_px": figure.smear_px, "exposure_s": figure.exposure_s, "source": figure.source})
        if number % 100 == 99:
            print(f"{number + 1} figures in {time.monotonic() - started:.0f} s", flush=True)
    bank.flush()
    options.out.with_suffix(".json").write_text(json.dumps({"seed": options.seed, "figures": facts}))


if __name__ == "__main__":
    main()
