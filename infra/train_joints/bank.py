"""Draw training pictures: `python bank.py --mocap FOLDER --backgrounds FOLDER --out bank --count 20000 --seed 1`."""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from people import STARTS
from pictures import Studio

from hfb.initialize.joint_network import CHANNELS, PICTURE_PX

TRAINING_SUBJECTS = (1, 2, 3, 5, 6, 7, 8, 11, 12, 14)
"""Subjects 9, 10 and 13 are for reports alone."""

SPLITS = ("train", "dev", "dev-other", "all", "report")

_OTHER = "_daz"
"""In the names of clips of another conversion (`cut.py`), whose skeleton is the reports' one."""


def split(mocap: Path, chosen: str) -> list[str]:
    """Names of clips: ``train``, ``dev`` (every fourth clip or take of the training subjects), ``all`` or ``report``.

    No take of the other conversion is learned from that is held out, whole or in part, in the first one.
    """
    names = sorted(path.stem for path in mocap.glob("*.bvh"))
    ours = [name for name in names if int(name.split("_")[1]) in TRAINING_SUBJECTS]
    first, others = ([name for name in ours if (_OTHER in name) == other] for other in (False, True))
    held_out = {_take(name) for name in first[3::4]}
    held_out |= set(sorted({_take(name) for name in others} - {_take(name) for name in first})[3::4])
    return {
        "train": [name for index, name in enumerate(first) if index % 4 != 3]
        + [name for name in others if _take(name) not in held_out],
        "dev": first[3::4],
        "dev-other": [name for name in others if _take(name) in held_out],
        "all": ours,
        "report": [name for name in names if name not in ours],
    }[chosen]


def _take(clip: str) -> str:
    """Subject and trial, the same in both conversions."""
    return "_".join(clip.split("_")[1:3])


def main() -> None:
    """Write pictures, truths and starts as three arrays."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--backgrounds", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frame-px", type=int, default=256, help="width of a frame; 144 until run17")
    parser.add_argument("--split", default="train", choices=SPLITS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    studio = Studio(
        options.mocap, options.backgrounds, split(options.mocap, options.split), options.seed, options.frame_px
    )
    options.out.mkdir(parents=True, exist_ok=True)
    shape = (options.count, CHANNELS, PICTURE_PX, PICTURE_PX)
    pictures = np.lib.format.open_memmap(options.out / "pictures.npy", mode="w+", dtype=np.uint8, shape=shape)
    truth = np.zeros((options.count, 3, 24, 3), np.float32)
    starts = np.zeros((options.count, STARTS, 24, 3), np.float32)
    unit_m, height_m = np.zeros((2, options.count), np.float32)
    began = time.monotonic()

    def save(done: int) -> None:
        pictures.flush()
        part = options.out / "joints.part.npz"
        np.savez(part, truth=truth, starts=starts, unit_m=unit_m, height_m=height_m, done=done)
        part.rename(options.out / "joints.npz")  # training may read while this draws

    for number in range(options.count):
        sample = studio.draw(np.random.default_rng([options.seed, options.first + number]))
        pictures[number], truth[number], starts[number] = sample.picture, sample.truth, sample.starts
        unit_m[number], height_m[number] = sample.unit_m, sample.height_m
        if number % 1000 == 999 or number == 49:
            print(f"{number + 1} pictures in {time.monotonic() - began:.0f} s", flush=True)
            save(number + 1)
    save(options.count)


if __name__ == "__main__":
    main()
