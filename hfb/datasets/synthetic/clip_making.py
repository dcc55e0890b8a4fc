"""Make a synthetic clip: one person of the embedded body before one static camera, with its truth.

Frames are written one by one, so memory does not grow with the length. The same arguments give the same bytes.
"""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.datasets.motions.built_in.procedural import ProceduralMotions
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.resampling import resample
from hfb.datasets.synthetic.scenery import draw_scenery
from hfb.datasets.synthetic.shooting import NO_NOISE, Sensor
from hfb.datasets.synthetic.viewpoints import PlacedCamera, View, front_of, in_camera, place
from hfb.errors import TemporaryError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.footage_names import pictures_in
from hfb.io.media.images.image_io import write_png
from hfb.io.media.video.video_writing import VideoWriter
from hfb.io.safe_folder import check_ordinary, check_tree
from hfb.kernels.determinism import one_torch_thread
from hfb.motion.clock import subframe_times_s
from hfb.motion.motion_file import save_motion
from hfb.motion.sampled import SampledMotion
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.typing import Array, Float, Tensor

_EVERY = 13
"""Stride of the vertices, and of the instants, that are used to aim the camera."""
_AT_ONCE = 11
_MARGIN_S = 0.1
_NOISE = Sensor(0.003, 0.00005, 0.3)
_BESIDE_FRAMES = ("background.png", "clip.toml", "truth.npz")
_MADE = re.compile(r"# made by `hfb synth clip`: (\d{1,7}) frames(, clip\.mp4)?\n")
"""First line of a made clip.toml, which marks the files beside it as replaceable."""


@dataclass(frozen=True)
class MadeClip:
    """Files of one synthetic clip.

    Attributes:
        source: the folder of its images, or its video.
        background: the clean plate.
        clip: its clip.toml.
        truth: the true motion (a motion file, many instants per exposure); frames without the person are left out.
    """

    source: Path
    background: Path
    clip: Path
    truth: Path


def make_clip(
    folder: Path,
    frames: int = 24,
    height: int = 480,
    width: int = 640,
    seed: int = 0,
    fps: float = 30.0,
    shutter: float = 0.9,
    gesture: int | None = None,
    instants: int = 22,
    video: bool = False,
    leaves: tuple[int, int] | None = None,
    noise: bool = True,
    on_progress: Callable[[int, int], None] | None = None,
) -> MadeClip:
    """Make a clip in a folder.

    It gets ``frames/00000.png`` ... (or ``clip.mp4``), ``background.png``, ``clip.toml`` and ``truth.npz``.

    Args:
        folder: written to.
        frames: number of frames.
        height: height of the frames [px].
        width: width of the frames [px].
        seed: seed of person, scenery, motion and noise.
        fps: frames per second.
        shutter: share of the frame interval for which the shutter is open.
        gesture: number of the built-in motion; drawn by the seed where not given. A motion that is shorter than the
            clip swings back and forth without a stop.
        instants: per exposure; 7 k + 1 of them hold those of a fit with eight sub-frames.
        video: write ``clip.mp4`` in place of ``frames/``.
        leaves: (first, last) frame without the person.
        noise: add the sensor's noise.
        on_progress: called after every frame with (frames done, of how many).

    Raises:
        TemporaryError: files lie there that no earlier call of this has put there.
    """
    _make_room(folder)
    rng = np.random.default_rng(np.random.SeedSequence([seed, 3]))
    for_person, for_scenery, for_motion, for_sensor = rng.spawn(4)
    body = load_default_body()
    betas = np.clip(for_person.normal(0, 0.8, 10), -1.6, 1.6)
    with one_torch_thread():
        scenery = draw_scenery(None, None, body, max(height, width), for_scenery)
        plate = scenery.plate_linear[:height, :width].contiguous()
        motion = _motion(seed, gesture, frames, fps, shutter, instants, for_motion)
        seen = _film(motion, body, betas, height, width, for_motion)
        gone = set(range(leaves[0], leaves[1] + 1)) if leaves else set()
        sensor = _NOISE if noise else NO_NOISE
        # Written first, so that an incomplete clip is recognised as ours.
        write_bytes_atomic(folder / "clip.toml", _clip_toml(seen.lens, fps, shutter, frames, video).encode())
        write_png(folder / "background.png", sensor.expose(plate, for_sensor, sensor.plate_share))
        pictures = _expose(seen, body, scenery.texture_linear, plate, gone, sensor, for_sensor, on_progress)
        source = _store(folder, pictures, fps, video)
    save_motion(folder / "truth.npz", _without(seen.motion, gone), body.betas_space)
    return MadeClip(source, folder / "background.png", folder / "clip.toml", folder / "truth.npz")


