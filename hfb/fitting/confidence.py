"""Confidence of joints: a radius per joint and sub-frame with half of the errors, and the law of larger ones.

The error is the one that MPJPE averages: of a joint about the pelvis, after one rotation of the whole sequence.
It is modelled by a Weibull law with one exponent k and a median of its own for every joint and instant,

    P(error <= x) = 1 - 2^-((x / radius)^k),        log radius = b_0 + sum_i b_i f_i,

whose features f_i are computed from the fit. The coefficients are fitted by maximum likelihood to fits whose truth is
known (`hfb train confidence`) and are in data/confidence.json, a set for each kind of start: errors are twice as large
from a start that was estimated from its image as from a simulated one. A new feature is a new entry in
`hfb.fitting.joint_features`.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any, Literal, get_args

import numpy as np

from hfb.typing import Array, Float, Int

StartKind = Literal["simulated", "network", "matte"]
"""Source of a first body: simulated from the truth, as benchmarks do; a pose network; the matte's outline alone."""

Features = Mapping[str, Float[Array, "R 24"]]
_CALIBRATED = ("simulated", "mediapipe", "matte", "between")
KIND_WORDS: Mapping[str, str] = {
    "simulated": "simulated starts",
    "network": "starts by a pose network",
    "matte": "starts by the matte alone",
}


@dataclass(frozen=True)
class ConfidenceModel:
    """The coefficients of the log-linear radius, and the exponent of the law.

    Attributes:
        coefficients: b_i by the feature's name.
        constant: b_0, of a radius in mm.
        exponent: k.
        typical: the features' means where the model was fitted: they stand in for what a fit does not know.
    """

    coefficients: Mapping[str, float]
    constant: float
    exponent: float
    typical: Mapping[str, float]

    def radius_mm(self, features: Features) -> Float[Array, "R 24"]:
        """Return the radius with P(error <= radius) = 0.5; zero for the pelvis, the origin of all errors.

        Args:
            features: one table per name, see `hfb.fitting.joint_features`.
        """
        exponent = np.full_like(next(iter(features.values())), self.constant)
        for name, weight in self.coefficients.items():
            exponent = exponent + weight * features.get(name, self.typical[name])
        radius = np.exp(exponent)
        radius[:, 0] = 0
        return radius


def radius_factor(probability: float, exponent: float) -> float:
    """Return how many radii contain the error with this probability: the law solved for x / radius.

    Args:
        probability: P(error <= factor x radius).
        exponent: k of the law.
    """
    return float(np.log2(1 / (1 - probability)) ** (1 / exponent))


def start_kind(source: str) -> StartKind:
    """Return the kind of a first body by its ``source``; other systems' and neighbours' bodies count as a network's.

    Args:
        source: source of a first body.
    """
    if source == "simulated":
        return "simulated"
    return "matte" if source == "matte" else "network"


@lru_cache
def _shipped() -> dict[str, Any]:
    return json.loads(resources.files("hfb.fitting").joinpath("data/confidence.json").read_text())


@lru_cache
def shipped_confidence(kind: StartKind = "network") -> ConfidenceModel:
    """Load the shipped model of a kind of start; the exponent is the same for all.

    Args:
        kind: kind of start.
    """
    content = _shipped()
    of_kind = {name: content["by_start"][kind][name] for name in ("coefficients", "constant", "typical")}
    return ConfidenceModel(exponent=content["exponent"], **of_kind)


def shipped_radius_mm(features: Features, frame_index: Int[Array, "R"], sources: Sequence[str]) -> Float[Array, "R 24"]:
    """Return every row's radius, by the source of its frame's first body.

    Args:
        features: one table per name, see `hfb.fitting.joint_features`.
        frame_index: frame of every row.
        sources: sources of every frame's first body.
    """
    radius = np.empty_like(features["reach"])
    kinds = np.array([start_kind(source) for source in sources])[frame_index]
    for kind in get_args(StartKind):
        rows = kinds == kind
        radius[rows] = shipped_confidence(kind).radius_mm({name: table[rows] for name, table in features.items()})
    return radius


def radius_condition(sources: Sequence[str]) -> dict[str, Any]:
    """Return the basis of a result's radii: the kinds of its starts, how often radii held there, and a sentence.

    Args:
        sources: sources of the first bodies of all frames.
    """
    kinds = sorted({start_kind(source) for source in sources})
    shipped = _shipped()["by_start"]
    measured = {kind: shipped[kind]["people_held_out"] for kind in kinds}
    new = {kind: shipped[kind]["new_people"] for kind in kinds if "new_people" in shipped[kind]}
    told = "; ".join(
        f"{KIND_WORDS[kind]}: {100 * one['within_p50']:.0f} % of joints within the radius said for 50 %, "
        f"{100 * one['within_p90']:.0f} % within that for 90 % (n {one['n']})"
        for kind, one in (measured | new).items()
    )
    others = sorted({source for source in sources if source not in _CALIBRATED})
    beyond = f" Starts by {', '.join(others)} were not calibrated: a network's radii are taken." if others else ""
    sentence = (
        f"Radii were calibrated on synthetic pictures and checked on other people. From {told}. "
        "Real pictures were not part of it: where front and back, or left and right, are mistaken, errors are larger."
        f"{beyond}"
    )
    return {"starts": kinds, "people_held_out": measured, "new_people": new, "holds_for": sentence}
