"""The motion files of a run, by the names of the option."""

from collections.abc import Callable
from pathlib import Path

from hfb.config import MotionFormat
from hfb.interop.writers.amass import write_amass
from hfb.interop.writers.blender import write_by_blender
from hfb.interop.writers.bvh import write_bvh
from hfb.interop.writers.c3d_file import write_c3d
from hfb.interop.writers.export_names import FILE_NAMES
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.joint_tables import write_csv, write_trc
from hfb.interop.writers.skinned_glb import write_glb
from hfb.interop.writers.usd_file import write_usd


def write_motion_file(folder: Path, form: MotionFormat, exported: Exported) -> Path:
    """Write one format's file, whole or not at all.

    Args:
        folder: folder to write to.
        form: name of the format.
        exported: the motion with its body and texture.

    Raises:
        InputError: the motion's instants are not in order, or a library is missing.
        ValueError: the format has a surface and no body model is given.
    """
    path = folder / FILE_NAMES[form]
    _WRITERS[form](path, exported)
    return path


_WRITERS: dict[MotionFormat, Callable[[Path, Exported], None]] = {
    "amass": lambda path, exported: write_amass(path, exported.motion, exported.betas_space, exported.amass_rate),
    "glb": write_glb,
    "usd": write_usd,
    "fbx": write_by_blender,
    "abc": write_by_blender,
    "bvh": lambda path, exported: write_bvh(path, exported.motion),
    "csv": lambda path, exported: write_csv(path, exported.motion, exported.csv_frame),
    "trc": lambda path, exported: write_trc(path, exported.motion),
    "c3d": lambda path, exported: write_c3d(path, exported.motion),
}
