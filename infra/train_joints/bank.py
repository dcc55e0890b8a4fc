"""Draw training pictures: `python bank.py --mocap FOLDER --backgrounds FOLDER --out bank --count 20000 --seed 1`."""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from people import STARTS
from pictures import Sample, Studio

from hfb.evidence.joint_network import CHANNELS, PICTURE_PX

TRAINING_SUBJECTS = (1, 2, 3, 5, 6, 7, 8, 11, 12, 14)
"""Subjects 9, 10 and 13 are for reports alone."""

FURTHER_SUBJECTS = (60, 61, 94, 135)
"""Learned from whole, so that what is held out of the others stays what it was."""

SPLITS = ("train", "dev", "dev-other", "all", "report")

_OTHER = "_daz"
"""In the names of clips of another conversion (`cut.py`), whose skeleton is the reports' one."""


def split(mocap: Path, chosen: str) -> list[str]:
    """Names of clips: ``train``, ``dev`` (every fourth clip or take of the training subjects), ``all`` or ``report``.

    No take of the other conversion is learned from that is held out, whole or in part, in the first one.
    """
    names = sorted(path.stem for path in mocap.glob("*.bvh"))
    ours, further = (
        [name for name in names if int(name.split("_")[1]) in subjects]
        for subjects in (TRAINING_SUBJECTS, FURTHER_SUBJECTS)
    )
    first, others = ([name for name in ours if (_OTHER in name) == other] for other in (False, True))
    held_out = {_take(name) for name in first[3::4]}
    held_out |= set(sorted({_take(name) for name in others} - {_take(name) for name in first})[3::4])
    return {
        "train": [name for index, name in enumerate(first) if index % 4 != 3]
        + [name for name in others if _take(name) not in held_out]
        + further,
        "dev": first[3::4],
        "dev-other": [name for name in others if _take(name) in held_out],
        "all": ours + further,
        "report": [name for name in names if name not in ours + further],
    }[chosen]


def _take(clip: str) -> str:
    """Subject and trial, the same in both conversions."""
    return "_".join(clip.split("_")[1:3])


class Rows:
    """A bank that is being drawn: pictures, truths and starts as two files, which training may read meanwhile."""

    def __init__(self, folder: Path, count: int, views: tuple[int, ...], starts: int) -> None:
        """Room for so many samples of some views each."""
        folder.mkdir(parents=True, exist_ok=True)
        shape = (count, *views, CHANNELS, PICTURE_PX, PICTURE_PX)
        self._pictures = np.lib.format.open_memmap(folder / "pictures.npy", mode="w+", dtype=np.uint8, shape=shape)
        self._joints = {
            "truth": np.zeros((count, *views, 3, 24, 3), np.float32),
            "starts": np.zeros((count, starts, 24, 3), np.float32),
            "unit_m": np.zeros(count, np.float32),
            "height_m": np.zeros((count, *views), np.float32),
        }
        self._folder, self._done, self._began = folder, 0, time.monotonic()

    @property
    def full(self) -> bool:
        """Whether there is no more room."""
        return self._done == len(self._pictures)

    def add(self, sample: Sample) -> None:
        """The next one, where there is room."""
        if self.full:
            return
        self._pictures[self._done] = sample.picture
        for name, values in self._joints.items():
            values[self._done] = getattr(sample, name)
        self._done += 1
        if self._done % 250 == 0 or self._done == 20:
            print(f"{self._done} pictures in {time.monotonic() - self._began:.0f} s", flush=True)
            self.save()

    def save(self) -> None:
        """What there is, whole."""
        self._pictures.flush()
        part = self._folder / "joints.part.npz"
        np.savez(part, **self._joints, done=self._done)
        part.rename(self._folder / "joints.npz")


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """What to draw from, how much and where to."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--backgrounds", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frame-px", type=int, default=256, help="width of a frame; 144 until run17")
    parser.add_argument("--split", default="train", choices=SPLITS)
    return parser


def main() -> None:
    """Write pictures, truths and starts."""
    parser = parser_of(__doc__)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    studio = Studio(
        options.mocap, options.backgrounds, split(options.mocap, options.split), options.seed, options.frame_px
    )
    rows = Rows(options.out, options.count, (), STARTS)
    for number in range(options.count):
        rows.add(studio.draw(np.random.default_rng([options.seed, options.first + number])))
    rows.save()


if __name__ == "__main__":
    main()
