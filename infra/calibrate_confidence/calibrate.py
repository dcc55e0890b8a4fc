"""Make hfb/fit/data/confidence.json and directions.json from benchmarks whose truth is known.

python calibrate.py --singles BENCHMARK --several BENCHMARK --methods best best@true-height --out ../../hfb/fit/data
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hfb.datasets.truth import load_truth
from hfb.evaluate.calibration import (
    DirectionCase,
    JointCase,
    fit_confidence,
    fit_direction_odds,
    held_out_reliability,
)
from hfb.evaluate.metrics import errors_mm, mpjpe_mm
from hfb.export.motion_file import load_motion
from hfb.fit.alternatives import load_alternatives
from hfb.fit.direction_odds import EVIDENCE
from hfb.media.atomic import write_bytes_atomic


def main() -> None:
    """Fit both sets of coefficients and write them, with what they were fitted to and how well they do."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--singles", type=Path, nargs="+", required=True, help="folders of hfb benchmark, one frame")
    parser.add_argument("--several", type=Path, nargs="+", default=[], help="folders of hfb benchmark --frames 2 ...")
    parser.add_argument(
        "--methods", nargs="+", default=["best"], help="whose answers [best]; the first one's for the directions"
    )
    parser.add_argument("--features", help="comma-separated, instead of all that the fits left")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    first, *others = options.methods
    singles, several = (
        [case for folder in folders for case in read_cases(folder, first)]
        for folders in (options.singles, options.several)
    )
    more = [read_cases(folder, method) for folder in (*options.singles, *options.several) for method in others]
    joints = [joint for joint, _ in (*singles, *several, *(case for cases in more for case in cases))]
    names = options.features.split(",") if options.features else list(joints[0].features)
    model = fit_confidence(joints, names)
    measured = held_out_reliability(joints, names)
    print(json.dumps(measured, indent=1))
    made_from = {"methods": options.methods, "cases_of_one_frame": len(singles), "cases_of_several": len(several)}
    write(
        options.out / "confidence.json",
        asdict(model) | {"made_from": made_from, "on_recordings_held_out": measured},
    )
    odds = {"single": fit_direction_odds([direction for _, direction in singles])}
    if several:
        odds["several"] = fit_direction_odds([direction for _, direction in several])
    else:
        odds["several"] = odds["single"]
    write(options.out / "directions.json", odds | {"made_from": made_from | {"methods": [first]}})


def read_cases(folder: Path, method: str) -> list[tuple[JointCase, DirectionCase]]:
    """Every answered case of a benchmark."""
    cases = []
    for answer in sorted((folder / "methods" / method).glob("case_*")):
        if not (answer / "alternatives.npz").exists():
            continue
        truth = load_truth(folder / "cases" / answer.name / "truth.npz").motion
        motion, _ = load_motion(answer / "motion.npz")
        alternatives, features = load_alternatives(answer / "alternatives.npz")
        true = truth.joints[np.abs(truth.times_s[None] - motion.times_s[:, None]).argmin(1)]
        recording = json.loads((folder / "cases" / answer.name / "case.json").read_text())["motion"]["name"]
        errors = np.array([mpjpe_mm(joints, true) for joints in alternatives.joints])
        evidence = np.stack([alternatives.scores[name] for name in EVIDENCE], 1)
        cases.append(
            (
                JointCase(recording, features, errors_mm(motion.joints, true)),
                DirectionCase(recording, int(motion.frame_index.max()) + 1, evidence, errors),
            )
        )
    return cases


def write(path: Path, content: dict) -> None:
    """Whole or not at all."""
    write_bytes_atomic(path, json.dumps(content, indent=1).encode() + b"\n")


if __name__ == "__main__":
    main()
