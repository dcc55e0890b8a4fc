"""The motion files of a run, by the names of the option."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hfb.body.model import BetasSpace, Body
from hfb.config import AmassRate, CsvFrame, ExportConfig, MotionFormat
from hfb.interop.writers.amass import write_amass
from hfb.interop.writers.blender import write_by_blender
from hfb.interop.writers.bvh import write_bvh
from hfb.interop.writers.c3d_file import write_c3d
from hfb.interop.writers.export_names import FILE_NAMES
from hfb.interop.writers.joint_tables import write_csv, write_trc
from hfb.interop.writers.skinned_glb import write_glb
from hfb.interop.writers.usd_file import write_usd
from hfb.motion.sampled import SampledMotion


@dataclass(frozen=True)
class Exported:
    """A person's motion and the data that exports need.

    Attributes:
        betas_space: space of the motion's shape coefficients.
        body: the model it was fitted with; None is enough for formats without a surface.
        texture_png: the person's texture as an sRGB image.
        fps: frames per second of the program that opens files with a camera.
        plate: name of the background's file beside it.
    """

    motion: SampledMotion
    betas_space: BetasSpace
    body: Body | None = None
    texture_png: bytes | None = None
    amass_rate: AmassRate = 120
    csv_frame: CsvFrame = "camera"
    fps: float = ExportConfig().fps
    plate: str | None = None


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


def _write_surface(write: Callable[..., None], path: Path, exported: Exported) -> None:
    if exported.body is None:
        raise ValueError(f"{path.name} has a surface: it needs the body model")
    write(path, exported.motion, exported.body, exported.texture_png, exported.fps, exported.plate)


_WRITERS: dict[MotionFormat, Callable[[Path, Exported], None]] = {
    "amass": lambda path, exported: write_amass(path, exported.motion, exported.betas_space, exported.amass_rate),
    "glb": partial(_write_surface, write_glb),
    "usd": partial(_write_surface, write_usd),
    "fbx": partial(_write_surface, write_by_blender),
    "abc": partial(_write_surface, write_by_blender),
    "bvh": lambda path, exported: write_bvh(path, exported.motion),
    "csv": lambda path, exported: write_csv(path, exported.motion, exported.csv_frame),
    "trc": lambda path, exported: write_trc(path, exported.motion),
    "c3d": lambda path, exported: write_c3d(path, exported.motion),
}