def _make_room(folder: Path) -> None:
    """Take away what an earlier clip left: of a longer one frames would stay, of another kind all of them."""
    check_tree(folder, "frames")
    for name in (*_BESIDE_FRAMES, "clip.mp4"):
        check_ordinary(folder, name)
    ours, there = _made_before(folder), {name for name in (*_BESIDE_FRAMES, "clip.mp4") if (folder / name).exists()}
    there |= {f"frames/{path.name}" for path in pictures_in(folder / "frames")}
    if strange := sorted(there - ours):
        raise TemporaryError(
            f"{folder} holds {strange[0]}, which `hfb synth clip` did not put there: "
            "move it away, or choose another --out"
        )
    for name in there - {"clip.toml"}:  # which marks them as ours, until it is replaced
        (folder / name).unlink()


def _made_before(folder: Path) -> set[str]:
    """Return the files of an earlier clip, by its clip.toml."""
    try:
        with (folder / "clip.toml").open(encoding="utf-8", errors="replace") as file:
            made = _MADE.fullmatch(file.readline(80))
    except OSError:
        return set()
    if made is None:
        return set()
    frames = ["clip.mp4"] if made[2] else [_frame_name(number) for number in range(int(made[1]))]
    return {*_BESIDE_FRAMES, *frames}


def _frame_name(number: int) -> str:
    return f"frames/{number:05d}.png"


@dataclass(frozen=True, eq=False)
class _WorldMotion:
    """The motion at all instants in its world, and the exposures' clock."""

    poses: Float[Array, "R 24 3"]
    translations: Float[Array, "R 3"]
    frames: int
    instants: int
    exposure_s: float
    interval_s: float


@dataclass(frozen=True, eq=False)
class _Film:
    """The motion as the camera sees it."""

    motion: SampledMotion
    lens: PinholeCamera


def _motion(
    seed: int, gesture: int | None, frames: int, fps: float, shutter: float, instants: int, rng: np.random.Generator
) -> _WorldMotion:
    source = ProceduralMotions(seed)
    number = int(rng.integers(len(source.names()))) if gesture is None else gesture % len(source.names())
    clip = source.load(number)
    times_s, _ = subframe_times_s(frames, instants, shutter / fps, 1 / fps)
    poses, translations = resample(clip, _within(times_s, clip))
    return _WorldMotion(poses, translations, frames, instants, shutter / fps, 1 / fps)


def _within(times_s: Float[Array, "R"], clip: MotionClip) -> Float[Array, "R"]:
    """Return times in the recording: in order where it is long enough, else back and forth, never faster."""
    lasts_s = (len(clip.poses) - 1) / clip.fps - 2 * _MARGIN_S
    if times_s[-1] <= lasts_s:
        return times_s + _MARGIN_S
    return _MARGIN_S + lasts_s / 2 * (1 - np.cos(times_s / (lasts_s / 2)))


