"""The tasks that look at a clip's motion: how well it explains every frame, the truth where it is known, a picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hfb.config import FitConfig
from hfb.errors import InputError
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.core.task import task
from hfb.tasks.core.video_handles import FrameScoresHandle
from hfb.tasks.workers.workers import compute, spread

if TYPE_CHECKING:
    from hfb.motion.sampled import SampledMotion

_LEAST_KNOWN = 0.5


@task("scores")
def score_frames(
    clip: ClipHandle,
    numbers: tuple[int, ...],
    mattes: tuple[FileHandle, ...],
    motion: FileHandle,
    person: FileHandle,
    body: FileHandle | None,
    config: FitConfig,
) -> FrameScoresHandle:
    """IoU with the matte and PSNR of the re-blurred picture, frame by frame; always with the exact silhouette.

    Args:
        clip, mattes: of the frames ``numbers`` alone.
    """
    return spread(_score_frames, clip, numbers, mattes, motion, person, body, config)


@task("errors")
def judge_clip(motion: FileHandle, truth: FileHandle) -> FrameScoresHandle:
    """MPJPE against the true joints, frame by frame, after one rotation of the whole clip.

    Raises:
        InputError: the truth is of another clip.
    """
    return compute(_judge_clip, motion, truth)


@task("strip")
def draw_clip(
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
    """Some of the clip's frames: what was seen, and how it is explained."""
    return compute(_draw_clip, clip, numbers, mattes, motion, person, body, config, note, folder)


@task("texture")
def draw_texture(light: Literal["srgb", "linear"], person: FileHandle, folder: Path) -> FileHandle:
    """The person's texture as a picture to look at."""
    return compute(_draw_texture, light, person, folder)


def only_frames(motion: SampledMotion, numbers: tuple[int, ...]) -> SampledMotion:
    """Some frames of a motion, numbered from 0 in the order given."""
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


def _score_frames(
    clip: ClipHandle,
    numbers: tuple[int, ...],
    mattes: tuple[FileHandle, ...],
    motion: FileHandle,
    person: FileHandle,
    body: FileHandle | None,
    config: FitConfig,
) -> FrameScoresHandle:
    from hfb.evaluation.protocol import picture_scores, reblur
    from hfb.fitting.identity import load_identity
    from hfb.motion.motion_file import load_motion
    from hfb.rendering.backends import make_rasterizer
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    whole, _ = load_motion(motion.path)
    texture, model = load_identity(person.path).texture, load_chosen_body(body)
    rasterizer = make_rasterizer("coverage", config.rasterizer, config.threads)
    scores: dict[str, list[float]] = {}
    for index, number in enumerate(numbers):
        seen = load_observation(clip.model_copy(update={"frames": (clip.frames[index],)}), (mattes[index],))
        blurred = reblur(only_frames(whole, (number,)), texture, seen, model, rasterizer)
        for name, value in picture_scores(blurred, seen).items():
            scores.setdefault(name, []).append(value)
    return FrameScoresHandle(frames=numbers, scores={name: tuple(values) for name, values in scores.items()})


def _judge_clip(motion: FileHandle, truth: FileHandle) -> FrameScoresHandle:
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


def _draw_clip(
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
    from hfb.fitting.identity import load_identity
    from hfb.io.media.pictures import write_png
    from hfb.motion.motion_file import load_motion
    from hfb.rendering.backends import make_rasterizer
    from hfb.report.strip import draw_strip
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    picture = draw_strip(
        load_observation(clip, mattes),
        only_frames(load_motion(motion.path)[0], numbers),
        load_identity(person.path).texture,
        load_chosen_body(body),
        make_rasterizer("coverage", config.rasterizer, config.threads),
        note,
    )
    write_png(folder / "strip.png", picture)
    return FileHandle.of(folder / "strip.png")


def _draw_texture(light: str, person: FileHandle, folder: Path) -> FileHandle:
    from hfb.fitting.identity import load_identity
    from hfb.io.media.pictures import write_png
    from hfb.photometry import linear_to_srgb

    texture = load_identity(person.path).texture
    stored = linear_to_srgb(texture.clamp(0, 1)) if light == "linear" else texture.clamp(0, 1)
    write_png(folder / "texture.png", stored.numpy())
    return FileHandle.of(folder / "texture.png")
