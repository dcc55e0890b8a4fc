"""Draw training images: `hfb train joints-bank --mocap DIR --backgrounds DIR --out bank --count 20000 --seed 1`."""

import argparse
import itertools
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import torch

from hfb.errors import InputError
from hfb.evidence.joint_network import CHANNELS, PICTURE_PX
from hfb.training.flags import add_drawing_flags
from hfb.training.joints.blurred_people import Sample, Studio
from hfb.training.joints.people import STARTS
from hfb.training.schedule import Counter

TRAINING_SUBJECTS = (1, 2, 3, 5, 6, 7, 8, 11, 12, 14)
"""Subjects to train on; 9, 10 and 13 are for reports alone."""

FURTHER_SUBJECTS = (60, 61, 94, 135)
"""Subjects without held-out takes, so that the held-out takes of the others stay the same."""

_NAME = re.compile(r"[^_]+_\d+_")
_OTHER = "_daz"
"""Part of names of clips in the second conversion (`cut_recordings`), whose skeleton is the reports' one."""


def split(mocap: Path, chosen: str) -> list[str]:
    """Return the clip names of a split; ``dev`` is every fourth clip or take of the training subjects.

    A take of the second conversion that is held out in the first one, whole or in part, is not trained on.

    Args:
        mocap: folder of clips named cmu_SUBJECT_TRIAL*.bvh.
        chosen: one of `hfb.training.flags.SPLITS`.

    Raises:
        InputError: the folder has no clips, or their names tell no subject.
    """
    names = sorted(path.stem for path in mocap.glob("*.bvh"))
    if unnamed := [name for name in names if not _NAME.match(name)] or ([] if names else [str(mocap)]):
        raise InputError(f"{unnamed[0]}: clips are files named cmu_SUBJECT_TRIAL*.bvh")
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
    """Return subject and trial, the same in both conversions."""
    return "_".join(clip.split("_")[1:3])


class Rows:
    """A training bank being drawn: images, truths and starts as two files, which training may read meanwhile."""

    def __init__(self, folder: Path, count: int, views: tuple[int, ...], starts: int) -> None:
        """Create the files.

        Args:
            folder: made where missing.
            count: number of samples.
            views: shape of a sample's views, empty for one.
            starts: number of starts per sample.
        """
        folder.mkdir(parents=True, exist_ok=True)
        shape = (count, *views, CHANNELS, PICTURE_PX, PICTURE_PX)
        self._pictures = np.lib.format.open_memmap(folder / "pictures.npy", mode="w+", dtype=np.uint8, shape=shape)
        self._joints = {
            "truth": np.zeros((count, *views, 3, 24, 3), np.float32),
            "starts": np.zeros((count, starts, 24, 3), np.float32),
            "unit_m": np.zeros(count, np.float32),
            "height_m": np.zeros((count, *views), np.float32),
        }
        self._folder, self._done, self._counter = folder, 0, Counter("pictures", 250)

    @property
    def full(self) -> bool:
        """Whether all samples are drawn."""
        return self._done == len(self._pictures)

    def add(self, sample: Sample) -> None:
        """Append a sample; a full bank ignores it.

        Args:
            sample: of the bank's shapes.
        """
        if self.full:
            return
        self._pictures[self._done] = sample.picture
        for name, values in self._joints.items():
            values[self._done] = getattr(sample, name)
        self._done += 1
        if self._counter.reached(self._done) or self._done == 20:  # whoever trains may begin with few
            self.save()

    def save(self) -> None:
        """Write the samples so far, atomically."""
        self._pictures.flush()
        part = self._folder / "joints.part.npz"
        np.savez(part, done=self._done, **self._joints)  # type: ignore[arg-type]  # as in write_arrays
        part.rename(self._folder / "joints.npz")


def draw_rows(rows: Rows, draw: Callable[[np.random.Generator], Iterable[Sample]], seed: int, first: int = 0) -> None:
    """Fill a bank with samples of numbered random generators.

    Args:
        rows: the bank.
        draw: returns the samples of one generator.
        seed: of all generators.
        first: number of the first generator.
    """
    for number in itertools.count(first):
        for sample in draw(np.random.default_rng([seed, number])):
            rows.add(sample)
        if rows.full:
            break
    rows.save()


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_drawing_flags(parser)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first picture [0]")


def run(options: argparse.Namespace) -> None:
    """Write images, truths and starts.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    studio = Studio(
        options.mocap, options.backgrounds, split(options.mocap, options.split), options.seed, options.frame_px
    )
    rows = Rows(options.out, options.count, (), STARTS)
    draw_rows(rows, lambda rng: [studio.draw(rng)], options.seed, options.first)
