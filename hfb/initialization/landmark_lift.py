"""Landmarks as points of the body: a small network that knows how the landmark network errs in depth.

MediaPipe's metric landmarks are the pose of another body model, and flat: they lean with the camera and keep limbs near
the image plane. From the landmarks in the image and those in metres this network predicts where the same points of
hfb's body are, and how sure that is. It learned from rendered people before photographs
(`hfb.training.landmarks`): what a landmark network says of them beside the truth. 2D-to-3D lifting as in Martinez et
al., A simple yet effective baseline for 3d human pose estimation, ICCV 2017, with a first guess as further input.
"""

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
import torch
from safetensors.torch import load_file
from torch import nn

from hfb.geometry.camera import PinholeCamera
from hfb.initialization.landmarks import LANDMARK, Landmarks
from hfb.kernels.determinism import one_torch_thread
from hfb.typing import Array, Float, Tensor

JOINT_POINTS = tuple(
    f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")
)
POINTS = (
    *JOINT_POINTS,
    *("nose", "left_ear", "left_heel", "left_foot_index", "right_ear", "right_heel", "right_foot_index"),
)
"""Landmarks that are also points of the body, in the order of all arrays here."""

WIDTH = 256
_BLOCKS, _DROPPED = 2, 0.3
_INPUTS = len(POINTS) * 8 + 2
_INPUT_SCALE, _OUTPUT_SCALE, _DIRECT_SCALE = 3.0, 0.2, 0.1
_CHOSEN = [LANDMARK[name] for name in POINTS]
HIPS = [POINTS.index("left_hip"), POINTS.index("right_hip")]
_SHOULDERS = [POINTS.index("left_shoulder"), POINTS.index("right_shoulder")]
SWAPPED = [POINTS.index(name.replace("left", "-").replace("right", "left").replace("-", "right")) for name in POINTS]
_LEAST_DISTANCE_M, _MOST_DISTANCE_M = 0.3, 50.0


@dataclass(frozen=True)
class Sighting:
    """N people's landmarks, in metres about the middle of the hips at the distance at which they look as large.

    Attributes:
        across: in the image, x right and y down, times the distance [m].
        guess: metric landmarks, camera axes [m].
        sure: how visible each is, in [0, 1].
        ray: tangents of the hips' middle.
        distance_m: from the size in the image and in metres.
    """

    across: Float[Tensor, "N 19 2"]
    guess: Float[Tensor, "N 19 3"]
    sure: Float[Tensor, "N 19"]
    ray: Float[Tensor, "N 2"]
    distance_m: Float[Tensor, "N"]

    @staticmethod
    def of(
        rays: Float[Tensor, "N 33 2"], world: Float[Tensor, "N 33 3"], visibility: Float[Tensor, "N 33"]
    ) -> "Sighting":
        """Return them in units of the person.

        Args:
            rays: landmarks in the image, as tangents.
            world: metric landmarks in camera axes [m].
            visibility: in [0, 1].
        """
        rays, world = rays[:, _CHOSEN], world[:, _CHOSEN]
        ray = rays[:, HIPS].mean(1)
        world = world - world[:, HIPS].mean(1, keepdim=True)
        joints = len(JOINT_POINTS)
        distance = (_spread(world[:, :joints, :2]) / _spread(rays[:, :joints]).clamp_min(1e-6)).clamp(
            _LEAST_DISTANCE_M, _MOST_DISTANCE_M
        )
        across = (rays - ray[:, None]) * distance[:, None, None]
        return Sighting(across, world, visibility[:, _CHOSEN], ray, distance)

    def mirrored(self) -> "Sighting":
        """Return the mirror image: left and right change places."""
        turned = self.guess.new_tensor([-1.0, 1.0, 1.0])
        return Sighting(
            self.across[:, SWAPPED] * turned[:2],
            self.guess[:, SWAPPED] * turned,
            self.sure[:, SWAPPED],
            self.ray * turned[:2],
            self.distance_m,
        )


@dataclass(frozen=True)
class LiftedPoints:
    """`POINTS` of one person.

    Attributes:
        points: about the middle of the hips, camera axes [m], as if the hips were ``distance_m`` away.
        scale: of each coordinate's Laplace distribution [m].
        distance_m: depth of the hips in whose units the points are.
    """

    points: Float[Tensor, "19 3"]
    scale: Float[Tensor, "19 3"]
    distance_m: Float[Tensor, ""]


