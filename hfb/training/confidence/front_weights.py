"""Fit hfb/fitting/data/fronts.json: both fronts of benchmark cases with estimated starts are fitted and compared.

hfb train fronts --network DIR ... --matte DIR ... --new-network DIR ... --new-matte DIR ... --out FILE
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize

from hfb.body.assets import load_default_body
from hfb.config import preset
from hfb.datasets.case import Case, load_case
from hfb.datasets.truth import load_truth_of
from hfb.errors import InputError
from hfb.evaluation.judge import judge
from hfb.evaluation.prediction import Prediction
from hfb.fitting.fit import fit
from hfb.fitting.front_choice import FrontChoice
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.fronts import find_other_front
from hfb.io.atomic import write_bytes_atomic
from hfb.io.clip import read_clip
from hfb.io.media.images.image_io import read_matte, read_picture_srgb
from hfb.motion.static_pose import load_first_body
from hfb.photometry import srgb_to_linear
from hfb.priors.load import load_pose_prior
from hfb.rendering.observation import Observation
from hfb.training.flags import count, folder
from hfb.training.weight_files import read_story

KINDS = ("network", "matte")
_FULL_MM = 100.0
"""Difference of both errors from which on a pair counts fully: of two fits about as good neither is wrong."""
_RIDGE = 0.05


@dataclass(frozen=True)
class Pair:
    """Both fits of one case.

    Attributes:
        loss_ratio: see `hfb.fitting.front_choice.loss_log_ratio`.
        doubt: see `hfb.initialization.fronts.front_doubts`.
        found_mm: MPJPE of the fit from the bodies as found.
        mirrored_mm: MPJPE of the other.
    """

    loss_ratio: float
    doubt: float
    found_mm: float
    mirrored_mm: float


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    for kind in KINDS:
        of_kind = f"folders of hfb benchmark --start estimated whose starts are of the kind {kind}"
        parser.add_argument(f"--{kind}", type=folder, nargs="+", default=[], metavar="DIR", help=of_kind)
        new = f"{of_kind}, of people who took no part in any choice: counted, not learned from"
        parser.add_argument(f"--new-{kind}", type=folder, nargs="+", default=[], metavar="DIR", help=new)
    parser.add_argument("--every", type=count, default=1, metavar="N", help="take every N-th case [1]")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the fronts.json of before")


def run(options: argparse.Namespace) -> None:
    """Fit the weights of each kind of start that has cases, and count how often the kept front was the better one.

    Args:
        options: the parsed options.
    """
    story = read_story(options.out)
    folders_of_kind = {kind: getattr(options, kind) for kind in KINDS if getattr(options, kind)}
    if not folders_of_kind:
        raise InputError("no case: give --network DIR or --matte DIR, folders of hfb benchmark --start estimated")
    for kind, folders in folders_of_kind.items():
        pairs = list(pairs_of(folders, options.every))
        loss, doubt = fit_weights(pairs)
        prior = story["weights"][kind]["prior"]
        story["weights"][kind] = {"loss": loss, "doubt": doubt, "prior": prior}
        story.setdefault("learned", {})[kind] = counted(pairs, loss, doubt, prior)
        new = list(pairs_of(getattr(options, f"new_{kind}"), options.every))
        story.setdefault("new_people", {})[kind] = counted(new, loss, doubt, prior) if new else None
    write_bytes_atomic(options.out, json.dumps(story, indent=1).encode() + b"\n")


def fit_weights(pairs: Sequence[Pair]) -> tuple[float, float]:
    """Fit the weights of loss and doubt by logistic regression without a constant.

    Each pair counts both ways round, so that what is learned does not depend on which body was found first.

    Args:
        pairs: fits with known errors.
    """
    evidence = np.array([_evidence(one) for one in pairs])
    sign = np.array([1.0 if one.found_mm < one.mirrored_mm else -1.0 for one in pairs])
    share = np.array([min(abs(one.found_mm - one.mirrored_mm) / _FULL_MM, 1.0) for one in pairs])

    def cost(weights: np.ndarray) -> float:
        return float((share * np.logaddexp(0, -sign * (evidence @ weights))).sum() + _RIDGE * (weights**2).sum())

    loss, doubt = minimize(cost, np.zeros(2), bounds=[(0, None)] * 2).x
    return round(float(loss), 3), round(float(doubt), 3)


def counted(pairs: Sequence[Pair], loss: float, doubt: float, prior: float) -> dict[str, Any]:
    """Count how often the kept fit is the better one, and how much the choice changes.

    Args:
        pairs: fits with known errors.
        loss: its weight.
        doubt: its weight.
        prior: log odds of the front as found.
    """
    log_odds = np.array([_evidence(one) for one in pairs]) @ [loss, doubt] + prior
    found, mirrored = (np.array([getattr(one, name) for one in pairs]) for name in ("found_mm", "mirrored_mm"))
    kept = np.where(log_odds >= 0, found, mirrored)
    return {
        "n": len(pairs),
        "mirrored": int((log_odds < 0).sum()),
        "kept_the_better": int((kept <= np.minimum(found, mirrored)).sum()),
        "as_found_mm": round(float(found.mean()), 1),
        "kept_mm": round(float(kept.mean()), 1),
        "better_of_both_mm": round(float(np.minimum(found, mirrored).mean()), 1),
    }


def pairs_of(folders: Sequence[Path], every: int) -> Iterator[Pair]:
    """Fit both fronts of every case: the sure ones tell how sure a doubt of the other sign is.

    Args:
        folders: of hfb benchmark.
        every: take every so many-th case.
    """
    config = preset("best")
    no_search = config.fit.directions.model_copy(update={"search": False})
    config = config.model_copy(update={"fit": config.fit.model_copy(update={"directions": no_search})})
    body, prior = load_default_body(), load_pose_prior(None, config.prior.kind)
    for benchmark in folders:
        for place in sorted((benchmark / "cases").glob("case_*"))[::every]:
            case, looked = load_case(place), benchmark / "intermediate" / place.name
            truth, seen = load_truth_of(case.truth), _observation(case, looked)
            starts = [load_first_body(looked / f"first_body_{index}.npz") for index in range(case.frames)]
            other = find_other_front(seen, starts, body, sure=math.inf)
            assert other is not None
            other = replace(other, to_the_end=True)
            result = fit(seen, starts, body, config.fit, config.seed, prior, other_front=other)
            front = result.front
            assert front is not None
            motions = (front.other, result.motion) if front.mirrored else (result.motion, front.other)
            found, mirrored = (
                judge(Prediction(motion, None, None, 0.0), seen, truth, body, None)["mpjpe_mm"] for motion in motions
            )
            print(f"{place}: {_told(front, found, mirrored)}", file=sys.stderr)
            yield Pair(front.loss_ratio, front.doubt, found, mirrored)


def _observation(case: Case, looked: Path) -> Observation:
    frames = [torch.from_numpy(srgb_to_linear(read_picture_srgb(path))) for path in case.frame_paths()]
    mattes = [torch.from_numpy(read_matte(looked / f"matte_{index}.png")) for index in range(case.frames)]
    clip = read_clip(case.clip)
    exposure = clip.exposure
    interval_s = 1 / exposure.fps if exposure.fps else 1 / 30
    height, width = mattes[0].shape
    return Observation(
        frames_linear=torch.stack(frames).float(),
        plate_linear=torch.from_numpy(srgb_to_linear(read_picture_srgb(case.background))).float(),
        mattes=torch.stack(mattes).float(),
        camera=PinholeCamera.from_matrix(torch.tensor(clip.camera.K), height, width),
        exposure_s=exposure.exposure_s(interval_s) or interval_s,
        interval_s=interval_s,
    )


def _evidence(pair: Pair) -> tuple[float, float]:
    return pair.loss_ratio, pair.doubt


def _told(front: FrontChoice, found_mm: float, mirrored_mm: float) -> str:
    return (
        f"doubt {front.doubt:.2f}, loss {front.loss_ratio:+.3f}, "
        f"as found {found_mm:.0f} mm, mirrored {mirrored_mm:.0f} mm"
    )
