"""Rotations and translations from the camera's frame (OpenCV: y down) to the worlds that files want."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hfb.config import Floor, WorldUp
from hfb.geometry.world import CALIBRATED, LEVEL, Row, Rows, World
from hfb.typing import Array, Float

_TO_Z_UP: Mapping[WorldUp, Float[Array, "3 3"]] = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
_Z_TO_Y = _TO_Z_UP["-y"]
"""(x, y, z) becomes (x, z, -y), which programs with z up, such as Blender, undo when they read glTF and BVH."""
_Z_TO_POSE2SIM = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""(x, y, z) becomes (y, z, x), as in the .trc files of Pose2Sim."""


@dataclass(frozen=True)
class Placement:
    """A rigid motion of points from the camera's frame: X = R x + t [m]."""

    R: Float[Array, "3 3"]
    t: Float[Array, "3"]

    def points(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Move points.

        Args:
            points: camera coordinates [m].
        """
        return points @ self.R.T + self.t

    def quaternion(self) -> Float[Array, "4"]:
        """Return the rotation (w, x, y, z)."""
        return Rotation.from_matrix(self.R).as_quat(canonical=True, scalar_first=True)


def in_world(world: World) -> Placement:
    """Return the motion to the world as it is; a floor is made level, at height 0, by the smallest turn.

    Args:
        world: the world.
    """
    R, t = np.array(world.rotation, np.float64), np.array(world.translation, np.float64)
    if world.floor is None:
        return Placement(R, t)
    up, turn = _TO_Z_UP[world.up][2], _floor_turn(world).as_matrix()
    return Placement(turn @ R, turn @ t - world.floor[3] * up)


def _floor_turn(world: World) -> Rotation:
    """Return the smallest turn of the floor's normal to the axis that points up."""
    assert world.floor is not None
    normal, up = np.array(world.floor[:3]), _TO_Z_UP[world.up][2]
    axis = np.cross(normal, up)
    return Rotation.from_rotvec(axis * math.atan2(np.linalg.norm(axis), normal @ up) / (np.linalg.norm(axis) or 1.0))


def floor_slant_deg(world: World) -> float:
    """Return the angle between the floor's normal and the world's up; 0 without a floor.

    Args:
        world: the world.
    """
    return 0.0 if world.floor is None else math.degrees(_floor_turn(world).magnitude())


def with_floor(world: World | None, floor: Floor | None) -> World | None:
    """Return a world with a floor.

    Args:
        world: None where nothing is known of it.
        floor: a plane in the calibration's world, else in camera coordinates, whichever way its normal points;
            ``"estimate"``: the feet of a motion will tell it (`hfb.motion.footing.stand`); None changes nothing.
    """
    if floor is None:
        return world
    world = world or LEVEL
    if floor == "estimate":
        return world.model_copy(update={"floor_source": "feet", "floor": None})
    normal, offset = np.array(floor[:3]), floor[3]
    if world.source not in CALIBRATED:
        normal = np.array(world.rotation) @ normal  # such a world has its origin in the camera
    sign = -1.0 if normal @ _TO_Z_UP[world.up][2] < 0 else 1.0
    plane = (*row_of(sign * normal), sign * offset)
    return world.model_copy(update={"floor_source": "plane", "floor": plane})


def z_up(world: World) -> Placement:
    """Return the motion to the world with z up.

    Args:
        world: the world.
    """
    return _turned(world, _TO_Z_UP[world.up])


def y_up(world: World) -> Placement:
    """Return the motion to the world with y up.

    Args:
        world: the world.
    """
    return _turned(world, _Z_TO_Y @ _TO_Z_UP[world.up])


def trc_axes(world: World) -> Placement:
    """Return the motion to the axes of .trc files, y up: of a calibration with z up those of Pose2Sim's own files.

    Args:
        world: the world.
    """
    of_pose2sim = world.source in CALIBRATED and world.up == "z"
    return _turned(world, _Z_TO_POSE2SIM) if of_pose2sim else y_up(world)


def _turned(world: World, by: Float[Array, "3 3"]) -> Placement:
    placed = in_world(world)
    return Placement(by @ placed.R, by @ placed.t)


def world_of_pose(R_camera_world: Float[Array, "3 3"], t_m: Float[Array, "3"], up: WorldUp) -> World:
    """Return the world of a calibrated camera, x = R X + t; R's rounding is taken out.

    Args:
        R_camera_world: world to camera.
        t_m: world to camera.
        up: axis of the world that points up.
    """
    left, _, right = np.linalg.svd(R_camera_world)
    R = (left @ right).T
    return World(rotation=rows_of(R), translation=row_of(-R @ t_m), up=up, source="calibration")


def world_of_up(up_camera: Float[Array, "3"], by_person: bool = False) -> World:
    """Return a world with the camera at its origin: z is up, and the camera looks along y, up or down.

    Args:
        up_camera: direction of up in camera coordinates; not along the optical axis.
        by_person: estimated from the person, not stated.
    """
    up = up_camera / np.linalg.norm(up_camera)
    ahead = np.array([0.0, 0, 1]) - up[2] * up
    ahead /= np.linalg.norm(ahead)
    R = np.stack([np.cross(ahead, up), ahead, up])
    return World(rotation=rows_of(R), translation=(0, 0, 0), up="z", source="person" if by_person else "options")


def up_of_angles(tilt_deg: float, roll_deg: float) -> Float[Array, "3"]:
    """Return the direction of up in camera coordinates.

    Args:
        tilt_deg: positive where the camera looks down.
        roll_deg: positive where what stands upright leans to the right in the image.
    """
    tilt, roll = math.radians(tilt_deg), math.radians(roll_deg)
    return np.array([math.sin(roll) * math.cos(tilt), -math.cos(roll) * math.cos(tilt), -math.sin(tilt)])


def angles_of_world(world: World) -> tuple[float, float]:
    """Return (tilt, roll) of the camera in degrees; see `up_of_angles`.

    Args:
        world: the world.
    """
    x, y, z = z_up(world).R[2].tolist()
    return math.degrees(math.asin(max(-1.0, min(1.0, 0.0 - z)))), math.degrees(math.atan2(x, -y))


def rows_of(matrix: Float[Array, "3 3"]) -> Rows:
    """Return a matrix as plain numbers.

    Args:
        matrix: the matrix.
    """
    one, two, three = (row_of(row) for row in matrix)
    return one, two, three


def row_of(values: Float[Array, "3"]) -> Row:
    """Return a vector as plain numbers.

    Args:
        values: the vector.
    """
    x, y, z = (float(value) for value in values)
    return x, y, z
