"""First bodies of a whole clip: a full search in some frames, interpolation and refinement in between.

A search in one frame cannot distinguish front from back in a silhouette; a clip can, since people do not turn around
between two frames. A body that a frame does not show is interpolated from its neighbours, and marked.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hfb.body.model import Body
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import (
    axis_angle_to_quaternion,
    in_hemisphere_of,
    normalize_quaternion,
    quaternion_to_axis_angle,
)
from hfb.initialization.silhouette_fit import SilhouetteStage, Stay, matte_level, overlap, refine, refine_swept
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Bool, Float

_LAY_ON = (SilhouetteStage(64, 25, 0.02, shape=False),)
_STAY = Stay(pose=0.02, root=0.1, place=0.5)
_COMPARE_PX = 64
_STILL_ENOUGH, _CLEARLY_MOVING = 0.5, 0.1  # soft IoU with the matte of a body at rest; what a path must gain over it


@dataclass(frozen=True)
class ClipBodies:
    """One body per frame of a clip, where there is one.

    Attributes:
        bodies: None where the person is absent.
        filled: frames whose body comes from their neighbours because none was found in them.
    """

    bodies: tuple[FirstBody | None, ...]
    filled: Bool[Array, "T"]

    @property
    def usable(self) -> Bool[Array, "T"]:
        """Frames with a body."""
        return np.array([body is not None for body in self.bodies], bool)


def key_frames(present: Bool[Array, "T"], every: int) -> tuple[int, ...]:
    """Return frames whose body is searched for from scratch: the first and last of every run, and some between.

    Args:
        present: frames in which the person is seen.
        every: at most so many frames from one to the next.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], present, [False]]).astype(np.int8)))
    chosen: list[int] = []
    for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        steps = max(1, -(-(stop - 1 - first) // every))
        chosen += sorted({first + round(step * (stop - 1 - first) / steps) for step in range(steps + 1)})
    return tuple(chosen)


def between(frame: int, known: Mapping[int, FirstBody]) -> FirstBody:
    """Interpolate the body at a frame's time between its known neighbours; the nearest one beyond the ends.

    Args:
        frame: number of the frame.
        known: bodies by frame number, at least one.

    Raises:
        ValueError: none is known.
    """
    if not known:
        raise ValueError("no body is known that could stand in for a missing one")
    before = max((one for one in known if one <= frame), default=None)
    after = min((one for one in known if one >= frame), default=None)
    if before is None or after is None or before == after:
        nearest = before if before is not None else after
        assert nearest is not None
        return replace(known[nearest], source="between" if nearest != frame else known[nearest].source)
    share = (frame - before) / (after - before)
    left, right = known[before], known[after]
    one, other = axis_angle_to_quaternion(left.pose), axis_angle_to_quaternion(right.pose)
    pose = normalize_quaternion((1 - share) * one + share * in_hemisphere_of(other, one))
    return FirstBody(
        pose=quaternion_to_axis_angle(pose),
        translation=(1 - share) * left.translation + share * right.translation,
        betas=(1 - share) * left.betas + share * right.betas,
        source="between",
    )


def body_between(
    frame: int,
    known: Mapping[int, FirstBody],
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer | None = None,
) -> FirstBody:
    """Estimate the body of a frame without a search: its neighbours' (`between`), fitted to the frame's matte.

    Args:
        frame: number of the frame.
        known: bodies by frame number, at least one.
        matte: alpha of the frame.
        camera: camera of the frame.
        body: model of the first bodies.
        rasterizer: draws silhouettes; the compiled one with exact coverage by default.

    Raises:
        InputError: the matte is empty.
        ValueError: no body is known.
    """
    drawing = rasterizer or make_rasterizer("coverage")
    start = between(frame, known)
    closer = refine(start, matte, camera, body, drawing, list(_LAY_ON), _STAY)
    level = matte_level(matte, camera, _COMPARE_PX)
    best = max((closer, start), key=lambda one: overlap(one, level, body, drawing))
    shared = overlap(best, level, body, drawing)
    before = max((k for k in known if k < frame), default=None)
    after = min((k for k in known if k > frame), default=None)
    if shared >= _STILL_ENOUGH or before is None or after is None:
        return best
    # A person who moves by their own width in a frame: fitted along the path from neighbour to neighbour.
    path = (known[after].translation - known[before].translation) / (after - before)
    moving, path = refine_swept(start, path, matte, camera, body, drawing, list(_LAY_ON), _STAY)
    return moving if overlap(moving, level, body, drawing, path) > shared + _CLEARLY_MOVING else best


def fill_missed(found: Mapping[int, FirstBody], present: Bool[Array, "T"], longest_fill: int) -> ClipBodies:
    """Return one body per frame: missed ones from their neighbours in time, and marked.

    Args:
        found: bodies by frame.
        present: frames in which the person is seen: others never get a body.
        longest_fill: longest run of missed frames that is filled; at longer ones the clip is split into segments.
    """
    bodies: list[FirstBody | None] = [found.get(frame) for frame in range(len(present))]
    filled = np.zeros(len(present), bool)
    missed = np.array([here and frame not in found for frame, here in enumerate(present.tolist())], bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missed, [False]]).astype(np.int8)))
    for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        near = {frame: found[frame] for frame in (first - 1, stop) if frame in found}
        if stop - first > longest_fill or not near:
            continue
        for frame in range(first, stop):
            bodies[frame] = between(frame, near)
            filled[frame] = True
    return ClipBodies(tuple(bodies), filled)
