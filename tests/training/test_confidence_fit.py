"""Radii of one kind of start, fitted where the file holds others."""

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import hfb.fitting
from hfb.errors import InputError
from hfb.evaluation.calibration import DirectionCase, JointCase
from hfb.training.confidence import confidence_fit
from hfb.training.confidence.confidence_fit import Case, write_confidence

_SHIPPED = Path(hfb.fitting.__file__).parent / "data"


def _cases(doubled: bool) -> list[Case]:
    """Cases of three people whose errors follow the shipped prior's radii, or are twice as large."""
    prior = json.loads((_SHIPPED / "confidence.json").read_text())["prior"]
    rng = np.random.default_rng(0)
    cases = []
    for number in range(30):
        features = {name: value + rng.normal(0, 0.1, (8, 24)) for name, value in prior["typical"].items()}
        radius = np.exp(prior["constant"] + sum(prior["coefficients"][name] * features[name] for name in features))
        errors = (1 + doubled) * radius * np.log2(1 / rng.uniform(size=(8, 24))) ** (1 / prior["exponent"])
        joints = JointCase(f"cmu_{number % 3:02d}_01", features, errors)
        cases.append(Case(joints, DirectionCase("", 1, np.zeros((2, 4)), np.zeros(2)), ()))
    return cases


def test_one_kind_is_fitted_and_the_others_stay(tmp_path: Path) -> None:
    path = tmp_path / "confidence.json"
    shutil.copy(_SHIPPED / "confidence.json", path)
    before = json.loads(path.read_text())
    write_confidence({"network": _cases(doubled=True)}, dict.fromkeys(("network",), ()), None, path)
    after = json.loads(path.read_text())
    assert {kind: after["by_start"][kind] for kind in ("simulated", "matte")} == {
        kind: before["by_start"][kind] for kind in ("simulated", "matte")
    }
    told = after["by_start"]["network"]
    assert told["before"]["within_p50"] < 0.3
    assert abs(told["people_held_out"]["within_p50"] - 0.5) < 0.05
    assert told["before"]["n"] == 30


def test_new_people_of_a_kind_that_is_not_fitted_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confidence_fit, "cases_of", lambda folders, _: _cases(doubled=False) if folders else [])
    parser = argparse.ArgumentParser()
    confidence_fit.add_flags(parser)
    words = ["--network", str(tmp_path), "--new-matte", str(tmp_path), "--out", str(tmp_path)]
    with pytest.raises(InputError, match="--new-matte counts what --matte was fitted to: give both"):
        confidence_fit.run(parser.parse_args(words))
    assert not list(tmp_path.iterdir())
