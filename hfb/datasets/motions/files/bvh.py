"""BVH files: a skeleton and its joint angles over time, as text."""

import io
import logging
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hfb.errors import InputError
from hfb.geometry.quaternions import multiply, rotate
from hfb.typing import Array, Float

_MAX_BYTES, _MAX_HEAD = 64 << 20, 4 << 20
_MAX_JOINTS = 1000
_MAX_FPS = 10_000
_USUAL_RATES = (24.0, 30.0, 60.0, 90.0, 120.0, 240.0)
_MAX_BLANK = 1000
_NEAR_ZERO = 0.25  # of the offset
_MAX_TURNS = 1 << 22  # frames x joints: a joint without channels takes no byte of the table, yet a place in memory
_POSITIONS = {"xposition": 0, "yposition": 1, "zposition": 2}
_ROTATIONS = {"xrotation": 0, "yrotation": 1, "zrotation": 2}
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BvhMotion:
    """The content of a file, in its own units and axes; parents come before their children.

    Attributes:
        names: names of the joints.
        parents: number of each joint's parent, -1 for the root.
        offsets: offsets from the parent, in the parent's frame.
        ends: offsets of the end sites from their joints; 0 without one.
        rotations: rotations of each joint in its parent's frame, unit quaternions (w, x, y, z).
        places: positions of each joint in its parent's frame: its position channels where it has them, else its offset.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[Array, "N 3"]
    ends: Float[Array, "N 3"]
    rotations: Float[Array, "F N 4"]
    places: Float[Array, "F N 3"]
    fps: float

    def world(self) -> tuple[Float[Array, "F N 4"], Float[Array, "F N 3"]]:
        """Return world rotation and position of every joint."""
        rotations, places = self.rotations.copy(), self.places.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                rotations[:, joint] = multiply(rotations[:, parent], self.rotations[:, joint])
                places[:, joint] = places[:, parent] + rotate(rotations[:, parent], self.places[:, joint])
        return rotations, places

    def rest(self) -> Float[Array, "N 3"]:
        """Return joints of the pose in which every angle is zero."""
        places = self.offsets.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                places[joint] += places[parent]
        return places


@dataclass
class _Joint:
    name: str
    parent: int
    offset: list[float] | None = None
    end: list[float] | None = None
    channels: list[str] | None = None


def read_bvh(path: Path) -> BvhMotion:
    """Read one file.

    Args:
        path: the .bvh file.

    Raises:
        InputError: not a BVH file, cut off, or damaged; the text names the line.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path} is larger than {_MAX_BYTES >> 20} MB; cut the recording into shorter BVH files")
        data = path.read_bytes()
        is_utf16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
        text = data.decode("utf-16" if is_utf16 else "utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); give a .bvh file") from error
    try:
        motion, remark = _parse(text)
        if remark:
            _log.warning("%s: %s", path.name, remark)
        return motion
    except InputError as error:
        raise InputError(f"{path} is not a usable BVH file: {error}; export it again") from error


