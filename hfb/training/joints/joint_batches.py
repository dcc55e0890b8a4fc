"""Batches for the joint network: images of several banks, mirrored, moved, recoloured, with other starts."""

import argparse
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from hfb.body.skeleton import MIRROR
from hfb.errors import InputError
from hfb.evidence.joint_network import PICTURE_PX

_READ_AGAIN = 200
_MOVED, _ROLL_DEG, _ZOOM, _SHIFT = 0.8, 9.0, 0.08, 0.04
_LEANING, _LEAN_DEG = 0.3, 14.0
_LEGS, _ARMS = ((4, 5), (7, 8), (10, 11)), ((18, 19), (20, 21), (22, 23))


class Bank:
    """Images with truths and starts of several banks as one; samples not yet drawn are left out.

    A row of `joint_bank` is one view of a person, a row of `joint_fits` two: as observed, and as a fit renders it.
    """

    def __init__(self, folders: list[Path]) -> None:
        """Map the images, read the joints.

        Args:
            folders: of joints-bank, joints-fits or joints-doubles.
        """
        self.folders = folders
        for folder in folders:
            if not (folder / "pictures.npy").is_file() or not (folder / "joints.npz").is_file():
                raise InputError(f"{folder} is no bank: make one with hfb train joints-bank")
        self.pictures = [np.load(folder / "pictures.npy", mmap_mode="r") for folder in folders]
        self.read()

    def read(self) -> None:
        """Read the joints of all images drawn by now."""
        parts = []
        for number, folder in enumerate(self.folders):
            with np.load(folder / "joints.npz") as file:
                done = int(file["done"])
                parts.append(
                    (np.full(done, number), *(file[key][:done] for key in ("truth", "starts", "unit_m", "height_m")))
                )
        self.folder, self.truth, self.starts, self.unit_m, self.height_m = (
            np.concatenate(column) for column in zip(*parts, strict=True)
        )
        self.row = np.concatenate([np.arange(len(part[0])) for part in parts])

    def __len__(self) -> int:
        return len(self.row)

    def draw(self, rng: np.random.Generator, count: int, last: float) -> np.ndarray:
        """Return row numbers (count,), a share of them from the last folder.

        Args:
            rng: draws the rows.
            count: how many.
            last: the last folder's share, in [0, 1].
        """
        ours = int(last * count)
        newest = np.flatnonzero(self.folder == len(self.folders) - 1)
        return np.concatenate([rng.choice(newest, ours), rng.integers(len(self), size=count - ours)])

    def batch(self, chosen: np.ndarray) -> np.ndarray:
        """Return images (N, *views, C, H, W) uint8.

        Args:
            chosen: (N,) row numbers.
        """
        return np.stack([self.pictures[self.folder[index]][self.row[index]] for index in chosen])


