"""Random cameras that face a person, and motions seen from them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hfb.geometry.camera import PinholeCamera
from hfb.typing import Array, Float

_AZIMUTH_DEG, _ELEVATION_DEG, _ROLL_DEG = 70.0, (-5.0, 20.0), 3.0
_DIAGONAL_FIELD_DEG = (35.0, 65.0)
_FILLED = (0.55, 0.85)
_MARGIN = 0.05
"""Share of the image's side that is kept free on every side of the person."""
_ROUNDS = 8
_UPRIGHT = 0.3
"""A front whose horizontal part is shorter than this is no direction to look from: the person lies, or bends far."""


@dataclass(frozen=True)
class View:
    """The free parameters of a camera that looks at a person.

    Attributes:
        azimuth_deg: angle about the world's vertical, from the person's front.
        elevation_deg: elevation above the horizontal.
        roll_deg: angle about the line of sight.
        diagonal_field_deg: between opposite corners of the image.
        filled: share of the image's side that the longer side of the person's box takes.
        aside: in [-1, 1], where the box lies (x, y) within what is left.
    """

    azimuth_deg: float
    elevation_deg: float
    roll_deg: float
    diagonal_field_deg: float
    filled: float
    aside: tuple[float, float]


@dataclass(frozen=True, eq=False)
class PlacedCamera:
    """A camera in the world of a motion: a point p of the world is at ``R_camera_world @ p + offset`` [m]."""

    R_camera_world: Float[Array, "3 3"]
    offset: Float[Array, "3"]
    lens: PinholeCamera


def draw_view(rng: np.random.Generator) -> View:
    """Draw a camera in front of the person, mostly a little above the hips.

    Args:
        rng: draws the view.
    """
    x, y = rng.uniform(-1, 1, 2)
    return View(
        azimuth_deg=float(rng.uniform(-_AZIMUTH_DEG, _AZIMUTH_DEG)),
        elevation_deg=float(rng.uniform(*_ELEVATION_DEG)),
        roll_deg=float(np.clip(rng.normal(0, _ROLL_DEG / 2), -_ROLL_DEG, _ROLL_DEG)),
        diagonal_field_deg=float(rng.uniform(*_DIAGONAL_FIELD_DEG)),
        filled=float(rng.uniform(*_FILLED)),
        aside=(float(x), float(y)),
    )


def front_of(root: Float[Array, "3"]) -> Float[Array, "3"]:
    """Return the horizontal direction that a person with this root rotation faces.

    Where the face looks up or down, the direction from hips to head is used instead; then +z.

    Args:
        root: axis-angle [rad], body to world.
    """
    turn = Rotation.from_rotvec(root).as_matrix()
    for direction in (turn[:, 2], turn[:, 1] * -np.sign(turn[1, 2] or 1.0), np.array([0.0, 0.0, 1.0])):
        level = direction * (1.0, 0.0, 1.0)
        length = float(np.linalg.norm(level))
        if length > _UPRIGHT:
            break
    return level / length


def place(view: View, front: Float[Array, "3"], points: Float[Array, "N 3"], size_px: int) -> PlacedCamera:
    """Place the camera of a view so that all points lie in its square image as the view specifies.

    Args:
        view: angles, field of view and framing.
        front: unit, horizontal.
        points: on the person's surface, over the whole time that is seen [m, world].
        size_px: side of the square image.
    """
    away = Rotation.from_euler("y", view.azimuth_deg, degrees=True).apply(front)
    elevation, roll = np.deg2rad((view.elevation_deg, view.roll_deg))
    forward = -(np.cos(elevation) * away + np.sin(elevation) * np.array([0.0, 1.0, 0.0]))
    right = np.cross(forward, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    R_camera_world = np.stack([right, down, forward])
    focal = np.sqrt(0.5) / np.tan(np.deg2rad(view.diagonal_field_deg) / 2)  # of an image of side 1
    seen = R_camera_world @ points.T
    extent = np.ptp(seen, axis=1)
    offset = -(seen.min(1) + seen.max(1)) / 2
    offset[2] += focal * extent[:2].max() / view.filled + extent[2] / 2
    for _ in range(_ROUNDS):
        depth = np.maximum(seen[2] + offset[2], 0.2)
        screen = focal * (seen[:2] + offset[:2, None]) / depth
        low, high = screen.min(1), screen.max(1)
        room = np.maximum(0.5 - _MARGIN - (high - low) / 2, 0)
        middle_m = float(depth.mean())
        offset[:2] += (room * view.aside - (low + high) / 2) * middle_m / focal
        offset[2] += middle_m * ((high - low).max() / view.filled - 1)
    lens = PinholeCamera.from_focal(float(focal * size_px), size_px, size_px)
    return PlacedCamera(R_camera_world, offset, lens)


def in_camera(
    camera: PlacedCamera,
    poses: Float[Array, "S 24 3"],
    translations: Float[Array, "S 3"],
    rest_pelvis: Float[Array, "3"],
) -> tuple[Float[Array, "S 24 3"], Float[Array, "S 3"]]:
    """Transform a world motion to camera coordinates.

    SMPL's root turns about the rest pelvis p, x -> R (x - p) + p + t, so the translation of the turned motion is
    R_camera_world (p + t) + offset - p: it depends on the person's shape.

    Args:
        camera: its pose in the world.
        poses: axis-angle [rad], the root's in the world.
        translations: SMPL's [m], world.
        rest_pelvis: p [m].
    """
    turn = camera.R_camera_world
    poses = poses.copy()
    poses[:, 0] = (Rotation.from_matrix(turn) * Rotation.from_rotvec(poses[:, 0])).as_rotvec()
    return poses, (translations + rest_pelvis) @ turn.T + camera.offset - rest_pelvis
