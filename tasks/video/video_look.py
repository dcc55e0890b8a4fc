"""The tasks that evaluate and draw a clip's motion: scores per frame, errors against a truth, strip and texture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hfb.config import FitConfig
from hfb.errors import InputError
from hfb.tasks.core.handles import Call, ClipHandle, FileHandle
from hfb.tasks.core.video_handles import FrameScoresHandle
from hfb.tasks.task import task

if TYPE_CHECKING:
    from hfb.motion.sampled import SampledMotion

_LEAST_KNOWN = 0.5


class ScoreCall(Call):
    """Some frames of a clip's motion.

    Attributes:
        clip: these frames alone.
        numbers: of the frames in the clip.
        mattes: of these frames.
        motion: of the whole clip.
        person: shape and texture of the person.
        body: the user's body model; None for the embedded one.
        config: options of the fit.
    """

    clip: ClipHandle
    numbers: tuple[int, ...]
    mattes: tuple[FileHandle, ...]
    motion: FileHandle
    person: FileHandle
    body: FileHandle | None
    config: FitConfig


@task("scores", where="cluster")
def score_frames(call: ScoreCall) -> FrameScoresHandle:
    """Score frame by frame: IoU with the matte and PSNR of the re-blurred image, always with the exact silhouette.

    Args:
        call: the frames.
    """
    from hfb.evaluation.protocol import picture_scores, reblur
    from hfb.fitting.identity import load_identity
    from hfb.motion.motion_file import load_motion
    from hfb.rendering.backends import make_rasterizer
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    whole, _ = load_motion(call.motion.path)
    texture, model = load_identity(call.person.path).texture, load_chosen_body(call.body)
    rasterizer = make_rasterizer("coverage", call.config.rasterizer, call.config.threads)
    scores: dict[str, list[float]] = {}
    for index, number in enumerate(call.numbers):
        seen = load_observation(call.clip.only(index), (call.mattes[index],))
        blurred = reblur(only_frames(whole, (number,)), texture, seen, model, rasterizer)
        for name, value in picture_scores(blurred, seen).items():
            scores.setdefault(name, []).append(value)
    return FrameScoresHandle(frames=call.numbers, scores={name: tuple(values) for name, values in scores.items()})


@task("errors", where="worker")
def judge_clip(motion: FileHandle, truth: FileHandle) -> FrameScoresHandle:
    """Compute MPJPE against the true joints, frame by frame, after one rotation of the whole clip.

    Args:
        motion: of the clip.
        truth: the true motion.

    Raises:
        InputError: the truth is of another clip.
    """
    import numpy as np

    from hfb.evaluation.metrics import errors_mm
    from hfb.motion.motion_file import load_motion

    found, _ = load_motion(motion.path)
    true, _ = load_motion(truth.path)
    after = np.searchsorted(true.times_s, found.times_s).clip(1, len(true.times_s) - 1)
    closer = np.abs(true.times_s[after - 1] - found.times_s) <= np.abs(true.times_s[after] - found.times_s)
    nearest = np.where(closer, after - 1, after)
    known = true.frame_index[nearest] == found.frame_index  # nobody is there in a frame that was bridged
    if known.mean() < _LEAST_KNOWN:
        raise InputError(f"{truth.path} is not this clip's truth: its instants lie in other frames")
    errors = np.full(len(known), np.nan)
    errors[known] = errors_mm(found.joints[known], true.joints[nearest[known]]).mean(1)
    numbers = tuple(int(number) for number in np.unique(found.frame_index[known]))
    each = tuple(float(np.nanmean(errors[found.rows_of(number)])) for number in numbers)
    return FrameScoresHandle(frames=numbers, scores={"mpjpe_mm": each})


@task("strip", where="worker")
def draw_clip(
    *,
    clip: ClipHandle,
    numbers: tuple[int, ...],
    mattes: tuple[FileHandle, ...],
    motion: FileHandle,
    person: FileHandle,
    body: FileHandle | None,
    config: FitConfig,
    note: str,
    folder: Path,
) -> FileHandle:
    """Draw some of the clip's frames: the input, and how the motion explains it.

    Args:
        clip: these frames alone.
        numbers: of the frames in the clip.
        mattes: of these frames.
        motion: of the whole clip.
        person: shape and texture of the person.
        body: the user's body model; None for the embedded one.
        config: options of the fit.
        note: a line below the strip.
        folder: where it goes.
    """
    from hfb.fitting.identity import load_identity
    from hfb.io.media.images.image_io import write_png
    from hfb.motion.motion_file import load_motion
    from hfb.rendering.backends import make_rasterizer
    from hfb.report.images.strip import draw_strip
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    image = draw_strip(
        load_observation(clip, mattes),
        only_frames(load_motion(motion.path)[0], numbers),
        load_identity(person.path).texture,
        load_chosen_body(body),
        make_rasterizer("coverage", config.rasterizer, config.threads),
        note,
    )
    write_png(folder / "strip.png", image)
    return FileHandle.of(folder / "strip.png")


@task("texture", where="worker")
def draw_texture(light: Literal["srgb", "linear"], person: FileHandle, folder: Path) -> FileHandle:
    """Write the person's texture as an image.

    Args:
        light: the texture's.
        person: shape and texture of the person.
        folder: where it goes.
    """
    from hfb.fitting.identity import load_identity
    from hfb.io.media.images.image_io import write_png
    from hfb.photometry import linear_to_srgb

    texture = load_identity(person.path).texture
    stored = linear_to_srgb(texture.clamp(0, 1)) if light == "linear" else texture.clamp(0, 1)
    write_png(folder / "texture.png", stored.numpy())
    return FileHandle.of(folder / "texture.png")


def only_frames(motion: SampledMotion, numbers: tuple[int, ...]) -> SampledMotion:
    """Return some frames of a motion, numbered from 0 in the order given.

    Args:
        motion: of the whole clip.
        numbers: of the frames.
    """
    import numpy as np

    rows = [motion.rows_of(number) for number in numbers]
    chosen = np.concatenate(rows)
    radius = motion.joint_radius_mm
    return replace(
        motion,
        poses=motion.poses[chosen],
        trans=motion.trans[chosen],
        joints=motion.joints[chosen],
        times_s=motion.times_s[chosen],
        frame_index=np.repeat(np.arange(len(rows)), [len(one) for one in rows]),
        joint_radius_mm=None if radius is None else radius[chosen],
    )
