"""Compare matting methods: `hfb train matting-compare --bank held_out.npy --photos DIR...`.

The same composites (`pairs`) for every method: ours, the known-background projection, the normalised difference, and,
where PyMatting (MIT) can be imported, its closed-form and KNN mattes with a trimap from the difference.
Textures and backgrounds are held out of training.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch

from hfb.errors import InputError
from hfb.matting.camera_noise import exposure_gain
from hfb.matting.matting_protocol import KnownBackground
from hfb.matting.network import NetworkMatting
from hfb.photometry import linear_to_srgb
from hfb.training.flags import count, file, folder
from hfb.training.matting.matte_measures import network_of, scores
from hfb.training.matting.pairs import KINDS, TROUBLES, Pair, draw_pairs
from hfb.training.matting.training_plates import read_photos

METHODS = ("network", "projection", "difference", "cf", "knn")
Method = Callable[[np.ndarray, np.ndarray], np.ndarray]


def normalised_difference(frame: np.ndarray, plate: np.ndarray) -> np.ndarray:
    """Return |I - B| over its 0.95-quantile among changed pixels, with the plate in the frame's exposure.

    Args:
        frame: (H, W, 3) linear light.
        plate: (H, W, 3) linear light.
    """
    change = np.abs(frame - np.clip(plate * exposure_gain(frame, plate), 0, 1)).max(-1)
    change = cv2.GaussianBlur(change, (0, 0), 1.0)
    noise = 3 * np.median(change)
    seen = change > max(noise, 0.02)
    full = np.quantile(change[seen], 0.95) if seen.any() else 1.0
    return np.clip((change - noise) / max(full - noise, 1e-3), 0, 1).astype(np.float32)


def refined(how: str) -> Method:
    """Return PyMatting's method with a trimap from the normalised difference.

    Args:
        how: ``cf`` (closed form) or ``knn``.
    """
    from pymatting import estimate_alpha_cf, estimate_alpha_knn

    estimate = {"cf": estimate_alpha_cf, "knn": estimate_alpha_knn}[how]

    def matting(frame: np.ndarray, plate: np.ndarray) -> np.ndarray:
        rough = normalised_difference(frame, plate)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
        sure = cv2.erode((cv2.GaussianBlur(rough, (0, 0), 2) > 0.6).astype(np.uint8), disc)
        empty = cv2.dilate((cv2.GaussianBlur(rough, (0, 0), 2) > 0.04).astype(np.uint8), disc) == 0
        trimap = np.where(sure > 0, 1.0, np.where(empty, 0.0, 0.5))
        if not sure.any() or not empty.any():
            return rough
        return estimate(linear_to_srgb(frame).astype(np.float64), trimap).astype(np.float32)

    return matting


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add = parser.add_argument
    add("--bank", type=file, required=True, metavar="FILE", help="of hfb train matting-bank --held-out")
    add(
        "--photos", type=folder, nargs="+", required=True, metavar="DIR", help="of which every fourth scene is held out"
    )
    add("--weights", type=file, metavar="FILE", help="of another network than the shipped one")
    add("--per-kind", type=count, default=21, metavar="N", help="composites of each kind and smear [21]")
    add("--methods", nargs="+", choices=METHODS, default=METHODS, help="[all]")
    add("--out", type=Path, metavar="FILE.json", help="where every figure goes")


def run(options: argparse.Namespace) -> None:
    """Print the table; write every figure to --out.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    photos = read_photos(options.photos, held_out=True)
    pairs = draw_pairs(options.bank, photos, photos, options.per_kind)
    table = {}
    for name in options.methods:
        method = _method(name, options.weights)
        started = time.process_time()
        rows = [scores(_asked(method, pair), pair.scene.alpha) for pair in pairs]
        seconds = (time.process_time() - started) / len(pairs)
        table[name] = {"seconds": seconds, **_grouped(pairs, rows)}
        _show(name, table[name])
    if options.out:
        options.out.write_text(json.dumps(table, indent=1))


def _method(name: str, weights: Path | None) -> Method:
    if name in ("cf", "knn"):
        return refined(name)
    if name == "difference":
        return normalised_difference
    return KnownBackground() if name == "projection" else NetworkMatting(network_of(weights))


def _asked(method: Method, pair: Pair) -> np.ndarray:
    """Return the method's matte; empty where it fails."""
    try:
        return method(pair.scene.frame, pair.scene.plate)
    except InputError:
        return np.zeros_like(pair.scene.alpha)


def _grouped(pairs: list[Pair], rows: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    groups = {}
    for smear_px in (24, 72):
        groups[f"{smear_px} px"] = [pair.smear_px == smear_px for pair in pairs]
        for kind in KINDS:
            groups[f"{smear_px} px, {kind}"] = [(pair.smear_px, pair.kind) == (smear_px, kind) for pair in pairs]
        for trouble in TROUBLES:
            groups[f"{smear_px} px, {trouble}"] = [(p.smear_px, p.trouble) == (smear_px, trouble) for p in pairs]
    kept = {name: [row for row, keep in zip(rows, keeps, strict=True) if keep] for name, keeps in groups.items()}
    return {
        name: {key: float(np.nanmean([row[key] for row in chosen])) for key in rows[0]} | {"pairs": len(chosen)}
        for name, chosen in kept.items()
    }


def _show(name: str, table: dict) -> None:
    for group, row in table.items():
        if group != "seconds":
            print(f"{name:12s} {group:28s}", "  ".join(f"{key} {value:.4g}" for key, value in row.items()))
    print(f"{name:12s} {table['seconds']:.2f} s each", flush=True)
