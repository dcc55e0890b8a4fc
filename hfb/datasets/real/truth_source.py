"""Kinds of measured joints in real recordings, and their offsets from SMPL's."""

from typing import Literal

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.real.markers import Markers, body_columns
from hfb.typing import Array, Float

TruthKind = Literal["markers", "multi-view", "measured"]

_RIGID, _BENDS_DEG = 0.005, 3.0
"""Relative deviation of a bone's length over time below which a skeleton was fitted (triangulated detections have 0.02
and more), and deviation of an angle above which the person moves."""
_BONES = tuple(
    (f"{side}_{a}", f"{side}_{b}", f"{side}_{c}")
    for side in ("left", "right")
    for a, b, c in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist"))
)

TRUTH_SOURCES: dict[str, str] = {
    "markers": "joint centres of a skeleton with rigid bones, as marker-based motion capture gives",
    "multi-view": "a detector's keypoints, triangulated from several cameras",
    "measured": "measured 3D joints of unknown origin",
}
"""`truth_source` of case.json."""

OFFSET_MM: dict[str, tuple[int, int]] = {"hip": (20, 50), "shoulder": (20, 50)}
"""Smallest and largest distance of an anatomical joint centre, or a detector's keypoint, from SMPL's joint of that
name: SMPL's are regressed from a surface. For knees, ankles, elbows and wrists no offset beyond the truth's error is
known."""


def truth_kind(markers: Markers, cameras: int) -> TruthKind:
    """Return how the joints were measured, as far as the file tells.

    Args:
        markers: measured points.
        cameras: number of cameras in the calibration: one alone triangulates nothing.
    """
    if markers.views_known:
        return "multi-view"
    if _is_rigid(markers):
        return "markers"
    return "multi-view" if cameras > 1 or markers.rate_hz is not None else "measured"


def truth_offsets_mm(joints: tuple[int, ...]) -> dict[str, tuple[int, int]]:
    """Return `OFFSET_MM` of some SMPL joints, by their names.

    Args:
        joints: numbers of SMPL joints.
    """
    return {
        JOINT_NAMES[joint]: OFFSET_MM[part]
        for joint in joints
        if (part := JOINT_NAMES[joint].split("_")[-1]) in OFFSET_MM
    }


def _is_rigid(markers: Markers) -> bool:
    """Return whether bones keep their lengths while joints bend, as only a fitted skeleton's do."""
    columns, joints = body_columns(markers.names)
    known = {JOINT_NAMES[joint]: markers.xyz_m[:, column] for column, joint in zip(columns, joints, strict=True)}
    deviations, bends = [], []
    for names in _BONES:
        if not all(name in known for name in names):
            continue
        upper, lower = known[names[1]] - known[names[0]], known[names[2]] - known[names[1]]
        both = np.isfinite(upper).all(1) & np.isfinite(lower).all(1)
        if both.sum() < 2:
            continue
        lengths = [np.linalg.norm(bone[both], axis=1) for bone in (upper, lower)]
        deviations += [float(length.std() / max(length.mean(), 1e-9)) for length in lengths]
        bends.append(_bend_deg(upper[both], lower[both]))
    return bool(deviations) and float(np.median(deviations)) < _RIGID and max(bends) > _BENDS_DEG


def _bend_deg(upper: Float[Array, "n 3"], lower: Float[Array, "n 3"]) -> float:
    """Return the variation of an angle over time."""
    cosine = (upper * lower).sum(1) / np.maximum(np.linalg.norm(upper, axis=1) * np.linalg.norm(lower, axis=1), 1e-9)
    return float(np.degrees(np.arccos(cosine.clip(-1, 1))).std())
