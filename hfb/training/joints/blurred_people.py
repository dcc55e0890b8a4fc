"""Blurred people with known joints: mocap seen by a random camera, matted as by hfb, with erroneous starts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

from hfb.body.height import height_m
from hfb.body.mesh import Mesh
from hfb.datasets.network_errors import draw_turns
from hfb.datasets.synthetic.backgrounds import room_background
from hfb.datasets.synthetic.clothed import draw_clothing, dress
from hfb.datasets.synthetic.scenery import draw_scenery
from hfb.datasets.synthetic.viewpoints import front_of, in_camera, place
from hfb.evidence.joint_network import Window, picture_channels
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.matting.matte_network import features
from hfb.matting.matting_protocol import clean, matte_region
from hfb.matting.network import shipped_network
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.training.joints.people import INSTANTS, SECONDS, STARTS, People, draw_amplitude, draw_moments

Found = TypeVar("Found")

_CLOTHED = 0.25
_SCENES = 240
_MATTE_ERRORS = (0.35, 0.95)
_AROUND = 0.4
"""Margin on every side of the person's box: more than any window shows."""
LEAST_PX = 60
"""Smallest matte that counts as a visible person [px]."""


@dataclass(frozen=True)
class Sample:
    """One training image around one person.

    Attributes:
        picture: (*views, C, H, W) uint8, see `picture_channels`; as observed, and of a fit (`joint_fits`) as rendered.
        truth: (*views, 3, 24, 3) joints at u = 0, 1/2 and 1 in the window's units.
        starts: (_, 24, 3) erroneous estimates of them.
        unit_m: length of the window's unit at the person's distance.
        height_m: (*views,) height of the person.
    """

    picture: np.ndarray
    truth: np.ndarray
    starts: np.ndarray
    unit_m: float
    height_m: float | np.ndarray


@dataclass(frozen=True)
class Shot:
    """A moving person in front of a camera and a plate.

    Attributes:
        mesh: of the clothed body.
        vertices: (S, V, 3) of the clothed body, camera coordinates [m].
        poses: (S, 24, 3) axis-angle [rad].
        joints: (S, 24, 3) of the bare body [m].
        plate: linear light.
        texture: linear light.
    """

    betas: torch.Tensor
    mesh: Mesh
    vertices: torch.Tensor
    poses: np.ndarray
    joints: torch.Tensor
    lens: PinholeCamera
    plate: torch.Tensor
    texture: torch.Tensor


@dataclass(frozen=True)
class Seen:
    """The region around a person: image in linear light (h, w, 3), its plate, and its matte (h, w).

    Attributes:
        inner: rows and columns in the whole image.
        window: in the whole image, inside ``inner`` except at the edges.
    """

    inner: tuple[slice, slice]
    frame: np.ndarray
    plate: np.ndarray
    matte: np.ndarray
    window: Window

    def channels(self) -> np.ndarray:
        """The network's input."""
        window, (rows, columns) = self.window, self.inner
        window = replace(window, left=window.left - columns.start, top=window.top - rows.start)
        return picture_channels(self.frame, self.plate, self.matte, window)


