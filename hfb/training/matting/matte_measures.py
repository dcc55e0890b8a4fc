"""Compare the matting network with the projection: `hfb train matting-measure --bank held_out.npy --photos DIR...`.

Motions, photographs, rooms and patterns are held out of training; 256 x 256 pixels.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from hfb.errors import InputError
from hfb.matting.matte_network import CHANNELS, MatteNetwork
from hfb.matting.matting_protocol import KnownBackground
from hfb.matting.network import NetworkMatting
from hfb.training.flags import count, file, folder
from hfb.training.matting.scenes import Difficulty, Scene, draw_scene
from hfb.training.matting.training_plates import make_patterns, make_rooms, read_photos
from hfb.training.weight_files import read_weights

_RULES = Difficulty(
    size_px=256, photo_share=0.0, empty_share=0.0, scale=(0.55, 0.95), cut_share=0.0, residual_gain=0.03, hard_share=0.2
)
_FAMILIES = {  # clothes over background
    "generated/rooms": (replace(_RULES, photo_share=1.0), "rooms"),
    "generated/photos": (replace(_RULES, photo_share=1.0), "photos"),
    "any colours/photos": (_RULES, "photos"),
    "any colours/patterns": (_RULES, "patterns"),
    "plate's colours/photos": (replace(_RULES, hard_share=0.75), "photos"),
    "plate's colours/rooms": (replace(_RULES, hard_share=0.75), "rooms"),
}
_SMEARS_PX = ((0, 3), (3, 24), (24, 48), (48, 110))


def scores(matte: np.ndarray, alpha: np.ndarray) -> dict[str, float]:
    """Return the overlap, and mean absolute errors in the blurred band, in the core and outside the person.

    Args:
        matte: (H, W) estimate.
        alpha: (H, W) truth.
    """
    error = np.abs(matte - alpha)
    parts = {"band": (alpha > 0.05) & (alpha < 0.95), "core": alpha >= 0.95, "empty": alpha <= 0.01}
    means = {name: float(error[part].mean()) if part.sum() > 20 else float("nan") for name, part in parts.items()}
    return {"iou": float(np.minimum(matte, alpha).sum() / max(np.maximum(matte, alpha).sum(), 1e-6)), **means}


def held_out_scenes(bank: Path, photos: list[Path], per_family: int) -> list[tuple[str, float, Scene]]:
    """Return (family, smear [px at 256], scene), the same on every call.

    Args:
        bank: a file of matting-bank --held-out.
        photos: folders of backgrounds.
        per_family: scenes of each kind.
    """
    figures = np.load(bank, mmap_mode="r")
    smears = [figure["smear_px"] for figure in json.loads(bank.with_suffix(".json").read_text())["figures"]]
    plates = {"photos": read_photos(photos, True), "rooms": make_rooms(40, 77), "patterns": make_patterns(60, 77)}
    scenes = []
    for place, (family, (rules, plate)) in enumerate(_FAMILIES.items()):
        for number in range(per_family):
            rng = np.random.default_rng([99, place, number])
            which = (place * per_family + number) * 7 % len(figures)
            scene = draw_scene(figures[which : which + 1], [plates[plate]], rules, rng)
            if scene.alpha.sum() > 300:
                scenes.append((family, smears[which], scene))
    return scenes


def apply(matting: Callable[[np.ndarray, np.ndarray], np.ndarray], scenes: list[Scene]) -> tuple[np.ndarray, float]:
    """Return mattes (N, H, W), empty where the method fails, and the seconds per matte.

    Args:
        matting: a function of frame and plate in linear light.
        scenes: N scenes.
    """
    mattes, started = [], time.process_time()
    for scene in scenes:
        try:
            mattes.append(matting(scene.frame, scene.plate))
        except InputError:
            mattes.append(np.zeros_like(scene.alpha))
    return np.stack(mattes), (time.process_time() - started) / len(scenes)


def add_scene_flags(parser: argparse.ArgumentParser, per_family: int) -> None:
    """Declare what a network is measured on.

    Args:
        parser: of the program.
        per_family: default number of scenes of each kind.
    """
    add = parser.add_argument
    add("--bank", type=file, required=True, metavar="FILE", help="of hfb train matting-bank --held-out")
    add(
        "--photos", type=folder, nargs="+", required=True, metavar="DIR", help="of which every fourth scene is held out"
    )
    add("--weights", type=file, metavar="FILE", help="folded.pt or .safetensors [the shipped ones]")
    add("--per-family", type=count, default=per_family, metavar="N", help=f"scenes of each kind [{per_family}]")
    add("--out", type=Path, metavar="FILE.json", help="where every figure goes")


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_scene_flags(parser, per_family=12)
    parser.add_argument("--projection", type=Path, metavar="FILE.npy", help="cache of the projection's mattes")


def run(options: argparse.Namespace) -> None:
    """Print a table; write every figure to --out.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    drawn = held_out_scenes(options.bank, options.photos, options.per_family)
    scenes = [scene for _, _, scene in drawn]
    if options.projection and options.projection.exists():
        projected, projection_s = np.load(options.projection), float("nan")
    else:
        projected, projection_s = apply(KnownBackground(), scenes)
        if options.projection:
            np.save(options.projection, projected)
    learned, network_s = apply(NetworkMatting(network_of(options.weights)), scenes)
    rows = {}
    for group, keeps in _groups(drawn).items():
        for method, mattes in (("projection", projected), ("network", learned)):
            kept = [(matte, scene.alpha) for matte, scene, keep in zip(mattes, scenes, keeps, strict=True) if keep]
            rows[f"{method} {group}"] = _mean([scores(matte, alpha) for matte, alpha in kept])
    for name, row in rows.items():
        print(f"{name:40s}", "  ".join(f"{key} {value:.3f}" for key, value in row.items()))
    print(f"seconds: projection {projection_s:.2f}, network {network_s:.2f}")
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1))


def network_of(weights: Path | None, channels: int = CHANNELS) -> MatteNetwork | None:
    """Return a network with these weights, or None for the shipped ones.

    Args:
        weights: a file of weights; None for the shipped ones.
        channels: of the network's input.
    """
    if weights is None:
        return None
    network = MatteNetwork(channels=channels)
    network.load_state_dict(read_weights(weights))
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def _groups(drawn: list[tuple[str, float, Scene]]) -> dict[str, list[bool]]:
    groups = {family: [name == family for name, _, _ in drawn] for family in _FAMILIES}
    groups |= {f"smear {low}-{high} px": [low <= smear < high for _, smear, _ in drawn] for low, high in _SMEARS_PX}
    return groups | {"all": [True] * len(drawn)}


def _mean(rows: list[dict[str, float]]) -> dict[str, float]:
    if not rows:
        return {}
    return {key: float(np.nanmean([row[key] for row in rows])) for key in rows[0]} | {"n": len(rows)}