def _parse(text: str) -> tuple[BvhMotion, str | None]:
    """Return the motion and remarks for the user."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text.lstrip().upper().startswith("HIERARCHY"):
        raise InputError("it does not begin with HIERARCHY")
    separator = re.search(r"^[ \t]*MOTION[ \t]*$", text, re.MULTILINE | re.IGNORECASE)
    if separator is None:
        raise InputError("it has no MOTION part (cut off?)")
    head, motion = text[: separator.start()], text[separator.start() :]
    if len(head) > _MAX_HEAD:
        raise InputError(f"its skeleton has more than {_MAX_HEAD >> 20} MB of text")
    joints = _Hierarchy(head).joints
    first_line = head.count("\n") + 1
    counts = [len(joint.channels or ()) for joint in joints]
    values, fps, remark = _read_motion(motion, sum(counts), first_line)
    if len(values) * len(joints) > _MAX_TURNS:
        raise InputError(f"{len(values)} frames of {len(joints)} joints are too many at once, cut it into shorter ones")
    rotations = np.zeros((len(values), len(joints), 4))
    offsets = np.array([joint.offset for joint in joints], dtype=np.float64)
    places = np.repeat(offsets[None], len(values), 0)
    starts = np.cumsum([0, *counts])
    by_order: dict[tuple[int, ...], list[tuple[int, list[int]]]] = {}
    for number, joint in enumerate(joints):
        channels = joint.channels or []
        turns = [(starts[number] + k, _ROTATIONS[c]) for k, c in enumerate(channels) if c in _ROTATIONS]
        by_order.setdefault(tuple(axis for _, axis in turns), []).append((number, [column for column, _ in turns]))
        moved = [(starts[number] + k, _POSITIONS[c]) for k, c in enumerate(channels) if c in _POSITIONS]
        if moved:
            columns, axes = (list(one) for one in zip(*moved, strict=True))
            places[:, number, axes] = _placed(values[:, columns], offsets[number, axes])
    for order, members in by_order.items():
        numbers = [number for number, _ in members]
        angles = np.deg2rad(values[:, [columns for _, columns in members]]) if order else None
        rotations[:, numbers] = _from_euler(order, angles, (len(values), len(numbers)))
    ends = np.array([joint.end or (0.0, 0.0, 0.0) for joint in joints])
    names, parents = tuple(joint.name for joint in joints), tuple(joint.parent for joint in joints)
    return BvhMotion(names, parents, offsets, ends, rotations, places, fps), remark


def _placed(channels: Float[Array, "F c"], offset: Float[Array, "c"]) -> Float[Array, "F c"]:
    """Return joint offsets: position channels replace the offset in most files; near zero they are added to it."""
    added = np.linalg.norm(np.median(channels, 0)) < _NEAR_ZERO * np.linalg.norm(offset)
    return channels + offset if added else channels


def _from_euler(
    order: tuple[int, ...], angles: Float[Array, "F M c"] | None, shape: tuple[int, int]
) -> Float[Array, "F M 4"]:
    """Compose rotations about the joint's own axes, the first channel first (it is the outermost matrix)."""
    total = np.zeros((*shape, 4))
    total[..., 0] = 1
    for channel, axis in enumerate(order):
        assert angles is not None
        turn = np.zeros((*shape, 4))
        turn[..., 0], turn[..., 1 + axis] = np.cos(angles[..., channel] / 2), np.sin(angles[..., channel] / 2)
        total = turn if channel == 0 else multiply(total, turn)
    return total


class _Hierarchy:
    """The skeleton's part of the file, word by word."""

    def __init__(self, text: str) -> None:
        self._words = [(word, line) for line, row in enumerate(text.splitlines(), 1) for word in row.split()]
        self._next = 1  # after HIERARCHY
        self.joints: list[_Joint] = []
        stack: list[int] = []
        while self._next < len(self._words):
            token, line = self._take()
            word = token.upper()
            if word in ("ROOT", "JOINT"):
                stack.append(self._open_joint(word, stack, line))
            elif word == "END":
                self._end_site(stack, line)
            elif word == "}" and stack:
                self._close(self.joints[stack.pop()], line)
            elif word == "OFFSET" and stack and self.joints[stack[-1]].offset is None:
                self.joints[stack[-1]].offset = self._numbers(3)
            elif word == "CHANNELS" and stack and self.joints[stack[-1]].channels is None:
                self.joints[stack[-1]].channels = self._channels(line)
            else:
                raise InputError(f"line {line}: {token[:40]!r} has no place there")
        if stack or not self.joints:
            raise InputError("its skeleton is not closed by }" if stack else "it has no ROOT")

    def _take(self) -> tuple[str, int]:
        if self._next >= len(self._words):
            raise InputError("its skeleton breaks off")
        self._next += 1
        return self._words[self._next - 1]

    def _open_joint(self, word: str, stack: list[int], line: int) -> int:
        words = []
        while (part := self._take())[0] != "{":
            words.append(part[0])
        name = " ".join(words)
        if not name or (word == "ROOT") != (not stack) or (word == "ROOT" and self.joints):
            raise InputError(f"line {line}: {word} {name[:40]!r} has no name, or is not where one skeleton has it")
        if len(self.joints) >= _MAX_JOINTS:
            raise InputError(f"line {line}: more than {_MAX_JOINTS} joints")
        self.joints.append(_Joint(name, stack[-1] if stack else -1))
        return len(self.joints) - 1

    def _end_site(self, stack: list[int], line: int) -> None:
        needs = InputError(f"line {line}: an End Site needs {{ OFFSET x y z }}")
        if self._take()[0].upper() != "SITE" or not stack:
            raise needs
        while self._take()[0] != "{":  # some give it a name
            pass
        if self._take()[0].upper() != "OFFSET":
            raise needs
        self.joints[stack[-1]].end = self._numbers(3)
        word, channels_line = self._take()
        if word.upper() == "CHANNELS":  # none, or they would be a joint's
            if self._channels(channels_line):
                raise needs
            word, _ = self._take()
        if word != "}":
            raise needs

    def _close(self, joint: _Joint, line: int) -> None:
        if joint.offset is None:
            raise InputError(f"line {line}: joint {joint.name[:40]!r} has no OFFSET")

    def _channels(self, line: int) -> list[str]:
        word, _ = self._take()
        if word not in {"0", "1", "2", "3", "4", "5", "6"}:
            raise InputError(f"line {line}: {word[:40]!r} is not a number of channels from 0 to 6")
        names = [self._take()[0].lower() for _ in range(int(word))]
        unknown = [name for name in names if name not in _POSITIONS and name not in _ROTATIONS]
        if unknown or len(set(names)) < len(names):
            raise InputError(
                f"line {line}: channels {' '.join(names)[:80]!r} are not X/Y/Zposition, X/Y/Zrotation once"
            )
        return names

    def _numbers(self, count: int) -> list[float]:
        taken = [self._take() for _ in range(count)]
        try:
            numbers = [float(word) for word, _ in taken]
        except ValueError:
            numbers = [np.nan]
        if not np.all(np.isfinite(numbers)) or np.abs(numbers).max() > 1e6:
            raise InputError(f"line {taken[0][1]}: {' '.join(word for word, _ in taken)[:80]!r} is not an offset")
        return numbers


