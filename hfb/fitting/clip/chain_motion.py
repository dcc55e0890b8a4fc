"""The motion of a chain of windows as a function of time; see join.py for how it is put together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hfb.body.model import ShapedBody
from hfb.fitting.clip.windows import WindowFit
from hfb.geometry.hermite import STEP, Meeting, blend_rotations, log_about, turned_by
from hfb.geometry.rotations import matrix_to_quaternion, quaternion_to_matrix
from hfb.motion.trajectory import Trajectory
from hfb.typing import Array, Float, Int, Tensor

_REACH = 0.5
"""Exposures over which the correction of an edge fades."""
_SLOWEST_M = 0.05
"""Per exposure: of a slower joint, a share of its speed says nothing."""


@dataclass(frozen=True)
class Edge:
    """The transition from one frame to the next.

    Attributes:
        frame: the earlier one.
        jump_mm: largest jump of a joint's position, as fitted.
        velocity_jump: largest jump of a joint's velocity, as fitted, as a share of its speed.
        left_mm: `jump_mm` of the joined motion.
        left_velocity: `velocity_jump` of the joined motion.
    """

    frame: int
    jump_mm: float
    velocity_jump: float
    left_mm: float
    left_velocity: float


@dataclass(frozen=True, eq=False)
class ChainMotion:
    """Frames in the order of the clip, each with its motion in one or two windows.

    Attributes:
        frames: their numbers in the clip.
        early: per frame the motion of the window that ends in it.
        late: per frame the motion of the window that begins (or continues) in it.
        gap_u: time from a frame's closing to the next one's opening, in exposures.
        rows: rows of the frames whose edge to the next one is closed.
        meeting: the gap at these edges, as fitted.
        owners: per frame the places of `early` and `late` in the windows: (window, frame of it) twice.
    """

    frames: Int[Array, "F"]
    early: Trajectory
    late: Trajectory
    gap_u: Float[Array, "F"]
    rows: Int[Array, "E"]
    owners: tuple[tuple[tuple[int, int], tuple[int, int]], ...]
    meeting: Meeting | None = None

    @staticmethod
    def of(ordered: Sequence[WindowFit], gaps_u: Float[Array, "T"]) -> "ChainMotion":
        """Build the chain of windows in the order of the clip.

        Args:
            ordered: windows in the order of the clip.
            gaps_u: gap after every frame of the clip, in exposures.
        """
        claims: dict[int, list[tuple[int, int]]] = {}
        passed: set[int] = set()
        for index, found in enumerate(ordered):
            for place, frame in enumerate(found.frames):
                claims.setdefault(frame, []).append((index, place))
            passed |= set(found.frames[:-1])
        frames = np.array(sorted(claims), np.int64)
        owners = tuple((claims[frame][0], claims[frame][-1]) for frame in frames.tolist())
        early, late = (_stacked(ordered, [pair[end] for pair in owners]) for end in (0, 1))
        gap_u = gaps_u[frames]
        closed = np.array([frame in passed for frame in frames.tolist()]) & (gap_u < 2 * _REACH)
        chain = ChainMotion(frames, early, late, gap_u, np.flatnonzero(closed), owners)
        if not len(chain.rows):
            return chain
        half = torch.from_numpy(gap_u[chain.rows] / 2)
        return replace(chain, meeting=chain._meeting(chain.rows, 1 + half, chain.rows + 1, -half))

    def at(self, u: Float[Tensor, "F S"]) -> tuple[Float[Tensor, "F S 24 4"], Float[Tensor, "F S 3"]]:
        """Return unit quaternions and translations [m] of every frame at its own times, exposures since its opening.

        Args:
            u: times of each frame [exposures].
        """
        rotation, path = self._blended(u)
        if self.meeting is None:
            return rotation, path
        half = torch.from_numpy(self.gap_u[self.rows] / 2)[:, None]
        for side in (0, 1):
            rows = torch.from_numpy(self.rows + side)
            away = 1 + half - u[rows] if side == 0 else u[rows] + half
            turn, shift = self.meeting.closing(away, side, _REACH)
            here = rotation[rows]
            middle = self.meeting.middle[:, None].expand_as(here)
            moved = turned_by(middle, log_about(middle, here) + turn)
            # Far from the edge nothing changes, and the logarithm about it may be large.
            rotation = rotation.index_copy(0, rows, torch.where((away < _REACH)[..., None, None], moved, here))
            path = path.index_add(0, rows, shift)
        return rotation, path

    def bridges(
        self, openings_u: Float[Array, "T"], clock: Float[Tensor, "S"], longest: int
    ) -> tuple[Int[Array, "B"], Float[Tensor, "B S 24 4"], Float[Tensor, "B S 3"]]:
        """Return (frames, unit quaternions, translations [m]) through stretches without the person, `longest` at most.

        Args:
            openings_u: opening times of every frame of the clip's shutter, in exposures.
            clock: times of the sub-frames [exposures].
            longest: most frames of a stretch that is bridged.
        """
        steps = np.diff(self.frames)
        rows = np.flatnonzero((steps > 1) & (steps <= longest + 1))
        between = [(row, frame) for row in rows for frame in range(self.frames[row] + 1, self.frames[row + 1])]
        if not between:
            nothing = torch.zeros(0, len(clock), 24, 4, dtype=torch.float64)
            return np.zeros(0, np.int64), nothing, nothing[:, :, 0, :3]
        row, frame = np.array(between).T
        closing = openings_u[self.frames[row]] + 1
        span = torch.from_numpy(openings_u[self.frames[row + 1]] - closing)
        share = (torch.from_numpy(openings_u[frame] - closing)[:, None] + clock) / span[:, None]
        ends = self._meeting(row, torch.ones(len(row)), row + 1, torch.zeros(len(row)))
        return frame, *ends.bridge(share, span)

    def edges(self, shaped: ShapedBody) -> tuple[Edge, ...]:
        """Return the gap as fitted and the gap that is left at every closed edge.

        Args:
            shaped: the clip's person, in double precision.
        """
        if self.meeting is None:
            return ()
        half = torch.from_numpy(self.gap_u[self.rows] / 2)
        clock = torch.zeros(len(self.frames), 6, dtype=torch.float64)
        back = torch.tensor([2.0, 1.0, 0.0], dtype=torch.float64) * STEP
        clock[self.rows, :3] = 1 + half[:, None] - back  # towards the meeting from within
        clock[self.rows + 1, 3:] = -half[:, None] + back.flip(0)
        out = []
        for rotation, path in (self._pure(clock), self.at(clock)):
            joints = shaped.joints_of(quaternion_to_matrix(rotation.flatten(0, 1)), path.flatten(0, 1))
            joints = joints.unflatten(0, clock.shape)
            before, after = joints[self.rows, :3], joints[self.rows + 1, 3:]
            arriving = (3 * before[:, 2] - 4 * before[:, 1] + before[:, 0]) / (2 * STEP)
            leaving = (4 * after[:, 1] - 3 * after[:, 0] - after[:, 2]) / (2 * STEP)
            speed = torch.maximum(arriving.norm(dim=-1), leaving.norm(dim=-1)).clamp_min(_SLOWEST_M)
            jump = 1e3 * (after[:, 0] - before[:, 2]).norm(dim=-1).amax(1)
            out += [jump, ((leaving - arriving).norm(dim=-1) / speed).amax(1)]
        numbers = torch.stack(out, 1).tolist()
        return tuple(Edge(int(self.frames[row]), *one) for row, one in zip(self.rows, numbers, strict=True))

    def radius_mm(self, ordered: Sequence[WindowFit], u: Float[Array, "S"]) -> Float[Array, "F S 24"] | None:
        """Return the windows' own radii, blended as their motions are; None where a window has none.

        Args:
            ordered: windows in the order of the clip.
            u: times of the sub-frames [exposures].
        """
        radii = [found.joint_radius_mm for found in ordered]
        if any(radius is None for radius in radii):
            return None
        early, late = (
            np.stack([np.asarray(radii[window])[place] for window, place in (pair[end] for pair in self.owners)])
            for end in (0, 1)
        )
        share = _rising(torch.from_numpy(u)).numpy()[None, :, None]
        return (1 - share) * early + share * late

    def _blended(self, u: Float[Tensor, "F S"]) -> tuple[Float[Tensor, "F S 24 4"], Float[Tensor, "F S 3"]]:
        """Blend from the early window's motion to the late one's where both have a frame, flat at both ends."""
        (one, here), (other, there) = _evaluated(self.early, u), _evaluated(self.late, u)
        share = _rising(u)[..., None]
        return blend_rotations(one, other, share[..., None]), (1 - share) * here + share * there

    def _pure(self, u: Float[Tensor, "F S"]) -> tuple[Float[Tensor, "F S 24 4"], Float[Tensor, "F S 3"]]:
        """Return the motion as fitted: the early window up to mid-exposure, the late one from there on."""
        (one, here), (other, there) = _evaluated(self.early, u), _evaluated(self.late, u)
        late = (u > 0.5)[..., None]
        return torch.where(late[..., None], other, one), torch.where(late, there, here)

    def _meeting(
        self,
        rows: Int[Array, "E"],
        closing: Float[Tensor, "E"],
        next_rows: Int[Array, "E"],
        opening: Float[Tensor, "E"],
    ) -> Meeting:
        """Return the gap between the late motion of some frames and the early motion of others."""
        steps = torch.tensor([-STEP, 0.0, STEP], dtype=torch.float64)
        left, right = _rows(self.late, rows), _rows(self.early, next_rows)
        one = _evaluated(left, closing.double()[:, None] + steps)
        other = _evaluated(right, opening.double()[:, None] + steps)
        return Meeting.of(torch.stack([one[0], other[0]]), torch.stack([one[1], other[1]]))


def _rising(u: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """Return 3 u^2 - 2 u^3 within the exposure, constant outside."""
    s = u.clamp(0, 1)
    return s * s * (3 - 2 * s)


def _stacked(ordered: Sequence[WindowFit], places: Sequence[tuple[int, int]]) -> Trajectory:
    """Stack the frames' polynomials in double precision."""

    def parts(name: str) -> Tensor:
        return torch.stack([getattr(ordered[window].trajectory, name)[place].detach() for window, place in places])

    return replace(
        ordered[0].trajectory,
        rotation=parts("rotation").double(),
        translation=parts("translation").double(),
    )


def _rows(motion: Trajectory, rows: Int[Array, "E"]) -> Trajectory:
    index = torch.from_numpy(rows)
    return replace(motion, rotation=motion.rotation[index], translation=motion.translation[index])


def _evaluated(motion: Trajectory, u: Float[Tensor, "F S"]) -> tuple[Float[Tensor, "F S 24 4"], Float[Tensor, "F S 3"]]:
    """Evaluate every frame at its own times; frames with the same times at once."""
    clocks, which = torch.unique(u, dim=0, return_inverse=True)
    rotation = u.new_zeros(*u.shape, 24, 4)
    path = u.new_zeros(*u.shape, 3)
    for number, clock in enumerate(clocks):
        chosen = which == number
        rotations, translations = _rows(motion, np.flatnonzero(chosen.numpy())).at(clock)
        rotation[chosen], path[chosen] = matrix_to_quaternion(rotations), translations
    return rotation, path
