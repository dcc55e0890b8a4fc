"""Measured 3D joints: .trc files (OpenSim's, Pose2Sim's) and joints3d.npz, and their SMPL names.

Marker-based skeletons, detectors and SMPL put their joints at slightly different places of the body: hips and shoulders
lie 2 to 5 cm from SMPL's (see truth_source.py).
The neck of a detector is the middle of the shoulders, SMPL's lies above it, so it is left out, as are nose, head, toes
and heels, for which SMPL has no joint at the same place.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.io.array_files import names_in, read_arrays
from hfb.typing import Array, Float, Int

_FILE_LIMIT = 64 << 20
_MAX_NUMBERS = 1 << 25  # a line that is cut off stands for as many gaps as there are markers
_UNITS_M = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
_LIMBS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
_SIDES = {"left": "left", "right": "right", "l": "left", "r": "right"}
_FAR_M = 1000.0
_TOLERANCE = 0.15  # of a frame: times of whole milliseconds at 240 Hz


@dataclass(frozen=True)
class Markers:
    """Named points over time, in the world of a calibration.

    Attributes:
        frames: number of each row's frame, increasing, on the clock of the recording (0 is its first frame).
        rate_hz: rows per second; None where the file leaves it to the video.
        names: as in the file.
        xyz_m: NaN where a point is unknown.
        views_known: whether the file tells in how many views a point was seen, as triangulations do.
    """

    frames: Int[Array, "F"]
    rate_hz: float | None
    names: tuple[str, ...]
    xyz_m: Float[Array, "F M 3"]
    views_known: bool = False

    def turned(self) -> "Markers":
        """Return the points with z up where y was up (y, z, x become z, x, y), as Pose2Sim's .trc files need it."""
        return replace(self, xyz_m=np.ascontiguousarray(self.xyz_m[..., [2, 0, 1]]))

    def rows(self, first: int, count: int) -> Float[Array, "n M 3"]:
        """Return the points of consecutive frames [m]; NaN for frames that the file does not have.

        Args:
            first: number of the first frame.
            count: number of frames.
        """
        found = np.full((count, len(self.names), 3), np.nan)
        at = np.searchsorted(self.frames, np.arange(first, first + count))
        known = at < len(self.frames)
        known[known] = self.frames[at[known]] == np.arange(first, first + count)[known]
        found[known] = self.xyz_m[at[known]]
        return found


def smpl_joint(name: str) -> int | None:
    """Return the SMPL joint that a marker shows, or None: RHip, right_hip, "Left Knee", "Anna:LHJC" and the like.

    Args:
        name: name of the marker.
    """
    word = "".join(letter for letter in name.rpartition(":")[2].lower() if letter.isalnum())
    for limb in _LIMBS:
        for part in (limb, f"{limb[0]}jc"):  # HJC is a hip's joint centre
            side = _SIDES.get(word.removesuffix(part)) or _SIDES.get(word.removeprefix(part))
            if side and part in word:
                return JOINT_NAMES.index(f"{side}_{limb}")
    return None