def _read_motion(text: str, columns: int, first_line: int) -> tuple[Float[Array, "F C"], float, str | None]:
    """Read the table of channel values, the frame rate, and remarks for the user."""
    lines = text.split("\n")
    at = [number for number in range(1, min(len(lines), _MAX_BLANK)) if lines[number].strip()][:2]
    if len(at) < 2 or at[1] + 1 >= len(lines):
        raise InputError("its MOTION part has no frames (cut off?)")
    table = "\n".join(lines[at[1] + 1 :])
    (frames_key, _, frames_word), (time_key, _, time_word) = (lines[number].strip().rpartition(":") for number in at)
    frames_word, frames_line, time_line = frames_word.strip(), lines[at[0]].strip()[:40], lines[at[1]].strip()[:40]
    if "".join(frames_key.lower().split()) != "frames" or not frames_word.isdecimal() or len(frames_word) > 9:
        raise InputError(f"line {first_line + at[0]}: {frames_line!r} is not 'Frames: N'")
    try:
        frame_s = float(time_word)
    except ValueError:
        frame_s = np.nan
    if "".join(time_key.lower().split()) != "frametime" or not 1 / _MAX_FPS <= frame_s <= 10:
        raise InputError(f"line {first_line + at[1]}: {time_line!r} is not 'Frame Time: seconds'")
    frames = int(frames_word)
    if frames < 2:
        raise InputError(f"it has {frames} frames, a motion needs two")
    if columns == 0:
        raise InputError("its joints have no channels")
    try:
        values = np.fromstring(table, sep=" ")
    except (ValueError, DeprecationWarning):
        values = np.array([])
    rows = len(values) // columns
    if rows < frames or len(values) % columns or not np.isfinite(values).all():
        raise InputError(_why(table, frames, columns, first_line + at[1] + 1))
    remark = f"announces {frames} frames and has {rows}: all are read" if rows > frames else None
    return values.reshape(rows, columns), _frames_per_second(frame_s, len(time_word.partition(".")[2])), remark


def _why(text: str, frames: int, columns: int, first_line: int) -> str:
    """Describe the fault in the table of values by its first line."""
    rows = 0
    for number, row in enumerate(io.StringIO(text), first_line):
        words = row.split()
        if not words:
            continue
        rows += 1
        try:
            values = [float(word) for word in words]
        except ValueError:
            return f"line {number}: {row.strip()[:40]!r} is not a row of numbers"
        if not np.all(np.isfinite(values)):
            return f"line {number}: a value is not finite"
        if len(words) != columns:
            return f"line {number} has {len(words)} values, its joints have {columns} channels"
    return f"it announces {frames} frames and has {rows} (cut off?)"


def _frames_per_second(frame_s: float, digits: int) -> float:
    """Return the frame rate; files round a frame's time (.0083333 s, .033 s), so rates that explain it are used.

    Args:
        frame_s: time of a frame [s].
        digits: digits behind the point that the file gives it.
    """
    fps = 1 / frame_s
    if abs(fps - round(fps)) < 3e-4 * fps:
        return float(round(fps))
    return next((rate for rate in _USUAL_RATES if round(1 / rate, digits) == frame_s), fps)
