"""Uncertainties of a result, and alternative motions, as parts of its page."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from hfb.body.height import height_m
from hfb.body.model import Body
from hfb.body.skeleton import JOINT_NAMES
from hfb.fitting.alternatives import LIMB_NAMES, Alternatives
from hfb.fitting.front_choice import ANOTHER_FRONT_DEG
from hfb.motion.sampled import SampledMotion
from hfb.report.pages.viewer import ViewedMotion
from hfb.typing import Array

_SHOWN = 12
_LEAST_SURE, _MOST_SURE = 4, 3
_SCORES = (
    ("loss", "weighted loss", ".3f"),
    ("excess", "worse by", ".3f"),
    ("image", "image", ".2e"),
    ("matte", "matte", ".4f"),
    ("joints", "joints", ".4f"),
    ("path", "path", ".4f"),
    ("motion", "motion", ".3f"),
)
_ARROW = (("limbs_backwards", "prior against it", ".2f"), ("network_backwards", "network against it", ".2f"))
"""Evidence for the direction of a single frame; with several frames continuity is part of the loss."""


def unknown_sentences(motion: SampledMotion, body: Body | None, facts: Mapping[str, Any]) -> list[str]:
    """Return sentences on what the frames do not determine.

    Args:
        motion: fitted motion.
        body: the body model; None where it is not available.
        facts: content of result.json.
    """
    said = []
    if isinstance(facts.get("unknown"), str):
        said = [str(facts["unknown"]), *_condition(facts, "directions")]
    height = _size_said(motion, body, _told_height(facts))
    return [*said, *_front_said(facts), *_joints_said(motion, facts), *_frames_said(facts), height]


def _front_said(facts: Mapping[str, Any]) -> list[str]:
    """Return a sentence on the way the person faces, where both ways were fitted and differ."""
    match facts.get("front"):
        case {"probability": int() | float() as sure, "turn_deg": int() | float() as turn} if turn > ANOTHER_FRONT_DEG:
            said = (
                f"Which way the person faces was in doubt; both ways were fitted: {100 * sure:.0f} % for the way shown."
            )
            return [f"{said} The viewer above has the other one, too."]
    return []


def alternatives_table(alternatives: Alternatives | None) -> dict[str, list[Any]] | None:
    """Return ``head`` and ``rows`` of the motions that were weighed, the likeliest first; None where none were.

    Args:
        alternatives: content of alternatives.npz; None without a search of directions.
    """
    if alternatives is None:
        return None
    shown = _SCORES + _ARROW if alternatives.reversed_limbs.shape[1] == 1 else _SCORES
    known = [(name, label, form) for name, label, form in shown if name in alternatives.scores]
    rows = [
        [
            reversed_text(alternatives.reversed_limbs[number], alternatives.reversed_limbs[alternatives.chosen]),
            f"{100 * alternatives.probability[number]:.0f} %",
            *(format(float(alternatives.scores[name][number]), form) for name, _, form in known),
        ]
        for number in by_probability(alternatives)[:_SHOWN]
    ]
    return {"head": ["compared with the result", "share", *(label for _, label, _ in known)], "rows": rows}


def alternative_motions(motion: SampledMotion, alternatives: Alternatives) -> list[ViewedMotion]:
    """Return the motions that were not chosen, the likeliest first, then the other front, for the viewer.

    Args:
        motion: the result; gives times and camera.
        alternatives: content of alternatives.npz.
    """
    chosen = alternatives.reversed_limbs[alternatives.chosen]
    named = {}
    for number in by_probability(alternatives)[:_SHOWN]:
        if number != alternatives.chosen:
            name = reversed_text(alternatives.reversed_limbs[number], chosen)
            moved = alternatives.poses[number], alternatives.trans[number], alternatives.joints[number]
            named[f"{name} ({100 * alternatives.probability[number]:.0f} %)"] = moved
    if (front := alternatives.other_front) is not None:
        named[f"facing the other way ({100 * front.probability:.0f} %)"] = front.poses, front.trans, front.joints
    return [
        ViewedMotion(name, replace(motion, poses=poses, trans=trans, joints=joints))
        for name, (poses, trans, joints) in named.items()
    ]


def by_probability(alternatives: Alternatives) -> list[int]:
    """Return the numbers of the motions: the result first, then by falling probability.

    Args:
        alternatives: content of alternatives.npz.
    """
    order = np.argsort(-alternatives.probability, kind="stable").tolist()
    return sorted(order, key=lambda number: number != alternatives.chosen)


def reversed_text(reversed_limbs: Array, chosen: Array) -> str:
    """Describe which limbs of which frames move in the direction opposite to the result's.

    Args:
        reversed_limbs: (T, 5), whether a limb is reversed against the motion as fitted.
        chosen: the same of the result.
    """
    different = reversed_limbs != chosen
    if not different.any():
        return "the result"
    if different.all():
        return "all the other way"
    said = []
    for number, frame in enumerate(different, 1):
        limbs = [name for name, other in zip(LIMB_NAMES, frame, strict=True) if other]
        if limbs:
            kept = [name for name in LIMB_NAMES if name not in limbs]
            words = " and ".join(limbs) if len(limbs) <= len(LIMB_NAMES) // 2 + 1 else f"all but {' and '.join(kept)}"
            words = "everything" if not kept else words
            said.append(f"frame {number}: {words}" if len(different) > 1 else words)
    return f"{'; '.join(said)} the other way"


def _joints_said(motion: SampledMotion, facts: Mapping[str, Any]) -> list[str]:
    """Return sentences on the least and most certain joints, and on the condition of their radii."""
    if motion.joint_radius_mm is None or not np.isfinite(motion.joint_radius_mm).any():
        return []
    radius = np.nanmean(motion.joint_radius_mm, 0)
    order = [joint for joint in np.argsort(-radius, kind="stable").tolist() if joint]
    least = ", ".join(_joint_text(joint, radius) for joint in order[:_LEAST_SURE])
    most = ", ".join(_joint_text(joint, radius) for joint in order[: -_MOST_SURE - 1 : -1])
    return [
        f"Least sure are {least}; most sure {most}: as likely as not each lies within that distance of its place about "
        "the pelvis. Most of it is depth.",
        *_condition(facts),
    ]


def _condition(facts: Mapping[str, Any], *within: str) -> list[str]:
    """Return the condition of the radii, as stated by the result; empty for older ones."""
    found = facts.get("confidence")
    for name in (*within, "holds_for"):
        found = found.get(name) if isinstance(found, Mapping) else None
    return [found] if isinstance(found, str) else []


def _joint_text(joint: int, radius: Array) -> str:
    return f"{JOINT_NAMES[joint].replace('_', ' ')} ({radius[joint]:.0f} mm)"


def _frames_said(facts: Mapping[str, Any]) -> list[str]:
    """Return a sentence on frames of a clip without a fit."""
    said = []
    gaps, filled = facts.get("gaps"), facts.get("filled")
    if isinstance(gaps, list) and gaps:
        listed = ", ".join(f"{first}\u2013{last}" if first != last else str(first) for first, last in gaps)
        said.append(f"Nobody is seen in frames {listed}: there is no motion there.")
    if isinstance(filled, list) and filled:
        said.append(f"In frames {_ranges(filled)} the pose comes from the neighbouring frames.")
    return said


def _ranges(numbers: Sequence[int]) -> str:
    """Format numbers as ranges, such as 1-3, 7."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(f"{first}\u2013{last}" if last > first else str(first) for first, last in runs)


def _told_height(facts: Mapping[str, Any]) -> float | None:
    """Return the person's height as the user gave it."""
    try:
        told = facts["config"]["fit"]["height_m"]
    except (KeyError, TypeError):  # an older result
        return None
    return float(told) if isinstance(told, int | float) else None


def _size_said(motion: SampledMotion, body: Body | None, told_m: float | None) -> str:
    """Return a sentence on size and distance, which a single image cannot separate."""
    far = float(np.median(motion.joints[:, 0, 2]))
    if told_m is not None:
        return (
            f"The person's height, {told_m:.2f} m, was given, and the distance, {far:.1f} m, follows from it. All "
            "lengths and speeds grow with that height."
        )
    tall = ""
    if body is not None and body.shape_count >= len(motion.betas):
        tall = f" {float(height_m(body, torch.from_numpy(motion.betas).to(body.template))):.2f} m tall and"
    return (
        f"One camera does not tell a tall person far away from a short one nearby. The person is taken to be{tall} "
        f"{far:.1f} m away; all lengths and speeds grow with that. Where the true height is known, give it with "
        "--fit.height-m."
    )
