"""Fit hfb/fitting/data/confidence.json and directions.json to benchmarks with known truth.

hfb train confidence --simulated DIR --network DIR --matte DIR --new-simulated DIR ... --out hfb/fitting/data
"""

import argparse
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from hfb.datasets.truth import load_truth
from hfb.errors import InputError
from hfb.evaluation.calibration import (
    DirectionCase,
    JointCase,
    fit_confidence,
    fit_direction_odds,
    held_out_reliability,
    reliability_of,
)
from hfb.evaluation.direction_calibration import (
    DirectionEvent,
    direction_events,
    fit_trust,
    reliability_groups,
    said_and_right,
)
from hfb.evaluation.metrics import errors_mm, mpjpe_mm
from hfb.evaluation.reliability import DIRECTION_EDGES, LEVELS
from hfb.fitting.alternatives import load_alternatives
from hfb.fitting.confidence import ConfidenceModel, StartKind
from hfb.fitting.direction_odds import EVIDENCE, probabilities
from hfb.fitting.direction_trust import Trust
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.motion_file import load_motion
from hfb.training.flags import folder
from hfb.training.weight_files import read_story

_PERSON = re.compile(r"cmu_(\d+)_")
_COARSE = (0.0, 0.6, 0.8, 1.0)
"""Edges of the groups of stated probabilities of a direction in a result."""


@dataclass(frozen=True)
class Case:
    """Joint errors, directions and direction events of one benchmark case with a result."""

    joints: JointCase
    hypotheses: DirectionCase
    events: tuple[DirectionEvent, ...]

    @property
    def person(self) -> str:
        """The person of the recording."""
        return person_of(self.joints.recording)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add = parser.add_argument
    for kind in get_args(StartKind):
        of_kind = f"folders of hfb benchmark whose starts are of the kind {kind}"
        add(f"--{kind}", type=folder, nargs="+", default=[], metavar="DIR", help=of_kind)
        new = f"{of_kind}, of people who took no part in any choice: counted, not learned from"
        add(f"--new-{kind}", type=folder, nargs="+", default=[], metavar="DIR", help=new)
    add("--methods", nargs="+", default=["best"], help="whose answers [best]")
    add("--features", help="comma-separated, instead of all that the fits left")
    add("--directions", type=folder, nargs="+", default=[], metavar="DIR", help="for directions.json, one frame")
    add("--several", type=folder, nargs="+", default=[], metavar="DIR", help="the same with --frames 2")
    add(
        "--out",
        type=folder,
        required=True,
        metavar="DIR",
        help="with the confidence.json and directions.json of before",
    )


def run(options: argparse.Namespace) -> None:
    """Fit the coefficients of the kinds of start that have cases, and measure them on people left out.

    Args:
        options: the parsed options.
    """
    if options.directions:
        write_directions(options.directions, options.several, options.methods[0], options.out / "directions.json")
    known, new = (
        {kind: cases_of(getattr(options, f"{which}{kind}"), options.methods) for kind in get_args(StartKind)}
        for which in ("", "new_")
    )
    if not any(known.values()):
        if not options.directions:
            raise InputError("no answered case: give --simulated, --network and --matte, or --directions")
        return
    known = {kind: cases for kind, cases in known.items() if cases}
    if alone := [kind for kind, cases in new.items() if cases and kind not in known]:
        raise InputError(f"--new-{alone[0]} counts what --{alone[0]} was fitted to: give both")
    write_confidence(known, new, options.features, options.out / "confidence.json")
    if len(known) == len(new):  # what one kind's doubt is drawn to are the others'
        write_trust(known, new, options.out / "directions.json")


def cases_of(folders: Sequence[Path], methods: Sequence[str]) -> list[Case]:
    """Read the cases of several benchmarks.

    Args:
        folders: results of hfb benchmark.
        methods: names of the methods whose results count.
    """
    return [case for folder in folders for method in methods for case in read_cases(folder, method)]


def person_of(recording: str) -> str:
    """Return the person of a recording: CMU's subject, or the recording's name.

    Args:
        recording: its name.
    """
    found = _PERSON.search(recording)
    return found[1] if found else recording


def write_confidence(
    cases: Mapping[StartKind, Sequence[Case]], new: Mapping[StartKind, Sequence[Case]], features: str | None, path: Path
) -> None:
    """Fit the coefficients of the kinds of start that have cases and write them; those of other kinds stay.

    The fit is regularised towards the file's ``prior``, whose exponent all kinds share. A kind keeps the prior where it
    is better calibrated on people left out.

    Args:
        cases: per kind of start, to fit to.
        new: per kind of start, to measure on only.
        features: comma-separated names; None for all of the cases.
        path: confidence.json, which exists.
    """
    earlier = read_story(path)
    prior = ConfidenceModel(**earlier["prior"])
    names = features.split(",") if features else list(next(iter(cases.values()))[0].joints.features)
    exponent = prior.exponent
    by_start: dict[str, Any] = earlier["by_start"]
    for kind, some in cases.items():
        known = [replace(case.joints, recording=case.person) for case in some]
        before, model = reliability_of(prior, known), prior
        held_out: dict[str, float] = before
        after = held_out_reliability(known, names, len(_people(some)), exponent, prior)
        if _off(after) < _off(before):
            held_out, model = after, fit_confidence(known, names, exponent, prior)
        told = {name: value for name, value in asdict(model).items() if name != "exponent"}
        counts = {"n": len(some), "people": _people(some)}
        by_start[kind] = told | {"people_held_out": held_out | counts, "before": before | counts}
        if new[kind]:
            found = reliability_of(model, [case.joints for case in new[kind]])
            by_start[kind]["new_people"] = found | {"n": len(new[kind]), "people": _people(new[kind])}
        shown = {name: by_start[kind].get(name) for name in ("before", "people_held_out", "new_people")}
        print(kind, json.dumps(shown, indent=1))
    write(path, {"exponent": exponent, "by_start": by_start, "prior": earlier["prior"]})