def _film(
    motion: _WorldMotion, body: Body, betas: Float[Array, "10"], height: int, width: int, rng: np.random.Generator
) -> _Film:
    """Aim a camera that shows the whole motion, and transform the motion to its coordinates."""
    shaped = body.shape(torch.from_numpy(betas).float())
    few = slice(None, None, _EVERY)
    rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses[few]).float())
    points = shaped.pose(rotations, torch.from_numpy(motion.translations[few]).float()).vertices[:, ::_EVERY]
    view = View(float(rng.uniform(-50, 50)), float(rng.uniform(0, 12)), 0.0, 45.0, 0.9, (0.0, 0.0))
    side = min(height, width)
    front = front_of(motion.poses[len(motion.poses) // 2, 0])
    camera: PlacedCamera = place(view, front, points.reshape(-1, 3).double().numpy(), side)
    lens = camera.lens.crop((side - width) // 2, (side - height) // 2, width, height)
    pelvis = body.rest_joints(torch.from_numpy(betas).float())[0].double().numpy()
    poses, translations = in_camera(camera, motion.poses, motion.translations, pelvis)
    joints = shaped.joints_of(
        axis_angle_to_matrix(torch.from_numpy(poses).float()), torch.from_numpy(translations).float()
    )
    times_s, frame_index = subframe_times_s(motion.frames, motion.instants, motion.exposure_s, motion.interval_s)
    sampled = SampledMotion(
        poses=poses.reshape(len(poses), 72),
        trans=translations,
        betas=betas,
        joints=joints.double().numpy(),
        times_s=times_s,
        frame_index=frame_index,
        K=lens.matrix().numpy(),
    )
    return _Film(sampled, lens)


def _expose(
    film: _Film,
    body: Body,
    texture: Float[Tensor, "A A 3"],
    plate: Float[Tensor, "H W 3"],
    gone: set[int],
    sensor: Sensor,
    rng: np.random.Generator,
    on_progress: Callable[[int, int], None] | None,
) -> Iterator[Float[Array, "H W 3"]]:
    """Yield the blurred frames as the camera stores them (sRGB)."""
    motion, rasterizer = film.motion, make_rasterizer("coverage", "cpu", 1)
    shaped = body.shape(torch.from_numpy(motion.betas).float())
    count = int(motion.frame_index[-1]) + 1
    for frame in range(count):
        total = torch.zeros(film.lens.height, film.lens.width, 4)
        rows = motion.rows_of(frame)
        if frame not in gone:
            for part in np.array_split(rows, math.ceil(len(rows) / _AT_ONCE)):
                rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses[part]).float().unflatten(1, (24, 3)))
                posed = shaped.pose(rotations, torch.from_numpy(motion.trans[part]).float())
                mean = rasterizer.render_mean(posed.vertices, texture, film.lens, body.mesh)
                total += mean * (len(part) / len(rows))
        yield sensor.expose(compose(total, plate), rng)
        if on_progress:
            on_progress(frame + 1, count)


def _store(folder: Path, pictures: Iterator[Float[Array, "H W 3"]], fps: float, video: bool) -> Path:
    if video:
        with VideoWriter(folder / "clip.mp4", fps) as writer:
            for picture in pictures:
                writer.write(picture)
        return folder / "clip.mp4"
    for number, picture in enumerate(pictures):
        write_png(folder / _frame_name(number), picture)
    return folder / "frames"


def _without(motion: SampledMotion, gone: set[int]) -> SampledMotion:
    keep = ~np.isin(motion.frame_index, sorted(gone))
    return SampledMotion(
        motion.poses[keep],
        motion.trans[keep],
        motion.betas,
        motion.joints[keep],
        motion.times_s[keep],
        motion.frame_index[keep],
        motion.K,
    )


def _clip_toml(lens: PinholeCamera, fps: float, shutter: float, frames: int, video: bool) -> str:
    made = f"# made by `hfb synth clip`: {frames} frames{', clip.mp4' if video else ''}\n"
    K = [[float(value) for value in row] for row in lens.matrix().tolist()]
    return f"{made}[camera]\nK = {K}\n\n[exposure]\nfps = {fps!r}\nshutter_fraction = {shutter!r}\n"
