"""Train the matting networks: `hfb train matting --bank train.npy --photos DIR... --out DIR`.

Every iteration draws a few new scenes and takes the rest of its batch from the latest ones, flipped and with permuted
colour channels: drawing is slower than learning. The same options and seed give the same images in the same order.
"""

import argparse
import copy
import json
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.matting.matte_network import CHANNELS, WIDTHS, MatteNetwork, features
from hfb.matting.matting_protocol import clean
from hfb.matting.network import seen_beside_fit, shipped_network, shipped_second
from hfb.matting.second_look import COLOUR_STARTS, EVIDENCE_CHANNELS, colour_evidence
from hfb.matting.third_look import FIT_CHANNELS, FIT_COLOUR_STARTS, SHARED_CHANNELS, fit_evidence
from hfb.photometry import srgb_to_linear
from hfb.training.flags import add_schedule_flags, count, file, folder
from hfb.training.matting.scenes import Difficulty, Scene, draw_scene
from hfb.training.matting.training_plates import PATTERNS, ROOMS, make_patterns, make_rooms, read_photos
from hfb.training.muon import Muon
from hfb.training.schedule import Schedule, cosine, tell, update_average
from hfb.training.weight_files import read_weights, write_checkpoint

_REMEMBERED = 480
_CLOSE = Difficulty(
    photo_share=0.4,
    scale=(0.45, 1.1),
    empty_share=0.02,
    cut_share=0.15,
    hard_share=0.25,
    slide_share=0.45,
    picture_share=0.15,
)
"""Scenes of the second network, which sees the box around the person."""
_SAVED_MINUTES = 2.0
_CHANNELS = {1: CHANNELS, 2: CHANNELS + EVIDENCE_CHANNELS, 3: SHARED_CHANNELS + FIT_CHANNELS}
"""Input channels of the first, second and third network."""
_OF_FITS = 0.6
"""Share of fits in the third network's images, where given; the others have things that no body model wears."""


class Scenes(IterableDataset[torch.Tensor]):
    """An endless stream of new scenes."""

    def __init__(
        self, banks: list[Path], photos: list[Path], size_px: int, seed: int, look: int, fits: list[Path]
    ) -> None:
        """Take the sources of scenes; files are read by each loader process.

        Args:
            banks: files of matting-bank.
            photos: folders of backgrounds.
            size_px: side of the scenes [px].
            seed: of the random numbers.
            look: the network to train: 1, 2 or 3.
            fits: files of matting-fits, for the third network.
        """
        self.banks, self.fits, self.photos = banks, fits, photos
        self.size_px, self.seed, self.look = size_px, seed, look

    def __iter__(self) -> Iterator[torch.Tensor]:
        """Yield features and alpha as (channels + 1, size, size) float16; several processes share the numbers."""
        cv2.setNumThreads(1)
        torch.set_num_threads(1)
        worker = get_worker_info()
        first, step = (worker.id, worker.num_workers) if worker else (0, 1)
        figures, fits = ([np.load(path, mmap_mode="r") for path in paths] for paths in (self.banks, self.fits))
        real = read_photos(self.photos, held_out=False)
        plates = [real, real, make_rooms(ROOMS, self.seed), make_patterns(PATTERNS, self.seed)]
        rules = _CLOSE if self.look > 1 else Difficulty()
        rules = replace(rules, size_px=self.size_px)
        for number in range(first, 1 << 30, step):
            rng = np.random.default_rng([self.seed, number])
            if fits and rng.random() < _OF_FITS:
                yield torch.from_numpy(_of_fit(fits[rng.integers(len(fits))], rng).astype(np.float16))
                continue
            scene = draw_scene(figures[rng.integers(len(figures))], plates, rules, rng)
            seen = features(scene.frame, scene.plate)
            if self.look > 1:
                seen = _looked(scene, seen, self.look)
            yield torch.from_numpy(np.concatenate([seen, scene.alpha[None]]).astype(np.float16))


