"""How the camera stands in the world that exports are written in. Light to import (pydantic only)."""

from __future__ import annotations

import math
from typing import Literal

from hfb.config import Plane, Record, WorldUp

Row = tuple[float, float, float]
Rows = tuple[Row, Row, Row]
WorldSource = Literal["calibration", "rotation", "options", "person", "level"]
FloorSource = Literal["plane", "feet"]

_ROUNDED = 1e-3


class World(Record):
    """The world's axes as the calibration has them: X = rotation x + translation for x in camera coordinates [m].

    Attributes:
        rotation: R_world_camera.
        translation: the camera's place in the world [m].
        up: axis of this world that points up.
        source: a calibration's pose; its rotation alone; the options' tilt and roll; an estimate from the person;
            nothing, so that the camera is taken as level. Only a pose knows the origin: elsewhere it is the camera.
        floor_source: a plane that is stated, or feet that stand; None where no floor is asked for.
        floor: its plane in this world, whose normal points up; None where feet have still to tell it. Files are turned
            and moved so that it is level, at height 0.
    """

    rotation: Rows
    translation: Row
    up: WorldUp
    source: WorldSource
    floor_source: FloorSource | None = None
    floor: Plane | None = None


CALIBRATED: tuple[WorldSource, ...] = ("calibration", "rotation")

LEVEL = World(rotation=((1, 0, 0), (0, 1, 0), (0, 0, 1)), translation=(0, 0, 0), up="-y", source="level")
"""The camera's own axes: up in the image is up in the world."""


class WorldFacts(Record):
    """How the world of exports was found.

    Attributes:
        up: axis of the calibration's world that points up; files have z or y up, as their formats want.
        tilt_deg: the camera looks down by so much.
        roll_deg: what stands upright leans to the right in the image by so much.
        lean_deg: median angle between trunk (pelvis to neck) and vertical.
        floor: what told the floor; None where none is asked for, and heights are about the world's origin.
        soles_mm: median height of the lowest sole of each exposure above the floor.
        foot_skate_mm: see `hfb.motion.footing.foot_skate_mm`.
        says: the same in a sentence.
        doubtful: nobody stated it, or the person contradicts it.
    """

    source: WorldSource
    up: WorldUp
    tilt_deg: float
    roll_deg: float
    lean_deg: float
    floor: FloorSource | None
    soles_mm: float | None
    foot_skate_mm: float | None
    says: str
    doubtful: bool

    def entries(self) -> dict[str, object]:
        """Return the entries of result.json."""
        world = self.model_dump()
        return {"foot_skate_mm": world.pop("foot_skate_mm"), "world": world}


def rotation_fault(rows: Rows) -> str | None:
    """Return why a matrix is no rotation, as the end of a sentence; None where it is one.

    Args:
        rows: of the matrix.
    """
    if not all(math.isfinite(value) for row in rows for value in row):
        return "is no rotation: it has numbers that are not finite"
    products = [[sum(a * b for a, b in zip(one, other, strict=True)) for other in rows] for one in rows]
    if max(abs(products[i][j] - (i == j)) for i in range(3) for j in range(3)) > _ROUNDED:
        return "is no rotation: its rows must be orthonormal"
    (a, b, c), (d, e, f), (g, h, i) = rows
    if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0:
        return "is no rotation but a mirror image (determinant -1): negate the axis that is left-handed"
    return None