class Studio(People):
    """Motions, scenes and the body; everything drawn from them is a function of the sample's number."""

    def __init__(self, mocap: Path, backgrounds: Path, clips: list[str], seed: int, frame_px: int) -> None:
        """Read the named clips and make the scenes.

        Args:
            mocap: folder of clips, BVH files.
            backgrounds: folder of photographs.
            clips: names of clips.
            seed: of the scenes.
            frame_px: side of the images [px].
        """
        super().__init__(mocap, clips, seed, frame_px)
        self.rasterizer = make_rasterizer("coverage", "cpu", 1)
        self.scenes = []
        for number in range(_SCENES):
            rng = np.random.default_rng([seed, 77, number])
            photos = backgrounds / ("polyhaven" if number % 4 else "budgie")
            textures = backgrounds / "textures" if number % 3 == 0 else None
            scene = draw_scenery(photos if number % 5 else None, textures, self.body, self.frame_px, rng)
            self.scenes.append((scene.plate_linear, scene.texture_linear))

    def draw(self, rng: np.random.Generator) -> Sample:
        """Draw a sample; draws without a visible person are repeated.

        Args:
            rng: of the sample.
        """
        return until_found(lambda: self._try(rng))

    def _try(self, rng: np.random.Generator) -> Sample | None:
        shot = self._shot(rng)
        seen = None if shot is None else self._seen(shot, rng)
        if shot is None or seen is None:
            return None
        truth = seen.window.to_units(shot.joints[[0, INSTANTS // 2, -1]]).numpy()
        at = draw_moments(rng)
        erring = self.erring(shot.poses[at], draw_turns(STARTS, rng), np.full(STARTS, draw_amplitude(rng)))
        starts = self._starts(erring, at, truth, seen.window, shot.joints, rng)
        unit_m = float(shot.joints[INSTANTS // 2, 0, 2]) * seen.window.units_to_tangents()
        return Sample(seen.channels(), truth, starts, unit_m, float(height_m(self.body, shot.betas)))

    def _seen(self, shot: Shot, rng: np.random.Generator) -> Seen | None:
        """Return the exposure over all instants; None where no person is visible."""
        noise = rng.uniform(0.002, 0.012)
        picture, alpha = self._exposed(shot, slice(None))
        if alpha.sum() < LEAST_PX:
            return None
        top, left, bottom, right = matte_region(alpha, margin=_AROUND)
        inner = (slice(top, bottom), slice(left, right))
        frame, plate = as_file(picture[inner], noise, rng), as_file(shot.plate[inner], noise / 2, rng)
        gain = float(np.exp(rng.normal(0, 0.03)))
        matte = np.zeros_like(alpha)
        matte[inner] = matte_of(frame, plate * gain, alpha[inner], rng)
        if matte.sum() < LEAST_PX:
            return None
        return Seen(inner, frame, plate, matte[inner], Window.around(matte, shot.lens, jitter=rng.normal(0, 0.04, 3)))

    def _shot(
        self, rng: np.random.Generator, seconds_range: tuple[float, float] = SECONDS, instants: int = INSTANTS
    ) -> Shot | None:
        """Draw a person in front of a camera; None where the motion jumps."""
        motion = self._motion(rng, seconds_range, instants)
        if motion is None:
            return None
        poses, places = motion
        betas = torch.from_numpy(np.clip(rng.standard_normal(10), -2, 2)).float()
        body = dress(self.body, draw_clothing(self.body, rng)) if rng.random() < _CLOTHED else self.body
        shaped, bare = body.shape(betas), self.body.shape(betas)
        view = self._view(rng)
        world = shaped.pose(axis_angle_to_matrix(torch.from_numpy(poses).float()), torch.from_numpy(places).float())
        points = world.vertices[:, ::13].reshape(-1, 3).double().numpy()
        camera = place(view, front_of(poses[instants // 2, 0]), points, self.frame_px)
        vertices = world.vertices @ torch.from_numpy(camera.R_camera_world).float().T
        vertices = vertices + torch.from_numpy(camera.offset).float()
        plate, texture = self._scene(rng)
        poses, translations = in_camera(camera, poses, places, bare.joints[0].double().numpy())
        rotations = axis_angle_to_matrix(torch.from_numpy(poses).float())
        joints = bare.joints_of(rotations, torch.from_numpy(translations).float())
        return Shot(betas, body.mesh, vertices, poses, joints, camera.lens, plate, texture)

    def _exposed(self, shot: Shot, instants: slice) -> tuple[torch.Tensor, np.ndarray]:
        """Return the image (H, W, 3) of an exposure over some instants, linear light, and the person's share (H, W)."""
        mean = self.rasterizer.render_mean(shot.vertices[instants], shot.texture, shot.lens, shot.mesh)
        return compose(mean, shot.plate), mean[..., 3].numpy()

    def _scene(self, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw a plate, rotated at random, and a texture."""
        plate = self.scenes[rng.integers(_SCENES)][0]
        texture = self.scenes[rng.integers(_SCENES)][1]
        if rng.random() < 0.5:
            plate = plate.flip(1)
        if rng.random() < 0.2:
            room = room_background(self.frame_px, self.frame_px, rng).astype(np.float32)
            plate = torch.from_numpy(srgb_to_linear(room))
        tint = torch.from_numpy(np.exp(rng.normal(0, 0.25, 3))).float()
        return plate * float(np.exp(rng.normal(0, 0.15))), (texture * tint).clamp(0, 1)


def until_found(draw: Callable[[], Found | None]) -> Found:
    """Repeat a draw until it succeeds.

    Args:
        draw: returns None where no person is visible.
    """
    for _ in range(50):
        found = draw()
        if found is not None:
            return found
    raise RuntimeError("fifty draws without a person")


def matte_of(frame: np.ndarray, plate: np.ndarray, alpha: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a matte (H, W) with errors like the shipped method's: a share of the first network's error.

    The first network alone errs by 0.10 of the area in 40 ms; the shipped method by 0.07 in a second.

    Args:
        frame: (H, W, 3) linear light.
        plate: (H, W, 3) linear light.
        alpha: (H, W) the true matte.
        rng: draws the share.
    """
    seen = torch.from_numpy(features(np.clip(frame, 0, 1), np.clip(plate, 0, 1)))[None]
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        answer = shipped_network()(seen.contiguous(memory_format=torch.channels_last))[0, 0]
    first = torch.sigmoid(answer.float()).numpy()
    return clean(alpha + np.float32(rng.uniform(*_MATTE_ERRORS)) * (first - alpha))


def as_file(picture: torch.Tensor, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Add sensor noise and quantise to 8 bits; returns linear light.

    Args:
        picture: (H, W, 3) linear light.
        noise: standard deviation in linear light.
        rng: draws the noise.
    """
    noisy = picture.numpy() + np.float32(noise) * rng.standard_normal(picture.shape, np.float32)
    return srgb_to_linear(np.round(linear_to_srgb(np.clip(noisy, 0, 1)) * 255).astype(np.float32) / 255)