def _of_fit(rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a row of `fitted_mattes` as the third network's input, and alpha."""
    row = rows[rng.integers(len(rows))]
    while not row[-1].any():  # a bank that is still being drawn
        row = rows[rng.integers(len(rows))]
    picture = row.astype(np.float32).transpose(1, 2, 0) / 255
    frame, plate = srgb_to_linear(picture[..., :3]), srgb_to_linear(picture[..., 3:6])
    fitted = np.concatenate([picture[..., 7:10] ** 2, picture[..., 10:11]], -1)
    return np.concatenate([seen_beside_fit(frame, plate, picture[..., 6], fitted), picture[..., 11][None]])


def _looked(scene: Scene, seen: np.ndarray, look: int) -> np.ndarray:
    """Return a scene's input with the outputs of the networks before; the third also gets the double."""
    alpha, log_error = _answer(shipped_network(), seen)
    seen_twice = np.concatenate([seen, colour_evidence(scene.frame, scene.plate, alpha, log_error)])
    if look == 2:
        return seen_twice
    alpha, _ = _answer(shipped_second(), seen_twice)
    told = colour_evidence(scene.frame, scene.plate, clean(alpha))
    double = np.zeros((*scene.alpha.shape, 4), np.float32) if scene.double is None else scene.double
    return np.concatenate([seen, told, fit_evidence(scene.frame, scene.plate, double)])


def _answer(network: MatteNetwork, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        picture = torch.from_numpy(seen)[None].contiguous(memory_format=torch.channels_last)
        logit, log_error = network(picture)[0].float()
    return torch.sigmoid(logit).numpy(), log_error.numpy()


def matte_loss(output: torch.Tensor, alpha: torch.Tensor, band_weight: float) -> torch.Tensor:
    """Return the error, weighted in the blurred band, plus overlap, edges and calibration of the predicted error.

    Args:
        output: (N, 2, H, W) logits and log error.
        alpha: (N, 1, H, W) truth.
        band_weight: additional weight of the blurred band.
    """
    matte, spread = torch.sigmoid(output[:, :1]), output[:, 1:].clamp(-6, 1)
    error = (matte - alpha).abs()
    band = ((alpha > 0.02) & (alpha < 0.98)).float()
    plain = (error * (1 + band_weight * band + alpha)).mean()
    together = torch.minimum(matte, alpha).sum((1, 2, 3)) + 10
    overlap = 1 - together / (torch.maximum(matte, alpha).sum((1, 2, 3)) + 10)
    edges = sum(
        (functional.avg_pool2d(matte, k).diff(dim=axis) - functional.avg_pool2d(alpha, k).diff(dim=axis)).abs().mean()
        for k in (1, 4)
        for axis in (2, 3)
    )
    known = (error.detach() / spread.exp() + spread).mean()
    return 2 * plain + 0.5 * overlap.mean() + edges + 0.02 * known


def augment(batch: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Flip at random, and permute the colour channels of all colours alike.

    Args:
        batch: (N, C, H, W) features and alpha.
        generator: draws both.
    """
    order = torch.randperm(3, generator=generator)
    channels = torch.arange(batch.shape[1])
    starts = [0, 3, 6, 9]
    if batch.shape[1] > CHANNELS + 1:
        starts += [CHANNELS + start for start in COLOUR_STARTS]
    if batch.shape[1] > SHARED_CHANNELS + 2:
        starts += [SHARED_CHANNELS + start for start in FIT_COLOUR_STARTS]
    for start in starts:
        channels[start : start + 3] = order + start
    batch = batch[:, channels]
    return batch.flip(-1) if torch.rand((), generator=generator) < 0.5 else batch


def widened(state: dict[str, torch.Tensor], channels: int, shared: int) -> dict[str, torch.Tensor]:
    """Return weights of the same function for more input channels; the new ones have weight zero.

    Args:
        state: weights by name.
        channels: of the input.
        shared: input channels of ``state`` to keep.
    """
    entry = state["entry.0.weight"]
    wide = entry.new_zeros(len(entry), channels, *entry.shape[2:])
    wide[:, :shared] = entry[:, :shared]
    return state | {"entry.0.weight": wide}


def fold(network: MatteNetwork, widths: tuple[int, ...]) -> MatteNetwork:
    """Return the same function without normalisation layers.

    Args:
        network: with normalisation layers.
        widths: its channels per level.
    """
    plain = MatteNetwork(widths, channels=network.state_dict()["entry.0.weight"].shape[1]).eval()
    modules = dict(network.eval().named_modules())
    for name, module in plain.named_modules():
        if isinstance(module, nn.Conv2d):
            source = modules[name]
            if name != "exit":
                source = fuse_conv_bn_eval(source, modules[name[:-1] + "1"])
            module.load_state_dict(source.state_dict())
    return plain


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_schedule_flags(parser, iterations=8000, batch=8, rate=2e-3, seed=1)
    add = parser.add_argument
    add("--bank", type=file, nargs="+", required=True, metavar="FILE", help="of hfb train matting-bank")
    add(
        "--photos", type=folder, nargs="+", required=True, metavar="DIR", help="of which every fourth scene is held out"
    )
    add("--size", type=count, default=144, metavar="PX", help="side of the pictures [144]")
    add("--fresh", type=count, default=3, metavar="N", help="new scenes per iteration [3]")
    add("--loaders", type=int, default=1, metavar="N", help="processes that draw; a GPU needs many [1]")
    add("--start", type=file, metavar="FILE", help="training state to go on from, with normalisation layers")
    add("--second", action="store_true", help="the network that sees the shipped first one's matte")
    add("--third", action="store_true", help="the network that sees the second one's, and a fit")
    add("--fits", type=file, nargs="*", default=[], metavar="FILE", help="of hfb train matting-fits, for --third")
    add("--band-weight", type=float, default=2.0, help="of the blurred band in the loss [2]")


def run(options: argparse.Namespace) -> None:
    """Train until the iterations or the minutes are over; the latest averaged weights are always in the folder.

    Args:
        options: the parsed options.
    """
    if options.fresh > options.batch:
        raise InputError(f"--fresh {options.fresh} is more than a batch of {options.batch}")
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    look = 3 if options.third else 2 if options.second else 1
    channels = _CHANNELS[look]
    network = _begun(options, channels).to(options.device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = copy.deepcopy(network)
    optimiser = Muon(network, options.rate, 0.01, ("exit",))
    loader = DataLoader(
        Scenes(options.bank, options.photos, options.size, options.seed, look, options.fits),
        batch_size=options.fresh,
        num_workers=options.loaders,
        prefetch_factor=16 if options.loaders else None,
    )
    generator = torch.Generator().manual_seed(options.seed)
    remembered: deque[torch.Tensor] = deque(maxlen=_REMEMBERED)
    schedule, saved, smooth = Schedule(options.iterations, options.minutes), 0.0, None
    for step, fresh in enumerate(loader):
        share = schedule.share(step)
        if schedule.minutes - saved > _SAVED_MINUTES or share >= 1:
            saved = schedule.minutes
            _save(average, options, {"iterations": step, "seconds": 60 * saved, "loss": smooth})
        if share >= 1:
            break
        remembered.extend(fresh)
        if len(remembered) < 2 * options.batch:
            continue
        chosen = torch.randint(len(remembered), (options.batch - options.fresh,), generator=generator)
        batch = torch.cat([fresh, *(remembered[int(k)][None] for k in chosen)])
        batch = augment(batch, generator).to(options.device).float().contiguous(memory_format=torch.channels_last)
        network.train()
        with torch.autocast(options.device, torch.bfloat16, enabled=options.bfloat16):
            output = network(batch[:, :channels])
        loss = matte_loss(output.float(), batch[:, channels:], options.band_weight)
        network.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step(options.rate * min(1.0, (step + 1) / 100) * cosine(share, 0.01))
        update_average(average, network, min(0.998, (1 + step) / (10 + step)))
        smooth = loss.item() if smooth is None else 0.99 * smooth + 0.01 * loss.item()
        if step % 100 == 99:
            tell(f"step {step + 1} {60 * schedule.minutes:.0f} s loss {smooth:.4f}")


def _begun(options: argparse.Namespace, channels: int) -> MatteNetwork:
    """Return a network initialised at random, with the shipped weights, or with an earlier state."""
    if options.go_on:
        network = MatteNetwork(WIDTHS, channels=channels)
    else:
        network = MatteNetwork(WIDTHS, nn.BatchNorm2d, channels=channels)
    if options.go_on:
        before = read_weights(options.go_on)
        goes_on = before["entry.0.weight"].shape[1] == channels
        network.load_state_dict(before if goes_on else widened(before, channels, SHARED_CHANNELS))
    if options.start:
        network.load_state_dict(widened(read_weights(options.start), channels, CHANNELS))
    return network


def _save(average: MatteNetwork, options: argparse.Namespace, facts: dict[str, Any]) -> None:
    there = copy.deepcopy(average).cpu()
    write_checkpoint(options.out / "state.pt", there.state_dict())
    folded = there if options.go_on else fold(there, WIDTHS)
    write_checkpoint(options.out / "folded.pt", folded.state_dict())
    content = json.dumps(facts | {"options": vars(options)}, default=str)
    write_bytes_atomic(options.out / "training.json", content.encode())
    tell(
        f"{facts['iterations']} iterations, {facts['seconds']:.0f} s, loss {facts['loss']}: {options.out / 'folded.pt'}"
    )