def augmented(
    bank: Bank, chosen: np.ndarray, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return augmented images (N, V, C, H, W), starts (N, 24, 3) and truths (N, V, 3, 24, 3).

    They are mirrored, recoloured, moved, and get other starts. All views of a person change alike; defects of a single
    image, such as a hole in a matte, are the first view's.

    Args:
        bank: to draw from.
        chosen: (N,) row numbers.
        rng: draws the augmentation.
    """
    count = len(chosen)
    seen, joints = bank.batch(chosen), bank.truth[chosen]
    if seen.ndim == 4:
        seen, joints = seen[:, None], joints[:, None]
    seen, joints, erring = _moved(seen, joints, _confused(bank, chosen, rng), rng)
    pictures, truth = torch.from_numpy(seen).float() / 127.5 - 1, torch.from_numpy(joints)
    erring, middle = _leaning(erring, rng), truth[:, 0, 1]
    # A share of starts lies between what was drawn and the truth; estimates of other systems are often that good.
    shares = np.where(rng.random(count) < 0.3, rng.random(count), 0)[:, None, None].astype(np.float32)
    starts = as_large(torch.from_numpy(erring), middle, torch.from_numpy(rng.normal(0, 0.04, count)).float())
    share = torch.from_numpy(shares)
    starts = starts * (1 - share) + middle * share
    starts = starts + torch.from_numpy(rng.normal(0, 0.02, starts.shape)).float()
    mirrored = torch.from_numpy(rng.random(count) < 0.5)[:, None, None]
    pictures = torch.where(mirrored[..., None, None], pictures.flip(-1), pictures)
    across = torch.tensor([-1.0, 1.0, 1.0])
    truth = torch.where(mirrored[..., None, None], truth[..., list(MIRROR), :] * across, truth)
    starts = torch.where(mirrored, starts[:, list(MIRROR)] * across, starts)
    order = rng.permutation(3)
    if rng.random() < 0.5:
        pictures = pictures[:, :, [0, *(1 + order), *(4 + order)]]
    contrast = torch.from_numpy(np.exp(rng.normal(0, 0.2, (count, 1, 1, 1, 1)))).float()
    pictures[:, :, 1:] *= contrast
    for index in np.flatnonzero(rng.random(count) < 0.3):  # a matte with a hole, or a scrap too much
        height, width = rng.integers(5, 26, 2)
        top, left = rng.integers(0, 96 - height), rng.integers(0, 96 - width)
        pictures[index, 0, 0, top : top + height, left : left + width] = -1 if rng.random() < 0.7 else 1
    return pictures, starts, truth


def _moved(
    pictures: np.ndarray, truth: np.ndarray, starts: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotate a share of the samples about the line of sight, scale and shift it: other windows."""
    truth, starts = truth.copy(), starts.copy()
    for row in np.flatnonzero(rng.random(len(pictures)) < _MOVED):
        angle = np.deg2rad(np.clip(rng.normal(0, _ROLL_DEG), -30, 30))
        zoom, shift = np.exp(rng.normal(0, _ZOOM)), rng.normal(0, _SHIFT, 2)
        turn = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        middle = (PICTURE_PX - 1) / 2
        move = middle - turn @ (middle, middle) + shift * PICTURE_PX / 2
        matrix = np.concatenate([turn, move[:, None]], 1).astype(np.float32)
        for view, picture in enumerate(pictures[row]):
            layers = picture.transpose(1, 2, 0)
            parts = [
                cv2.warpAffine(
                    np.ascontiguousarray(layers[..., few]), matrix, layers.shape[:2], borderMode=cv2.BORDER_REPLICATE
                )
                for few in (slice(0, 4), slice(4, 7))  # OpenCV turns four channels at most
            ]
            pictures[row, view] = np.concatenate(parts, -1).transpose(2, 0, 1)
        for places in (truth[row], starts[row]):
            places[..., :2] = places[..., :2] @ turn.T + shift
            places[..., 2] *= zoom
    return pictures, truth, starts


def _leaning(starts: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Tilt a share of the starts as a whole into depth about the pelvis, as estimators of real images do."""
    for row in np.flatnonzero(rng.random(len(starts)) < _LEANING):
        axis = rng.normal(size=2)
        about = np.array([*(axis / np.linalg.norm(axis)), 0]) * np.deg2rad(rng.normal(0, _LEAN_DEG))
        pelvis = starts[row, :1].copy()
        starts[row] = (starts[row] - pelvis) @ cv2.Rodrigues(about)[0].T.astype(np.float32) + pelvis
    return starts


def _confused(bank: Bank, chosen: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return starts (N, 24, 3): mostly as drawn; some consistent with the outline only, or of another person.

    An outline is the same for a person and for the one reflected in depth with the sides exchanged.
    """
    starts = bank.starts[chosen, rng.integers(bank.starts.shape[1], size=len(chosen))].copy()
    kinds = rng.choice(5, size=len(chosen), p=(0.92, 0.03, 0.02, 0.02, 0.01))
    for row in np.flatnonzero(kinds == 1):
        starts[row] = starts[row][list(MIRROR)] * (1, 1, -1)
    for row in np.flatnonzero((kinds == 2) | (kinds == 3)):
        limbs = _LEGS if kinds[row] == 2 else _ARMS
        order = list(range(24))
        for one, other in limbs:
            order[one], order[other] = other, one
        starts[row] = starts[row][order]
    for row in np.flatnonzero(kinds == 4):
        other = bank.starts[rng.integers(len(bank)), 0]
        starts[row] = other - other[:1] + starts[row][:1]
    return starts.astype(np.float32)


def as_large(starts: torch.Tensor, truth: torch.Tensor, log_factor: torch.Tensor) -> torch.Tensor:
    """Rescale starts to the person's apparent size: an estimate from an image cannot know the true size.

    Args:
        starts: (N, 24, 3) in the window's units.
        truth: (N, 24, 3) in the window's units.
        log_factor: (N,) logarithm of a further scale.
    """
    centre = starts[..., :2].mean(1, keepdim=True)
    spread, wanted = (
        (one[..., :2] - one[..., :2].mean(1, keepdim=True)).square().sum((1, 2)).sqrt() for one in (starts, truth)
    )
    factor = (wanted / spread * log_factor.exp())[:, None, None]
    return torch.cat([centre + (starts[..., :2] - centre) * factor, starts[..., 2:] * factor], -1)


@dataclass(frozen=True)
class Batch:
    """Images, starts and truths of N samples of V views each.

    Attributes:
        pictures: (N, V, C, H, W).
        starts: (N, 24, 3) in the window's units.
        truth: (N, V, 3, 24, 3) at u = 0, 1/2 and 1.
        height_m: (N, V).
    """

    pictures: torch.Tensor
    starts: torch.Tensor
    truth: torch.Tensor
    height_m: torch.Tensor

    def on(self, device: str) -> "Batch":
        """Return the batch in a device's memory.

        Args:
            device: such as ``cuda``.
        """
        return Batch(*(getattr(self, one.name).to(device) for one in fields(self)))


class Batches(IterableDataset[list[Batch]]):
    """An endless stream of lists of one or two batches per iteration: single images, and images beside fits."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Take the options of `hfb train joints`.

        Args:
            options: the parsed options.
        """
        self.options = options

    def __iter__(self) -> Iterator[list[Batch]]:
        """Yield batches, a function of the options and of the samples drawn by then."""
        options, worker = self.options, get_worker_info()
        if worker is not None:
            cv2.setNumThreads(1)
            torch.set_num_threads(1)
        rng = np.random.default_rng(options.seed if worker is None else [options.seed, worker.id])
        banks = [Bank(folders) if folders else None for folders in (options.bank, options.fits)]
        share = options.fits_share if banks[0] else 1.0
        beside = round(share * options.batch / 2) if banks[1] else 0
        for number in itertools.count(1):
            batches = []
            for bank, count, last in zip(banks, (options.batch - 2 * beside, beside), (options.last, 0.0), strict=True):
                if bank is None or count == 0:
                    continue
                chosen = bank.draw(rng, count, last)
                heights = torch.from_numpy(bank.height_m[chosen]).view(count, -1)
                batches.append(Batch(*augmented(bank, chosen, rng), heights))
            yield batches
            if number % _READ_AGAIN == 0:
                for bank in banks:
                    if bank is not None:
                        bank.read()
