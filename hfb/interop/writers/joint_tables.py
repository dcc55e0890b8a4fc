"""Joints as tables: joints.csv for spreadsheets, joints.trc for OpenSim."""

from pathlib import Path

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.interop.writers.keys import even_keys, subframe_rate_hz
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float


def csv_text(motion: SampledMotion) -> str:
    """Return a table with one row per sub-frame, as in motion.npz: camera coordinates, exact times.

    Columns: ``frame``, ``sub_frame``, ``time_s``, per joint ``NAME_x_m``, ``NAME_y_m``, ``NAME_z_m``, and
    ``NAME_radius_mm`` where the motion has radii: the error is below it with a probability of one half; empty where
    unknown.

    Args:
        motion: camera coordinates.
    """
    head = ["frame", "sub_frame", "time_s", *(f"{name}_{axis}_m" for name in JOINT_NAMES for axis in "xyz")]
    radius = motion.joint_radius_mm
    if radius is not None:
        head += [f"{name}_radius_mm" for name in JOINT_NAMES]
    lines = [",".join(head)]
    number = -1
    for row, (frame, time_s, joints) in enumerate(
        zip(motion.frame_index, motion.times_s, motion.joints.reshape(-1, 72), strict=True)
    ):
        number = number + 1 if row and frame == motion.frame_index[row - 1] else 0
        cells = [str(int(frame)), str(number), f"{time_s:.9f}", *(f"{value:.6f}" for value in joints)]
        if radius is not None:
            cells += [f"{value:.2f}" if np.isfinite(value) else "" for value in radius[row]]
        lines.append(",".join(cells))
    return "\r\n".join(lines) + "\r\n"


def marker_table(motion: SampledMotion) -> tuple[float, Float[Array, "F"], Float[Array, "F 24 3"]]:
    """Return (rate [1/s], times [s], places [mm]) at the even rate of the sub-frames, y up; NaN while absent.

    Args:
        motion: camera coordinates.

    Raises:
        InputError: the motion's instants are not in order.
    """
    rate = subframe_rate_hz(motion)
    keys = even_keys(motion, rate)
    places = 1000 * keys.places * [1.0, -1.0, -1.0]
    places[~keys.present] = np.nan
    return rate, keys.times_s, places


def trc_text(motion: SampledMotion, name: str = "joints.trc") -> str:
    """Return OpenSim's table: millimetres, y up, the even rate of the sub-frames; NaN while the person was absent.

    OpenSim 4.6 reads NaN as a gap; it refuses rows that end in empty cells.

    Args:
        motion: camera coordinates.
        name: file name that the first line states.

    Raises:
        InputError: the motion's instants are not in order.
    """
    rate, times_s, places = marker_table(motion)
    count, shown = len(times_s), f"{rate:.6f}".rstrip("0").rstrip(".")
    facts = [shown, shown, str(count), str(len(JOINT_NAMES)), "mm", shown, "1", str(count)]
    keys = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units")
    original = ("OrigDataRate", "OrigDataStartFrame", "OrigNumFrames")
    axes = [f"{axis}{number}" for number in range(1, len(JOINT_NAMES) + 1) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "\t".join((*keys, *original)),
        "\t".join(facts),
        "\t".join(["Frame#", "Time", *(f"{joint}\t\t" for joint in JOINT_NAMES)]),
        "\t".join(["", "", *axes]),
        "",
    ]
    for number, (time_s, row) in enumerate(zip(times_s, places.reshape(count, -1), strict=True), 1):
        cells = (f"{value:.4f}" if np.isfinite(value) else "NaN" for value in row)
        lines.append("\t".join([str(number), f"{time_s:.9f}", *cells]))
    return "\n".join(lines) + "\n"


def write_csv(path: Path, motion: SampledMotion) -> None:
    """Write the file whole or not at all; see `csv_text`.

    Args:
        path: the file.
        motion: camera coordinates.
    """
    write_bytes_atomic(path, csv_text(motion).encode())


def write_trc(path: Path, motion: SampledMotion) -> None:
    """Write the file whole or not at all; see `trc_text`.

    Args:
        path: the file.
        motion: camera coordinates.
    """
    write_bytes_atomic(path, trc_text(motion).encode())