def write_trust(cases: Mapping[StartKind, Sequence[Case]], new: Mapping[StartKind, Sequence[Case]], path: Path) -> None:
    """Fit how far the odds of directions can be trusted from every kind of start, and measure on people left out.

    Args:
        cases: per kind of start, to fit to.
        new: per kind of start, to measure on only.
        path: directions.json, which exists.
    """
    events = {kind: [event for case in some for event in case.events] for kind, some in cases.items()}
    content = read_story(path)
    content["trust"] = {}
    for kind, trust in fit_trust(events).items():
        print(kind, "directions of the body, on people left out in turn")
        said_right = _said_of_left_out(events, kind)
        _counted(said_right, DIRECTION_EDGES)
        left_out = _counted(said_right, _COARSE, show=False)
        content["trust"][kind] = asdict(trust) | {
            "n": len(cases[kind]),
            "people": _people(cases[kind]),
            "people_held_out": left_out,
            "new_people": {
                name: _new(kind, trust, [case for case in new[kind] if (case.hypotheses.frames > 1) == several])
                for name, several in (("one_frame", False), ("several_frames", True))
            },
        }
    write(path, content)


Said = tuple[Sequence[float], Sequence[bool]]


def _said_of_left_out(events: Mapping[StartKind, Sequence[DirectionEvent]], kind: StartKind) -> Said:
    """Return stated probabilities and outcomes of bodies in single frames, a person's by the others' coefficients."""
    said: list[float] = []
    right: list[bool] = []
    for person in sorted({event.person for event in events[kind]}):
        others = {one: [event for event in known if event.person != person] for one, known in events.items()}
        queries = [event for event in events[kind] if event.person == person and event.whole and event.frames == 1]
        told, happened = said_and_right(queries, fit_trust(others)[kind])
        said += told.tolist()
        right += happened.tolist()
    return said, right


def _new(kind: StartKind, trust: Trust, cases: Sequence[Case]) -> dict[str, Any] | None:
    """Return how the odds hold on new people, in groups of stated probabilities of bodies and limbs; prints them."""
    if not cases:
        return None
    queries = [event for case in cases for event in case.events]
    told: dict[str, Any] = {"n": len(cases), "people": _people(cases)}
    for name, whole in (("body", True), ("limbs", False)):
        some = [event for event in queries if event.whole == whole]
        for when, how in (("before", None), ("after", trust)):
            print(kind, f"directions of {name}, new people, {when}")
            _counted(said_and_right(some, how), DIRECTION_EDGES)
        told[name] = _counted(said_and_right(some, trust), _COARSE, show=False)
    return told


def _counted(
    said_right: Said | tuple[np.ndarray, np.ndarray], edges: Sequence[float], show: bool = True
) -> list[dict[str, float]]:
    groups = reliability_groups(np.array(said_right[0]), np.array(said_right[1], bool), edges)
    for one in groups if show else ():
        print("  said {said:.2f} right {right:.2f} [{low:.2f}, {high:.2f}] n {n}".format(**one))
    return groups


def _people(cases: Sequence[Case]) -> list[str]:
    return sorted({case.person for case in cases})


def _off(measured: Mapping[str, float]) -> float:
    """Return the mean distance of observed frequencies from stated probabilities."""
    return float(np.mean([abs(measured[f"within_p{100 * level:.0f}"] - level) for level in LEVELS]))


def write_directions(singles: Sequence[Path], several: Sequence[Path], method: str, path: Path) -> None:
    """Fit the odds of directions to benchmarks of one frame, and of several frames where given.

    Args:
        singles: folders of hfb benchmark with one frame.
        several: folders with several frames; where empty, single frames stand in.
        method: whose results count.
        path: directions.json, which exists.
    """
    one, more = ([case.hypotheses for case in cases_of(folders, [method])] for folders in (singles, several))
    odds = {"single": fit_direction_odds(one), "several": fit_direction_odds(more or one)}
    made_from = {"methods": [method], "cases_of_one_frame": len(one), "cases_of_several": len(more)}
    write(path, read_story(path) | odds | {"made_from": made_from})


def read_cases(folder: Path, method: str) -> Iterator[Case]:
    """Read every case of a benchmark that the method has a result for.

    Args:
        folder: of hfb benchmark.
        method: name of the method.
    """
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
        frames = int(motion.frame_index.max()) + 1
        as_measured = replace(alternatives, probability=probabilities(evidence, frames > 1))
        yield Case(
            JointCase(recording, features, errors_mm(motion.joints, true)),
            DirectionCase(recording, frames, evidence, errors),
            tuple(direction_events(person_of(recording), as_measured, features, true)),
        )


def write(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file atomically.

    Args:
        path: the file.
        content: anything JSON can hold.
    """
    write_bytes_atomic(path, json.dumps(content, indent=1).encode() + b"\n")
