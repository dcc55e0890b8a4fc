"""How many averaged frames of real video get a first body: `python measure.py --data DATA --out starts.json`.

Consecutive frames of real clips are averaged in linear light; matte and first body are hfb's own. Told per window,
all soft IoU: `still`, the body at rest with the matte; `best still`, what any outline at rest could reach (somebody
who crosses their own width has none that covers half); `swept`, the body carried along its best straight path;
`middle`, the body at rest with the matte of the middle frame alone, which is sharp. A body is found where `still` or
`swept` is at least one half.
"""

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.config import InitConfig, MattingConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.initializer import Initializer, make_initializer
from hfb.initialization.silhouette_fit import SilhouetteStage, Stay, matte_level, overlap, refine_swept, silhouette
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.video.video_reading import read_frames
from hfb.matting.matting_protocol import Matting, shrink
from hfb.matting.methods import make_matting
from hfb.motion.static_pose import FirstBody
from hfb.photometry import srgb_to_linear
from hfb.rendering.backends import make_rasterizer

_LONGER_PX = 960


@dataclass(frozen=True)
class Footage:
    """Where a person is wholly seen: frames, the plate, and between which frames."""

    name: str
    frames: Path
    plate: Path
    first: int
    stop: int


def footage(data: Path) -> list[Footage]:
    """The real clips with a plate, in the stretches in which the whole person is seen."""
    balancing, park, walk = data / "pose2sim_balancing", data / "sports2d_park", data / "bodypose3d_walkin"
    return [
        Footage("balancing, camera 1", balancing / "cam01_f000-059.mp4", balancing / "cam01_plate.png", 0, 60),
        Footage("balancing, camera 4", balancing / "cam04_f000-059.mp4", balancing / "cam04_plate.png", 0, 60),
        Footage("park", park / "demo.mp4", park / "plate.png", 55, 160),
        Footage("walk in", walk, walk / "plate.png", 0, 16),
    ]


def windows(one: Footage, frames: int, most: int) -> list[int]:
    """First frames of up to `most` windows, evenly spread."""
    last = one.stop - frames
    return [] if last < one.first else np.unique(np.linspace(one.first, last, most).round().astype(int)).tolist()


def load(one: Footage) -> np.ndarray:
    """(T, h, w, 3) linear, at most 960 px on the longer side."""
    if one.frames.is_dir():
        stored = (read_picture_srgb(path) for path in sorted(one.frames.glob("f*.png"))[one.first : one.stop])
    else:
        stored = read_frames(one.frames, one.first, one.stop)
    return np.stack(
        [shrink(srgb_to_linear(frame).astype(np.float32), _LONGER_PX).astype(np.float16) for frame in stored]
    )


def shared(one: np.ndarray, other: np.ndarray) -> float:
    """Soft IoU."""
    return float(np.minimum(one, other).sum() / max(np.maximum(one, other).sum(), 1e-6))


def swept(first: FirstBody, matte: np.ndarray, camera: PinholeCamera, body: Body) -> float:
    """Soft IoU along the best straight path: only the path is free, and the place by a little."""
    rasterizer = make_rasterizer("coverage")
    level, stage = matte_level(matte, camera, 80), SilhouetteStage(80, 25, 0.04, shape=False)
    stay = Stay(pose=1e3, root=1e3, place=1e2, prior=0.0)
    values = []
    for across in (0.1, 0.6):
        start = first.translation.new_tensor([across, 0.0, 0.0])
        moved, path = refine_swept(first, start, matte, camera, body, rasterizer, [stage], stay)
        values.append(overlap(moved, level, body, rasterizer, path))
    return max(values)


def best_still(matte: np.ndarray) -> float:
    """The largest soft IoU of a matte with any silhouette of 0 and 1: no body, every outline."""
    values = np.sort(matte.ravel())[::-1].astype(np.float64)
    covered = np.cumsum(values)
    return float((covered / (np.arange(1, len(values) + 1) + covered[-1] - covered)).max())


def main() -> None:
    """One line per window, then the shares of frames with a body."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--frames", type=int, nargs="+", default=[9, 25])
    parser.add_argument("--methods", nargs="+", default=["matte", "auto"])
    parser.add_argument("--windows", type=int, default=8, help="per clip")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    matting, rows = make_matting(MattingConfig()), []
    makers = {name: make_initializer(InitConfig(method=name)) for name in options.methods}
    for one in footage(options.data):
        frames, plate = load(one), shrink(srgb_to_linear(read_picture_srgb(one.plate)).astype(np.float32), _LONGER_PX)
        for count in options.frames:
            for first in windows(one, count, options.windows):
                window = frames[first - one.first : first - one.first + count].astype(np.float32)
                rows += measure(one.name, first, window, plate, matting, makers)
    for line in summary(rows):
        print(line)
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1))


def measure(
    name: str, first: int, window: np.ndarray, plate: np.ndarray, matting: Matting, makers: dict[str, Initializer]
) -> list[dict]:
    """One averaged frame under every method."""
    frame, middle = window.mean(0), window[len(window) // 2]
    height, width = frame.shape[:2]
    camera, body = PinholeCamera.from_focal(float(np.hypot(height, width)), height, width), load_default_body()
    matte, sharp = matting(frame, plate), matting(middle, plate)
    rows = []
    for method, make in makers.items():
        row = {"clip": name, "first": first, "frames": len(window), "method": method}
        row |= {"still": 0.0, "best still": best_still(matte), "swept": 0.0, "middle": 0.0, "source": ""}
        started = time.process_time()
        try:
            found = make(frame, plate, matte, camera, body)
            seen = silhouette(found, camera, body, make_rasterizer("coverage")).numpy()
            row |= {"still": shared(seen, matte), "middle": shared(seen, sharp), "source": found.source}
            row["swept"] = swept(found, matte, camera, body)
        except InputError as error:
            row["source"] = str(error)
        row["seconds"] = time.process_time() - started
        print(
            " ".join(f"{value:.3f}" if isinstance(value, float) else f"{value}" for value in row.values()), flush=True
        )
        rows.append(row)
    return rows


def summary(rows: list[dict]) -> list[str]:
    """Per number of frames and method, over all clips and per clip: the share at or above one half, and medians."""
    lines = []
    for frames, method in sorted({(row["frames"], row["method"]) for row in rows}):
        chosen = [row for row in rows if (row["frames"], row["method"]) == (frames, method)]
        for clip in ["all", *dict.fromkeys(row["clip"] for row in chosen)]:
            part = [row for row in chosen if clip in ("all", row["clip"])]
            figures = {key: np.array([row[key] for row in part]) for key in ("still", "best still", "swept", "middle")}
            figures["found"] = np.maximum(figures["still"], figures["swept"])
            told = ", ".join(f"{key} {(v >= 0.5).mean():.0%} (median {np.median(v):.3f})" for key, v in figures.items())
            lines.append(f"{frames} frames, {method}, {clip} ({len(part)}): {told}")
    return lines


if __name__ == "__main__":
    main()
