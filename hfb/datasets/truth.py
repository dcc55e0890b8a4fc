"""truth.npz: what really happened in a synthetic case, for evaluation only."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hfb.errors import InputError
from hfb.export.motion_file import load_motion, motion_arrays, write_arrays
from hfb.motion.sampled import SampledMotion
from hfb.shapes import Array, Bool


@dataclass(frozen=True)
class Truth:
    """True motion at dense instants and the silhouette at each of them."""

    motion: SampledMotion
    silhouettes: Bool[Array, "R H W"]
    betas_space: str


def save_truth(path: Path, truth: Truth) -> None:
    """Write a truth file whole or not at all: a motion file with one more member, silhouettes packed to bits."""
    silhouettes = {
        "silhouettes": np.packbits(truth.silhouettes, axis=-1),
        "silhouette_width": np.array(truth.silhouettes.shape[-1]),
    }
    write_arrays(path, motion_arrays(truth.motion, truth.betas_space) | silhouettes)


def load_truth(path: Path) -> Truth:
    """Read a truth file.

    Raises:
        InputError: not a truth file.
    """
    motion, betas_space = load_motion(path)
    with np.load(path, allow_pickle=False) as file:
        if "silhouettes" not in file:
            raise InputError(f"{path} holds a motion but no true silhouettes; make a case with `hfb demo`")
        bits = np.unpackbits(file["silhouettes"], axis=-1, count=int(file["silhouette_width"]))
    return Truth(motion, bits.astype(bool), betas_space)
