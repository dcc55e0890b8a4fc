"""Fit the error factors of a limb's top speed to benchmarks with known truth; writes limb_speed.json.

hfb train limb-speeds --singles BENCHMARK --several BENCHMARK --method best --out hfb/report/pages/data
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from hfb.datasets.truth import load_truth
from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.motion_file import load_motion
from hfb.report.pages.limb_speed import LIMB_ENDS, sureness_m_s
from hfb.training.flags import folder

_SHARE = 0.8
_FILE = "limb_speed.json"


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add = parser.add_argument
    add("--singles", type=folder, nargs="+", required=True, metavar="DIR", help="of hfb benchmark, one frame")
    add("--several", type=folder, nargs="+", required=True, metavar="DIR", help="of hfb benchmark --frames 2 ...")
    add("--method", default="best", help="whose answers [best]")
    add("--out", type=folder, required=True, metavar="DIR", help="where limb_speed.json goes")


def run(options: argparse.Namespace) -> None:
    """Find the factors; measure on one half of the recordings with factors of the other half.

    Args:
        options: the parsed options.
    """
    found: dict[str, Any] = {"share": _SHARE, "measured": {}}
    for name, folders in (("single", options.singles), ("several", options.several)):
        rows = np.array([row for folder in folders for row in speeds_of(folder, options.method)])
        if not len(rows):
            raise InputError(f"no answered case of {options.method} in {folders[0]}: give folders of hfb benchmark")
        for part, chosen in (("limbs", rows[:, 1] > 0), ("pelvis", rows[:, 1] == 0)):
            found.setdefault(name, {})[part] = [round(factor, 3) for factor in factors_of(rows[chosen])]
            found["measured"][f"{name} {part}"] = {"speeds": int(chosen.sum()), "held_out": held_out(rows[chosen])}
    print(json.dumps(found, indent=1))
    write_bytes_atomic(options.out / _FILE, json.dumps(found, indent=1).encode() + b"\n")


def factors_of(rows: np.ndarray) -> tuple[float, float]:
    """Return the quantiles of (true - fitted top speed) over (radius / exposure).

    Args:
        rows: as `speeds_of` has them.
    """
    fitted, true, scale = rows[:, 2:].T
    low, high = np.quantile((true - fitted) / scale, [(1 - _SHARE) / 2, (1 + _SHARE) / 2])
    return float(low), float(high)


def held_out(rows: np.ndarray) -> list[float]:
    """Return the share of true speeds inside, of slow, middle and fast limbs, each half with the other half's factors.

    Args:
        rows: as `speeds_of` has them.
    """
    inside = np.zeros(len(rows), bool)
    for half in (0, 1):
        mine = rows[:, 0] % 2 == half
        low, high = factors_of(rows[~mine])
        fitted, true, scale = rows[mine, 2:].T
        inside[mine] = (true >= np.maximum(0, fitted + low * scale)) & (true <= fitted + high * scale)
    thirds = np.array_split(np.argsort(rows[:, 2], kind="stable"), 3)
    return [round(float(inside[third].mean()), 3) for third in thirds]


def speeds_of(folder: Path, method: str) -> list[tuple[int, int, float, float, float]]:
    """Return (case, joint, fitted and true top speed, radius over exposure [m/s]) of every limb in every frame.

    Args:
        folder: of hfb benchmark.
        method: name of the method.
    """
    rows = []
    for case, answer in enumerate(sorted((folder / "methods" / method).glob("case_*"))):
        truth = load_truth(folder / "cases" / answer.name / "truth.npz").motion
        motion, _ = load_motion(answer / "motion.npz")
        near = np.abs(truth.times_s[None] - motion.times_s[:, None]).argmin(1)
        for joint in LIMB_ENDS.values():
            for frame in np.unique(motion.frame_index):
                at = motion.rows_of(int(frame))
                fitted = top_speed(motion.joints[at, joint], motion.times_s[at])
                true = top_speed(truth.joints[near[at], joint], truth.times_s[near[at]])
                rows.append((case, joint, fitted, true, sureness_m_s(motion, joint, at)))
    return rows


def top_speed(path: np.ndarray, times_s: np.ndarray) -> float:
    """Return the highest speed between neighbouring instants [m/s].

    Args:
        path: (n, 3) positions [m].
        times_s: (n,) instants.
    """
    return float((np.linalg.norm(np.diff(path, axis=0), axis=-1) / np.diff(times_s)).max())
