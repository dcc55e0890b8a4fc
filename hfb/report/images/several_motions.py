"""Motions of several runs in one image: skeletons from the camera and from the side, and their distances over time.

Drawn from motions alone, so one image and a long clip work alike.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from hfb.body.skeleton import BONES
from hfb.evaluation.motion_difference import MotionDifference
from hfb.motion.sampled import SampledMotion
from hfb.report.images.strip import captioned, stacked
from hfb.report.plots.plot_style import FAINT_GRAY, GRAY
from hfb.typing import Array, Float, Int

RUN_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colours of the runs in order; the page's style calls them one, two, three, four."""

_SHOWN_INSTANTS = 3
_VIEWS = (("camera", 0), ("side", 2))
_SIZE_INCHES, _DPI = (9.0, 7.5), 110
_LONGEST_PX = 4000


def draw_motions(
    motions: Sequence[tuple[str, SampledMotion]], differences: Sequence[MotionDifference]
) -> Float[Array, "Y X 3"]:
    """Draw all skeletons at the first, middle and last shared instant, and joint distances over time; sRGB in [0, 1].

    Args:
        motions: name and motion of each run.
        differences: of every motion but the first from the first, each with at least one shared instant.

    Raises:
        ValueError: two motions share no frame.
    """
    if not all(len(difference.instants_s) for difference in differences):
        raise ValueError("there is nothing to draw: the motions share no frame")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=_SIZE_INCHES, dpi=_DPI, layout=ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05))
    canvas = FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, _SHOWN_INSTANTS, height_ratios=(3, 3, 1.6))
    first = motions[0][1]
    colours = [RUN_COLOURS[place % len(RUN_COLOURS)] for place in range(len(motions))]
    for column, row in enumerate(_shown_rows(first, differences[0])):
        place_s = float(first.times_s[row])
        for line, (view, axis) in enumerate(_VIEWS):
            axes = figure.add_subplot(grid[line, column])
            for (_, motion), colour in zip(motions, colours, strict=True):
                _skeleton(axes, motion.joints[_nearest(motion, place_s)], axis, colour)
            axes.set_title(f"{view}, {place_s:.3f} s", fontsize=9, color=GRAY)
            axes.set_aspect("equal")
            axes.set_axis_off()
    _distances(figure.add_subplot(grid[2, :]), differences, colours[1:])
    figure.legend(
        handles=_legend([name for name, _ in motions], colours),
        loc="outside upper center",
        ncols=min(3, len(motions)),
        frameon=False,
        fontsize=10,
    )
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(np.float32) / np.float32(255)


def stack_pictures(pictures: list[tuple[str, Float[Array, "_h _w 3"]]]) -> Float[Array, "Y X 3"]:
    """Stack captioned images vertically on white; sRGB in [0, 1].

    Args:
        pictures: (caption, image); longer ones than a screen can scroll are scaled down.
    """
    return stacked([captioned(_bounded(picture), caption) for caption, picture in pictures])


def png_bytes(picture: Float[Array, "Y X 3"]) -> bytes:
    """Encode an image as PNG.

    Args:
        picture: sRGB in [0, 1].
    """
    done, data = cv2.imencode(".png", np.round(picture[..., ::-1].clip(0, 1) * 255).astype(np.uint8))
    if not done:
        raise OSError("the picture could not be encoded")
    return data.tobytes()


def _shown_rows(one: SampledMotion, difference: MotionDifference) -> Int[Array, "_"]:
    places = np.unique(np.linspace(0, len(difference.instants_s) - 1, _SHOWN_INSTANTS).round().astype(np.int64))
    return np.array([_nearest(one, float(difference.instants_s[place])) for place in places])


def _nearest(motion: SampledMotion, time_s: float) -> int:
    return int(np.abs(motion.times_s - time_s).argmin())


def _skeleton(axes: Any, joints: Float[Array, "24 3"], axis: int, colour: str) -> None:
    """Draw bones about the pelvis, seen along the camera's axis or from the side; y points down."""
    across = joints[:, axis] - joints[0, axis] if axis else joints[:, axis]
    for parent, child in BONES:
        axes.plot(across[[parent, child]], -joints[[parent, child], 1], color=colour, linewidth=1.8, alpha=0.8)


def _distances(axes: Any, differences: Sequence[MotionDifference], colours: Sequence[str]) -> None:
    """Plot the mean (and, of two motions, largest) distance of the joints from the first motion's, against time."""
    for difference, colour in zip(differences, colours, strict=True):
        spread = difference.joints_mm
        drawn = colour if len(differences) > 1 else "black"
        axes.plot(difference.instants_s, spread.mean(1), color=drawn, linewidth=1.6, label="mean")
    if len(differences) == 1:
        largest = differences[0].joints_mm.max(1)
        axes.plot(differences[0].instants_s, largest, color=GRAY, linewidth=1.0, linestyle="--", label="largest")
        axes.legend(frameon=False, fontsize=8)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("time [s]", fontsize=9)
    axes.set_ylabel("joint distance [mm]" if len(differences) == 1 else "distance from the first [mm]", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(axis="y", color=FAINT_GRAY, linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(names: Sequence[str], colours: Sequence[str]) -> list[Any]:
    from matplotlib.lines import Line2D

    pairs = zip(names, colours, strict=True)
    return [Line2D([], [], color=colour, linewidth=2, label=name.replace("$", r"\$")) for name, colour in pairs]


def _bounded(picture: Float[Array, "H W 3"]) -> Float[Array, "h w 3"]:
    scale = _LONGEST_PX / max(picture.shape[:2])
    if scale >= 1:
        return picture
    size = (max(round(picture.shape[1] * scale), 1), max(round(picture.shape[0] * scale), 1))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