class LandmarkLift(nn.Module):
    """Residual MLP that corrects landmarks, in an image turned so that the trunk is upright."""

    def __init__(self) -> None:
        super().__init__()
        self.enter = nn.Linear(_INPUTS, WIDTH)
        self.direct = nn.Linear(_INPUTS, len(POINTS) * 3)
        self.blocks = nn.ModuleList(_Block(WIDTH) for _ in range(_BLOCKS))
        self.leave = nn.Sequential(nn.LayerNorm(WIDTH), nn.Dropout(_DROPPED), nn.Linear(WIDTH, len(POINTS) * 6))
        for layer in (self.direct, self.leave[2]):
            nn.init.zeros_(layer.weight)  # type: ignore[arg-type]  # a linear layer's
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]

    def forward(self, seen: Sighting) -> tuple[Float[Tensor, "N 19 3"], Float[Tensor, "N 19 3"]]:
        """Return the points [m] and the logarithm of the Laplace scale of each coordinate.

        Args:
            seen: landmarks.
        """
        R_upright = _upright(seen.across)
        across, ray = seen.across @ R_upright.transpose(1, 2), (seen.ray[:, None] @ R_upright.transpose(1, 2))[:, 0]
        guess = turned_about_axis(seen.guess, R_upright)
        facts = torch.cat([across, guess, across - guess[..., :2]], -1) * _INPUT_SCALE
        inputs = torch.cat([torch.cat([facts, seen.sure[..., None]], -1).flatten(1), ray], 1)
        inner = self.enter(inputs)
        for block in self.blocks:
            inner = inner + block(inner)
        told = self.leave(inner).unflatten(1, (len(POINTS), 6))
        direct = self.direct(inputs).unflatten(1, (len(POINTS), 3))
        points = torch.cat([across, guess[..., 2:]], -1) + _OUTPUT_SCALE * told[..., :3] + _DIRECT_SCALE * direct
        return turned_about_axis(points, R_upright.transpose(1, 2)), (told[..., 3:] - 3).clamp(-7, 1)


class _Block(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(width),
            nn.Dropout(_DROPPED),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Dropout(_DROPPED),
            nn.Linear(width, width),
        )

    def forward(self, values: Float[Tensor, "N W"]) -> Float[Tensor, "N W"]:
        return self.layers(values)


def turned_about_axis(points: Float[Tensor, "N L 3"], R: Float[Tensor, "N 2 2"]) -> Float[Tensor, "N L 3"]:
    """Turn points about the optical axis.

    Args:
        points: camera axes.
        R: rotation of x and y.
    """
    return torch.cat([points[..., :2] @ R.transpose(1, 2), points[..., 2:]], -1)


def lift_landmarks(landmarks: Landmarks, camera: PinholeCamera) -> LiftedPoints:
    """Return points of the body by the shipped network: the mean for the landmarks and their mirror image.

    Args:
        landmarks: landmarks of the person.
        camera: camera of the image.
    """
    rays = (landmarks.pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    rows = (
        torch.from_numpy(one).float()[None] for one in (rays, world_in_camera(landmarks, camera), landmarks.visibility)
    )
    seen = Sighting.of(*rows)
    network = shipped_landmark_lift()
    with one_torch_thread(), torch.inference_mode():
        points, log_scale = network(seen)
        reflected, _ = network(seen.mirrored())
        points = (points + reflected[:, SWAPPED] * points.new_tensor([-1.0, 1.0, 1.0])) / 2
    # inference tensors must not enter a graph
    return LiftedPoints(points[0].clone(), log_scale[0].exp().clone(), seen.distance_m[0])


def world_in_camera(landmarks: Landmarks, camera: PinholeCamera) -> Float[Array, "33 3"]:
    """Rotate the metric landmarks from "along the region's view ray" to "along the optical axis".

    Args:
        landmarks: landmarks of the person.
        camera: camera of the image.
    """
    ray = np.array([(landmarks.region.x - camera.cx) / camera.fx, (landmarks.region.y - camera.cy) / camera.fy, 1.0])
    ray /= np.linalg.norm(ray)
    cross = np.cross([0.0, 0.0, 1.0], ray)
    x, y, z = cross
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R_camera_ray = np.eye(3) + skew + skew @ skew / (1 + ray[2])
    return landmarks.world @ R_camera_ray.T


@lru_cache(maxsize=1)
def shipped_landmark_lift() -> LandmarkLift:
    """Load the network of data/landmark_lift.safetensors; data/landmark_lift.json tells how it was trained."""
    network = LandmarkLift()
    with resources.as_file(resources.files("hfb.initialization") / "data" / "landmark_lift.safetensors") as path:
        network.load_state_dict({name: weights.float() for name, weights in load_file(path).items()})
    return network.requires_grad_(False).eval()


def _upright(across: Float[Tensor, "N 19 2"]) -> Float[Tensor, "N 2 2"]:
    """Return the rotation of the image after which the shoulders are above the hips."""
    x, y = across[:, _SHOULDERS].mean(1).unbind(-1)
    angle = torch.atan2(x, -y)
    cosine, sine = angle.cos(), angle.sin()
    return torch.stack([torch.stack([cosine, sine], -1), torch.stack([-sine, cosine], -1)], -2)


def _spread(points: Float[Tensor, "N L c"]) -> Float[Tensor, "N"]:
    return (points - points.mean(1, keepdim=True)).square().sum((1, 2)).sqrt()
