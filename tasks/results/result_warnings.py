"""Look for signs that a result is wrong, and print them."""

from __future__ import annotations

from collections.abc import Sequence

from hfb.config import FitConfig, Record
from hfb.evaluation.warnings import Look, ResultWarning, find_warnings
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.task import task
from hfb.tasks.telemetry import progress

_MOST_LOOKS, _LOOK_PX = 15, 480


class WarningsHandle(Record):
    """Warnings of a result; see `hfb.evaluation.warnings`."""

    warnings: tuple[ResultWarning, ...]


@task("warnings", where="worker")
def look_for_warnings(
    *,
    clip: ClipHandle,
    numbers: tuple[int, ...],
    mattes: tuple[FileHandle, ...],
    motion: FileHandle,
    matte_iou: tuple[tuple[int, float], ...],
    body: FileHandle | None,
    config: FitConfig,
) -> WarningsHandle:
    """Compare a few frames with their plate and with the fitted body.

    Args:
        clip: these frames alone; at most `_MOST_LOOKS` of them are examined.
        numbers: of these frames.
        mattes: of these frames.
        motion: of the whole clip.
        matte_iou: (frame, value) where it is known; empty: it is computed for the examined frames.
        body: the user's body model; None for the embedded one.
        config: options of the fit.
    """
    import numpy as np
    import torch

    from hfb.evaluation.metrics import soft_iou
    from hfb.evaluation.protocol import pose_rows
    from hfb.matting.matting_protocol import shrink
    from hfb.motion.motion_file import load_motion
    from hfb.photometry import linear_to_srgb
    from hfb.rendering.backends import make_rasterizer
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    found, _ = load_motion(motion.path)
    model, rasterizer = load_chosen_body(body), make_rasterizer("coverage", config.rasterizer, config.threads)
    looks, plate, iou = [], np.zeros((0, 0, 3), np.float32), dict(matte_iou)
    for index, number in enumerate(numbers):
        seen = load_observation(clip.only(index), (mattes[index],))
        stored = [one.numpy() for one in (seen.frames_linear[0], seen.plate_linear)]
        frame, plate = (linear_to_srgb(one.clip(0, 1)) if clip.light == "linear" else one for one in stored)
        rows = found.rows_of(number)
        matte, alpha = seen.mattes[0].numpy(), None
        if len(rows):
            with torch.no_grad():
                vertices = pose_rows(found, rows, model).vertices
                alpha = rasterizer.silhouette_mean(vertices, seen.camera, model.mesh).numpy()
            iou.setdefault(number, soft_iou(alpha, matte))
        small = None if alpha is None else shrink(alpha, _LOOK_PX)
        looks.append(Look(number, shrink(frame, _LOOK_PX), shrink(matte, _LOOK_PX), small))
    return WarningsHandle(warnings=find_warnings(looks, shrink(plate, _LOOK_PX), found, iou))


def looks_over(numbers: Sequence[int]) -> tuple[int, ...]:
    """Select a few of many frames, evenly spaced.

    Args:
        numbers: of the frames.
    """
    step = max(1.0, (len(numbers) - 1) / (_MOST_LOOKS - 1))
    return tuple(numbers[round(at * step)] for at in range(min(len(numbers), _MOST_LOOKS)))


def tell(warnings: Sequence[ResultWarning]) -> None:
    """Print warnings on the terminal.

    Args:
        warnings: of the result.
    """
    for one in warnings:
        progress.say(f"hfb: warning: {one.message}")


def input_warnings(remarks: Sequence[str], of_plate: Sequence[str]) -> tuple[ResultWarning, ...]:
    """Return remarks from before the fit as warnings of the result: `plate` or, on files and camera, `input`.

    Args:
        remarks: one sentence each.
        of_plate: those of them that are about the plate.
    """
    codes = ("plate" if remark in of_plate else "input" for remark in remarks)
    return tuple(
        ResultWarning(code=code, value=1.0, frames=(), message=remark)
        for code, remark in zip(codes, remarks, strict=True)
    )
