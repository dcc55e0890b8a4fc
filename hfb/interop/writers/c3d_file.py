"""joints.c3d, a table of joints for biomechanics programs; needs the extra `c3d`."""

import io
import warnings
from pathlib import Path

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.geometry.placement import z_up
from hfb.interop.writers.export_names import check_formats
from hfb.interop.writers.joint_tables import marker_table
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool

_LOST = -1.0  # the residual of a point that was not seen, by the format's definition
_MOST_FRAMES = 65_000  # the format counts them in 16 bits


def c3d_bytes(motion: SampledMotion) -> bytes:
    """Return the file's bytes: millimetres, the motion's world with z up, the even rate of the sub-frames.

    Points are marked lost while the person was absent (coordinates zero, residual -1).

    Args:
        motion: camera coordinates.

    Raises:
        InputError: the library is missing, or the motion is too long for the format.
    """
    check_formats(["c3d"])
    import c3d

    rate, _, places = marker_table(motion, z_up(motion.export_world))
    if len(places) > _MOST_FRAMES:
        raise InputError(f"{len(places)} rows do not fit into a C3D file, which counts up to 65 535: export a .trc")
    writer = c3d.Writer(point_rate=rate, point_units="mm")
    writer.set_point_labels(JOINT_NAMES)
    writer.set_screen_axis("+X", "+Z")
    known = np.isfinite(places[..., :1])
    residual = np.where(known, 0.0, _LOST)
    points = np.concatenate([np.where(known, places, 0.0), residual, np.zeros_like(residual)], -1).astype(np.float32)
    writer.add_frames([(frame, np.zeros((0, 0), np.float32)) for frame in points])
    writer.set_start_frame(1)
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that there is no analog data: there is none
        writer.write(file)
    return _zero_lost_points(file.getvalue(), known[..., 0])


def _zero_lost_points(data: bytes, known: Bool[Array, "F 24"]) -> bytes:
    """Set the coordinates of lost points to zero, as the format asks for.

    The writer of c3d 0.6 keeps the last valid coordinates there, which readers without the residual would use.
    """
    content = bytearray(data)
    first_block = int.from_bytes(content[16:18], "little")  # word 9 of the header: where the frames begin, from 1
    points = np.frombuffer(content, "<f4", 4 * known.size, 512 * (first_block - 1)).reshape(*known.shape, 4)
    points[~known, :3] = 0.0
    return bytes(content)


def write_c3d(path: Path, motion: SampledMotion) -> None:
    """Write the file whole or not at all; see `c3d_bytes`.

    Args:
        path: the file.
        motion: camera coordinates.
    """
    write_bytes_atomic(path, c3d_bytes(motion))
