"""Joints as tables: joints.csv for spreadsheets, joints.trc for OpenSim."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.config import CsvFrame
from hfb.geometry.placement import Placement, in_world, trc_axes, z_up
from hfb.interop.writers.keys import even_keys, subframe_rate_hz
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.footing import FEET, foot_contacts, sole_heights_m
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float


def csv_text(motion: SampledMotion, frame: CsvFrame = "camera") -> str:
    """Return a table with one row per sub-frame, as in motion.npz: exact times.

    Columns: ``frame``, ``sub_frame``, ``time_s``, per joint ``NAME_x_m``, ``NAME_y_m``, ``NAME_z_m`` (of the world
    ``NAME_world_x_m`` ...), and ``NAME_radius_mm`` where the motion has radii: the error is below it with a probability
    of one half; empty where unknown. ``left_foot_stands`` and ``right_foot_stands`` are 1 where the foot is on the
    floor (`hfb.motion.footing`), else 0; where the world has a floor ``left_foot_sole_m`` and ``right_foot_sole_m`` are
    the soles' heights above it.

    Args:
        motion: camera coordinates.
        frame: coordinates of the table: the camera's, or the calibration's own world (z up without a calibration).
    """
    word, joints_m = "", motion.joints
    if frame == "world":
        world = motion.export_world
        word, placed = "world_", z_up(world) if world.source == "level" else in_world(world)
        joints_m = placed.points(joints_m)
    head = ["frame", "sub_frame", "time_s", *(f"{name}_{word}{axis}_m" for name in JOINT_NAMES for axis in "xyz")]
    radius = motion.joint_radius_mm
    if radius is not None:
        head += [f"{name}_radius_mm" for name in JOINT_NAMES]
    head += [f"{JOINT_NAMES[foot]}_stands" for foot in FEET]
    standing = foot_contacts(motion).astype(int)
    heights = sole_heights_m(motion) if motion.export_world.floor else None
    head += [f"{JOINT_NAMES[foot]}_sole_m" for foot in FEET if heights is not None]
    lines = [",".join(head)]
    number = -1
    for row, (index, time_s, joints) in enumerate(
        zip(motion.frame_index, motion.times_s, joints_m.reshape(-1, 72), strict=True)
    ):
        number = number + 1 if row and index == motion.frame_index[row - 1] else 0
        cells = [str(int(index)), str(number), f"{time_s:.9f}", *(f"{value:.6f}" for value in joints)]
        if radius is not None:
            cells += [f"{value:.2f}" if np.isfinite(value) else "" for value in radius[row]]
        cells += map(str, standing[row].tolist())
        cells += [f"{height:.4f}" for height in (() if heights is None else heights[row])]
        lines.append(",".join(cells))
    return "\r\n".join(lines) + "\r\n"


def marker_table(motion: SampledMotion, placed: Placement) -> tuple[float, Float[Array, "F"], Float[Array, "F 24 3"]]:
    """Return (rate [1/s], times [s], places [mm]) at the even rate of the sub-frames; NaN while absent.

    Args:
        motion: camera coordinates.
        placed: from the camera's frame to the table's.

    Raises:
        InputError: the motion's instants are not in order.
    """
    rate = subframe_rate_hz(motion)
    keys = even_keys(motion, rate)
    places = 1000 * placed.points(keys.places)
    places[~keys.present] = np.nan
    return rate, keys.times_s, places


def trc_text(motion: SampledMotion, name: str = "joints.trc", markers: Sequence[str] = JOINT_NAMES) -> str:
    """Return OpenSim's table: millimetres, y up, the even rate of the sub-frames; NaN while the person was absent.

    The world is the motion's; of a calibration with z up, axes are those of Pose2Sim's own .trc files (y, z, x).
    OpenSim 4.6 reads NaN as a gap; it refuses rows that end in empty cells.

    Args:
        motion: camera coordinates.
        name: file name that the first line states.
        markers: names of the joints.

    Raises:
        InputError: the motion's instants are not in order.
    """
    rate, times_s, places = marker_table(motion, trc_axes(motion.export_world))
    count, shown = len(times_s), f"{rate:.6f}".rstrip("0").rstrip(".")
    facts = [shown, shown, str(count), str(len(JOINT_NAMES)), "mm", shown, "1", str(count)]
    keys = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units")
    original = ("OrigDataRate", "OrigDataStartFrame", "OrigNumFrames")
    axes = [f"{axis}{number}" for number in range(1, len(JOINT_NAMES) + 1) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "\t".join((*keys, *original)),
        "\t".join(facts),
        "\t".join(["Frame#", "Time", *(f"{marker}\t\t" for marker in markers)]),
        "\t".join(["", "", *axes]),
        "",
    ]
    for number, (time_s, row) in enumerate(zip(times_s, places.reshape(count, -1), strict=True), 1):
        cells = (f"{value:.4f}" if np.isfinite(value) else "NaN" for value in row)
        lines.append("\t".join([str(number), f"{time_s:.9f}", *cells]))
    return "\n".join(lines) + "\n"


def write_csv(path: Path, motion: SampledMotion, frame: CsvFrame = "camera") -> None:
    """Write the file whole or not at all; see `csv_text`.

    Args:
        path: the file.
        motion: camera coordinates.
        frame: coordinates of the table.
    """
    write_bytes_atomic(path, csv_text(motion, frame).encode())


def write_trc(path: Path, motion: SampledMotion) -> None:
    """Write the file whole or not at all; see `trc_text`.

    Args:
        path: the file.
        motion: camera coordinates.
    """
    write_bytes_atomic(path, trc_text(motion).encode())
