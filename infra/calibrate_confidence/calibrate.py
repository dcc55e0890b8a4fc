"""Make hfb/fitting/data/confidence.json, and directions.json, from benchmarks whose truth is known.

python calibrate.py --simulated DIR --network DIR --matte DIR --out ../../hfb/fitting/data
"""

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from hfb.datasets.truth import load_truth
from hfb.evaluation.calibration import (
    DirectionCase,
    JointCase,
    fit_confidence,
    fit_direction_odds,
    held_out_reliability,
    reliability_of,
)
from hfb.evaluation.metrics import errors_mm, mpjpe_mm
from hfb.evaluation.reliability import LEVELS
from hfb.fitting.alternatives import load_alternatives
from hfb.fitting.confidence import ConfidenceModel, StartKind
from hfb.fitting.direction_odds import EVIDENCE
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.motion_file import load_motion

_PERSON = re.compile(r"cmu_(\d+)_")


def main() -> None:
    """Fit the coefficients of every kind of start and write them, with how well they do on people left out."""
    parser = argparse.ArgumentParser(description=__doc__)
    for kind in get_args(StartKind):
        help_text = f"folders of hfb benchmark whose starts are of the kind {kind}"
        parser.add_argument(f"--{kind}", type=Path, nargs="+", default=[], help=help_text)
    parser.add_argument("--methods", nargs="+", default=["best"], help="whose answers [best]")
    parser.add_argument("--features", help="comma-separated, instead of all that the fits left")
    parser.add_argument("--directions", type=Path, nargs="+", default=[], help="folders for directions.json, one frame")
    parser.add_argument("--several", type=Path, nargs="+", default=[], help="the same with --frames 2")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    given = {kind: getattr(options, kind) for kind in get_args(StartKind)}
    if any(given.values()):
        cases = {kind: by_person(folders, options.methods) for kind, folders in given.items()}
        write_confidence(cases, options.features, options.out / "confidence.json")
    if options.directions:
        write_directions(options.directions, options.several, options.methods[0], options.out / "directions.json")


def by_person(folders: Sequence[Path], methods: Sequence[str]) -> list[JointCase]:
    """The cases of some benchmarks, held together by person."""
    found = [joint for folder in folders for method in methods for joint, _ in read_cases(folder, method)]
    return [replace(one, recording=person_of(one.recording)) for one in found]


def person_of(recording: str) -> str:
    """The person who made a recording: CMU's subject, else the recording itself."""
    found = _PERSON.search(recording)
    return found[1] if found else recording


def write_confidence(cases: dict[StartKind, list[JointCase]], features: str | None, path: Path) -> None:
    """Coefficients per kind, pulled to those of the file's ``prior``, whose exponent all kinds share.

    A kind for which the prior itself is nearer to what happened, on people left out of both, keeps it.

    Raises:
        SystemExit: a kind has no case.
    """
    if empty := [kind for kind, known in cases.items() if not known]:
        raise SystemExit(f"no case of {', '.join(empty)}: give --{empty[0]} DIR")
    earlier = json.loads(path.read_text())
    prior = ConfidenceModel(**earlier["prior"])
    names = features.split(",") if features else list(cases["network"][0].features)
    exponent = prior.exponent
    by_start: dict[str, Any] = {}
    for kind, known in cases.items():
        people = sorted({case.recording for case in known})
        counts = {"n": len(known), "people": people}
        before, model = reliability_of(prior, known), prior
        held_out: dict[str, float] = before
        after = held_out_reliability(known, names, len(people), exponent, prior)
        if _off(after) < _off(before):
            held_out, model = after, fit_confidence(known, names, exponent, prior)
        told = {name: value for name, value in asdict(model).items() if name != "exponent"}
        by_start[kind] = told | {"people_held_out": held_out | counts, "before": before | counts}
        print(
            kind, json.dumps({"before": by_start[kind]["before"], "after": by_start[kind]["people_held_out"]}, indent=1)
        )
    write(path, {"exponent": exponent, "by_start": by_start, "prior": earlier["prior"]})


def _off(measured: Mapping[str, float]) -> float:
    """Mean distance of what happened from what was said."""
    return float(np.mean([abs(measured[f"within_p{100 * level:.0f}"] - level) for level in LEVELS]))


def write_directions(singles: Sequence[Path], several: Sequence[Path], method: str, path: Path) -> None:
    """The odds of directions from benchmarks of one frame, and of several frames where there are any."""
    one, more = (
        [direction for folder in folders for _, direction in read_cases(folder, method)]
        for folders in (singles, several)
    )
    odds = {"single": fit_direction_odds(one), "several": fit_direction_odds(more or one)}
    made_from = {"methods": [method], "cases_of_one_frame": len(one), "cases_of_several": len(more)}
    write(path, odds | {"made_from": made_from})


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
