"""Blurred people with known joints: mocap seen by a random camera, matted as `hfb` would, with erring starts."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import MIRROR
from hfb.datasets.backgrounds import room_background
from hfb.datasets.clothed import draw_clothing, dress
from hfb.datasets.motion_clip import MotionClip
from hfb.datasets.motions.resampling import has_jump, resample
from hfb.datasets.motions.sources import open_motions
from hfb.datasets.network_errors import draw_pose_errors
from hfb.datasets.scenery import draw_scenery
from hfb.datasets.viewpoints import draw_view, front_of, in_camera, place
from hfb.formation import compose
from hfb.initialize.joint_network import Window, picture_channels
from hfb.matting.matting import clean
from hfb.matting.network import NetworkMatting
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.priors.anatomy import AnatomicalPrior
from hfb.render.rasterizer import make_rasterizer
from hfb.rotations import axis_angle_to_matrix, matrix_to_axis_angle

STARTS = 2
_FRAME_PX = 144
_INSTANTS = 11
_MIXED, _BENT, _CLOTHED, _FROM_BEHIND = 0.6, 0.5, 0.25, 0.15
_PARTS = ((9, 12, 15), (13, 16, 18, 20, 22), (14, 17, 19, 21, 23), (1, 4, 7, 10, 2, 5, 8, 11), (3, 6))
"""Head, left arm, right arm, both legs, waist: parts that one motion may lend another."""
_BEND_RAD = 0.2
_SHORTEST_S, _LONGEST_S = 0.02, 0.5
_SCENES = 240


@dataclass(frozen=True)
class Sample:
    """One picture around one person.

    Attributes:
        picture: (C, H, W) uint8, see `picture_channels`.
        truth: (3, 24, 3) joints at u = 0, 1/2 and 1 in the window's units. starts: (STARTS, 24, 3) of them that err.
        unit_m: how many metres one unit of the window is at the person's distance.
    """

    picture: np.ndarray
    truth: np.ndarray
    starts: np.ndarray
    unit_m: float


class Studio:
    """Motions, scenes and the body; everything drawn from them is a function of the sample's number."""

    def __init__(self, mocap: Path, backgrounds: Path, clips: list[str], seed: int) -> None:
        """Read the named clips and make the scenes."""
        source = open_motions(mocap, seed)
        named = [index for index, name in enumerate(source.names()) if Path(name).stem in clips]
        made = open_motions(None, seed)
        self.recorded = [source.load(index) for index in named]
        self.made = [made.load(index) for index in range(len(made.names()))]
        self.body = load_default_body()
        self.mean = self.body.shape(torch.zeros(10))
        self.rasterizer = make_rasterizer("coverage", "cpu", 1)
        self.matting = NetworkMatting()
        self.scenes = []
        for number in range(_SCENES):
            rng = np.random.default_rng([seed, 77, number])
            photos = backgrounds / ("polyhaven" if number % 4 else "budgie")
            textures = backgrounds / "textures" if number % 3 == 0 else None
            scene = draw_scenery(photos if number % 5 else None, textures, self.body, _FRAME_PX, rng)
            self.scenes.append((scene.plate_linear, scene.texture_linear))

    def draw(self, rng: np.random.Generator) -> Sample:
        """A sample; draws in which nobody is found are drawn again."""
        for _ in range(50):
            found = self._try(rng)
            if found is not None:
                return found
        raise RuntimeError("fifty draws without a person")

    def _motion(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray] | None:
        clips = self.recorded if rng.random() < 0.75 else self.made
        seconds = float(np.exp(rng.uniform(np.log(_SHORTEST_S), np.log(_LONGEST_S))))
        piece = _piece(clips[rng.integers(len(clips))], seconds, rng)
        if piece is None:
            return None
        poses, places = piece
        if rng.random() < _MIXED:
            for part in _PARTS:
                other = _piece(self.recorded[rng.integers(len(self.recorded))], seconds, rng)
                if other is not None and rng.random() < 0.5:
                    poses[:, part] = other[0][:, part]
        if rng.random() < _BENT:
            poses = _bent(poses, rng)
        return (poses[:, MIRROR] * (1, -1, -1), places * (-1, 1, 1)) if rng.random() < 0.5 else (poses, places)

    def _try(self, rng: np.random.Generator) -> Sample | None:
        motion = self._motion(rng)
        if motion is None:
            return None
        poses, places = motion
        betas = torch.from_numpy(np.clip(rng.standard_normal(10), -2, 2)).float()
        body = dress(self.body, draw_clothing(self.body, rng)) if rng.random() < _CLOTHED else self.body
        shaped, bare = body.shape(betas), self.body.shape(betas)
        view = draw_view(rng)
        if rng.random() < _FROM_BEHIND:
            view = replace(view, azimuth_deg=float(rng.uniform(-180, 180)))
        world = shaped.pose(axis_angle_to_matrix(torch.from_numpy(poses).float()), torch.from_numpy(places).float())
        points = world.vertices[:, ::13].reshape(-1, 3).double().numpy()
        camera = place(view, front_of(poses[_INSTANTS // 2, 0]), points, _FRAME_PX)
        vertices = world.vertices @ torch.from_numpy(camera.R_camera_world).float().T
        vertices = vertices + torch.from_numpy(camera.offset).float()
        plate, texture = self._scene(rng)
        mean = self.rasterizer.render_mean(vertices, texture, camera.lens, body.mesh)
        frame = compose(mean, plate)
        noise = rng.uniform(0.002, 0.012)
        frame, plate = (_as_file(one, noise * share, rng) for one, share in ((frame, 1.0), (plate, 0.5)))
        gain = float(np.exp(rng.normal(0, 0.03)))
        matte = clean(self.matting.look(frame, plate * gain))
        if matte.sum() < 60:
            return None
        window = Window.around(matte, camera.lens, jitter=rng.normal(0, 0.04, 3))
        cameras_poses, translations = in_camera(camera, poses, places, bare.joints[0].double().numpy())
        rotations = axis_angle_to_matrix(torch.from_numpy(cameras_poses).float())
        joints = bare.joints_of(rotations, torch.from_numpy(translations).float())
        middle = _INSTANTS // 2
        truth = window.to_units(joints[[0, middle, -1]]).numpy()
        starts = self._starts(cameras_poses, truth, window, joints, rng)
        unit_m = float(joints[middle, 0, 2]) * window.units_to_tangents()
        channels = picture_channels(frame, plate, matte, window)
        return Sample(channels, truth, starts, unit_m)

    def _scene(self, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """A plate turned around at random, and somebody else's clothes."""
        plate = self.scenes[rng.integers(_SCENES)][0]
        texture = self.scenes[rng.integers(_SCENES)][1]
        if rng.random() < 0.5:
            plate = plate.flip(1)
        if rng.random() < 0.2:
            room = room_background(_FRAME_PX, _FRAME_PX, rng).astype(np.float32)
            plate = torch.from_numpy(srgb_to_linear(room))
        tint = torch.from_numpy(np.exp(rng.normal(0, 0.25, 3))).float()
        return plate * float(np.exp(rng.normal(0, 0.15))), (texture * tint).clamp(0, 1)

    def _starts(
        self, poses: np.ndarray, truth: np.ndarray, window: Window, joints: torch.Tensor, rng: np.random.Generator
    ) -> np.ndarray:
        """What static estimators would say: bones turned, the mean body, a little beside its place."""
        at = np.clip(np.round(rng.normal(0.5, 0.2, STARTS) * (_INSTANTS - 1)), 0, _INSTANTS - 1).astype(int)
        errors = draw_pose_errors(torch.from_numpy(poses[at]).float(), rng)
        amplitude = rng.uniform(0.05, 1.3) if rng.random() < 0.93 else 0.01
        erring = errors.poses_at(torch.tensor([0.5, 1.0]) * amplitude)[-1]
        stills = self.mean.joints_of(axis_angle_to_matrix(erring), torch.zeros(STARTS, 3))
        found = []
        for row, still in zip(at, stills, strict=True):
            depth = joints[row, 0, 2] * float(np.exp(rng.normal(0, 0.05)))
            start = window.to_units(still - still[0] + torch.stack([depth * 0, depth * 0, depth])).numpy()
            wander = rng.uniform(0, 1) ** 2 * 0.3
            start[:, :2] += (truth[1] - start)[:, :2].mean(0) + rng.normal(0, wander, 2) * (1, 0.5)
            found.append(start)
        return np.stack(found).astype(np.float32)


def _bent(poses: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The same motion of somebody who holds every joint a little otherwise, where anatomy lets him."""
    turns = torch.from_numpy(rng.normal(0, _BEND_RAD, (1, 24, 3)) * (np.arange(24) > 0)[None, :, None]).float()
    rotations = axis_angle_to_matrix(torch.from_numpy(poses).float()) @ axis_angle_to_matrix(turns)
    bent = matrix_to_axis_angle(rotations).double().numpy()
    before, after = (
        AnatomicalPrior().limit_penalty(torch.from_numpy(one[:, 1:]).float()).max() for one in (poses, bent)
    )
    return bent if after <= max(float(before), 2.0) else poses


def _piece(clip: MotionClip, seconds: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray] | None:
    """Poses and translations at the instants of a random exposure."""
    length = (len(clip.poses) - 1) / clip.fps
    seconds = min(seconds, length)
    start = rng.uniform(0, length - seconds)
    if has_jump(clip, start, start + seconds):
        return None
    return resample(clip, np.clip(np.linspace(start, start + seconds, _INSTANTS), 0, length))


def _as_file(picture: torch.Tensor, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Sensor noise and 8 bits."""
    noisy = picture.numpy() + rng.normal(0, noise, picture.shape)
    return srgb_to_linear(np.round(linear_to_srgb(np.clip(noisy, 0, 1)) * 255).astype(np.float32) / 255)
