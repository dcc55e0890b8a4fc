"""The image strip: input | matte | sub-frames | re-blurred | residual | novel view."""

from pathlib import Path

from hfb.config import FitConfig
from hfb.fitting.alternatives import what_is_unknown
from hfb.io.media.images.image_io import write_png
from hfb.motion.motion_file import load_motion
from hfb.rendering.backends import make_rasterizer
from hfb.report.images.strip import draw_strip
from hfb.tasks.core.handles import ClipHandle, FileHandle, FitHandle
from hfb.tasks.core.scene import load_chosen_body, load_observation, load_texture
from hfb.tasks.task import task


@task("strip")
def strip(*, clip: ClipHandle, fit: FitHandle, body: FileHandle | None, config: FitConfig, folder: Path) -> FileHandle:
    """Draw the input and how the fit explains it.

    Args:
        clip: all frames.
        fit: the motion, its texture and the mattes it used last.
        body: the user's body model; None for the embedded one.
        config: options of the fit.
        folder: where the strip goes.
    """
    motion, _ = load_motion(fit.motion.path)
    picture = draw_strip(
        load_observation(clip, fit.mattes),
        motion,
        load_texture(fit.texture),
        load_chosen_body(body),
        make_rasterizer("coverage", config.rasterizer, config.threads),
        what_is_unknown(fit.directions) if fit.directions else "",
    )
    path = folder / "strip.png"
    write_png(path, picture)
    return FileHandle.of(path)