def body_columns(names: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Return the columns of the markers that show SMPL joints, and those joints, by joint; the first of doubles.

    Args:
        names: names of the markers.
    """
    joints: dict[int, int] = {}
    for column, name in enumerate(names):
        joint = smpl_joint(name)
        if joint is not None:
            joints.setdefault(joint, column)
    return [joints[joint] for joint in sorted(joints)], sorted(joints)


def read_joints_npz(path: Path) -> Markers:
    """Read joints3d.npz: frames (F,), names (M,), xyz (F,M,3) in metres in the calibration's world.

    Args:
        path: the file.

    Raises:
        InputError: missing, damaged, too large, or of other shapes.
    """
    fix = "give frames (F,), names (M,) and xyz (F, M, 3) in metres"
    try:
        found = read_arrays(path, ("frames", "names", "xyz"), _FILE_LIMIT)
        frames, names, xyz = (found[name] for name in ("frames", "names", "xyz"))
    except KeyError as error:
        raise InputError(f"{path}: has no {error.args[0]}; {fix}.") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: can't be read as joints ({error}); {fix}.") from None
    if frames.dtype.kind not in "iu" or names.dtype.kind not in "US" or xyz.dtype.kind != "f":
        raise InputError(f"{path}: holds other kinds of values; {fix}.")
    if names.ndim != 1 or xyz.shape != (frames.size, names.size, 3) or frames.shape != (frames.size,):
        raise InputError(f"{path}: has frames {frames.shape}, names {names.shape}, xyz {xyz.shape}; {fix}.")
    text = tuple(name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name) for name in names)
    triangulated = not {"n_views", "reproj_err_px"}.isdisjoint(names_in(path))
    return _checked(Markers(frames.astype(np.int64), None, text, xyz.astype(np.float64), triangulated), path)


def read_trc(path: Path) -> Markers:
    """Read OpenSim's .trc: tab-separated, a header of five lines, then frame number, time and x y z per marker.

    A gap is an empty cell. Rows are placed by their time: frame = time * rate, the DataRate or that of even times.

    Args:
        path: the file.

    Raises:
        InputError: missing, no .trc, or inconsistent; the text says in which line.
    """
    lines = _lines(path)
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path}: is no .trc file (its first line must start with PathFileType); export it again.")
    keys, values = lines[1].split(), lines[2].split()
    facts = dict(zip(keys, values, strict=False))
    rate, count = _positive(path, facts, "DataRate"), _positive(path, facts, "NumMarkers")
    unit = facts.get("Units", "").lower()
    if unit not in _UNITS_M:
        raise InputError(f"{path}: Units is {facts.get('Units')!r}; it must be m, cm or mm.")
    names = tuple(cell.strip() for cell in lines[3].split("\t")[2:] if cell.strip())
    if len(names) != count:
        raise InputError(f"{path}: NumMarkers says {count:g} and line 4 names {len(names)} markers; export it again.")
    if len(lines) * 3 * len(names) > _MAX_NUMBERS:
        raise InputError(f"{path}: {len(lines)} lines of {len(names)} markers are too many at once; cut it into parts.")
    times, points = [], []
    for number, line in enumerate(lines[5:], start=6):
        if line.strip():
            time_s, point = _row(path, number, line, len(names))
            times.append(time_s)
            points.append(point)
    if not times:
        raise InputError(f"{path}: has a header and no row of points; export it again.")
    at_s, steps = np.array(times), len(times) - 1
    if _beside(at_s * rate) > _TOLERANCE and steps and at_s[-1] > at_s[0]:
        rate = steps / (at_s[-1] - at_s[0])  # the times count, as for OpenSim: 59.94 where DataRate says 60
    if _beside(at_s * rate) > _TOLERANCE:
        stated = facts["DataRate"]
        raise InputError(
            f"{path}: its times do not lie on its DataRate of {stated} Hz, nor are they even; export it again."
        )
    frames = np.round(at_s * rate)
    return _checked(Markers(frames.astype(np.int64), rate, names, np.stack(points) * _UNITS_M[unit]), path)


def _beside(frames: Float[Array, "F"]) -> float:
    """Return the largest distance from a whole frame."""
    return float(np.abs(frames - np.round(frames)).max())


def _lines(path: Path) -> list[str]:
    try:
        if path.stat().st_size > _FILE_LIMIT:
            raise InputError(f"{path}: has over {_FILE_LIMIT >> 20} MiB, too many for a .trc file.")
        data = path.read_bytes()
        wide = data[:2] in (b"\xff\xfe", b"\xfe\xff")
        return data.decode("utf-16" if wide else "utf-8-sig", errors="replace").splitlines()  # paths in other codes
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror}); check the path.") from None


def _positive(path: Path, facts: dict[str, str], key: str) -> float:
    try:
        value = float(facts[key])
        if not 0 < value < 1e6:
            raise ValueError
    except (KeyError, ValueError):
        raise InputError(f"{path}: {key} in its header is {facts.get(key)!r}, not a positive number.") from None
    return value


def _row(path: Path, number: int, line: str, markers: int) -> tuple[float, Float[Array, "M 3"]]:
    cells = [cell.strip().replace(",", ".") for cell in line.split("\t")]  # some locales' decimals
    while len(cells) > 2 + 3 * markers and not cells[-1]:
        cells.pop()
    cells += [""] * (2 + 3 * markers - len(cells))  # editors cut off the tabs of gaps at a line's end
    if len(cells) != 2 + 3 * markers:
        raise InputError(f"{path}: line {number} has {len(cells)} columns, {2 + 3 * markers} belong to its markers.")
    try:
        time_s = float(cells[1])
        point = np.array([float(cell) if cell else math.nan for cell in cells[2:]]).reshape(markers, 3)
    except ValueError as error:
        raise InputError(f"{path}: line {number} holds something that is no number ({str(error)[:80]}).") from None
    if not math.isfinite(time_s) or not 0 <= time_s < 1e6:
        raise InputError(f"{path}: line {number} has the time {cells[1][:40]}; times are seconds from 0.")
    return time_s, point


def _checked(markers: Markers, path: Path) -> Markers:
    """Check markers: points complete or unknown (NaN, or 0 0 0 as many programs write it), frames in order, size."""
    if not len(markers.frames) or (np.diff(markers.frames) <= 0).any() or markers.frames[0] < 0:
        raise InputError(f"{path}: its frames must increase from 0 or more, one row each.")
    if len(set(markers.names)) != len(markers.names):
        raise InputError(f"{path}: two markers have one name; rename one.")
    known = np.isfinite(markers.xyz_m).all(-1, keepdims=True) & (markers.xyz_m != 0).any(-1, keepdims=True)
    xyz = np.where(known, markers.xyz_m, np.nan)
    if not np.isfinite(xyz).any():
        raise InputError(f"{path}: holds no known point; export it again.")
    if np.nanmax(np.abs(xyz)) > _FAR_M:
        raise InputError(f"{path}: a point is farther than {_FAR_M:g} m away; check its units.")
    return replace(markers, xyz_m=xyz)
