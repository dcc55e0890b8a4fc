"""Movements as anatomical key poses, from which the built-in motions are made.

Angles in degrees from standing upright with hanging arms: a thigh or an arm goes `forward`, `out` to its side and is
`turn`-ed outwards; a knee and an elbow bend; toes go `up`; the trunk bends forward, leans to its left, turns to its
left, and so does the head. The pelvis pitches forward, rolls to its left and turns to its left; `hop` is the height
of the feet above the ground [m].

`data/movements.txt`: a movement has a name, the length of a cycle, and its key poses: the relative time until the next
one, and the angles that differ from standing. `mirrored`: the second half of the cycle is the first with left and
right exchanged. `turning`: degrees that the body has turned to its left after a cycle. A limb's word without l_ or r_
means both. `data/stances.txt`: base poses of the other poses; guard and crouch are themselves changes of standing.
"""

import re
from dataclasses import dataclass, field
from importlib import resources

_TRUNK = ("bend", "lean", "twist", "nod", "tilt", "look", "pitch", "roll", "yaw", "hop")
_LIMB = ("hip", "out", "turn", "knee", "toes", "arm", "wide", "spin", "elbow", "palm")

CHANNELS: tuple[str, ...] = (*_TRUNK, *(f"l_{name}" for name in _LIMB), *(f"r_{name}" for name in _LIMB))
"""Trunk, left limbs, right limbs; hip/arm are the angles forward, out/wide to the side, turn/spin about the bone."""

SIDED: tuple[int, ...] = tuple(CHANNELS.index(name) for name in ("lean", "twist", "tilt", "look", "roll", "yaw"))
"""Channels whose sign a mirror changes."""

TRUNK_COUNT: int = len(_TRUNK)
LIMB_COUNT: int = len(_LIMB)
LEG_CHANNELS: tuple[int, ...] = tuple(
    CHANNELS.index(name)
    for name in ("pitch", "roll", "yaw", "hop", *(f"{side}_{part}" for side in "lr" for part in _LIMB[:5]))
)

RANGES: dict[str, tuple[float, float]] = {
    "bend": (-35, 90), "lean": (-45, 45), "twist": (-55, 55), "nod": (-40, 50), "tilt": (-35, 35), "look": (-60, 60),
    "pitch": (-40, 60), "roll": (-35, 35), "yaw": (-1e4, 1e4), "hop": (0, 0.7), "hip": (-24, 115), "out": (-20, 55),
    "turn": (-30, 40), "knee": (1, 138), "toes": (-42, 28), "arm": (-50, 150), "wide": (-35, 150), "spin": (-60, 60),
    "elbow": (2, 142), "palm": (-60, 60),
}  # fmt: skip
"""Ranges of motion, well within those of `hfb.priors.anatomy`."""


@dataclass(frozen=True)
class Gesture:
    """One cycle of a movement.

    Attributes:
        seconds: length of a cycle.
        keys: (share of the cycle until the next key, the pose as differences from standing).
        mirrored: the second half of the cycle is the first one with left and right exchanged.
        turning: degrees that the body has turned to its left after a cycle.
    """

    name: str
    seconds: float
    keys: tuple[tuple[float, dict[str, float]], ...] = field(repr=False)
    mirrored: bool = False
    turning: float = 0.0


def _read_pose(text: str) -> dict[str, float]:
    """Parse a pose channel by channel; a first word without a number is a stance, a limb without a side means both."""
    pose: dict[str, float] = {}
    for item in text.split(","):
        word, _, number = item.strip().partition(" ")
        if not number:
            pose |= _STANCES[word]
            continue
        pose |= dict.fromkeys((word,) if word in CHANNELS else (f"l_{word}", f"r_{word}"), float(number))
    return pose


def _read_lines(name: str) -> list[str]:
    """Read a file of this package, lines joined with their continuations."""
    text = (resources.files("hfb.datasets.motions.built_in") / "data" / name).read_text(encoding="utf-8")
    return re.sub(r"\n {8,}", " ", text).splitlines()


def _read_movements() -> tuple[Gesture, ...]:
    """Parse the movements, in the file's order."""
    heads: list[str] = []
    keys: list[list[tuple[float, dict[str, float]]]] = []
    for line in _read_lines("movements.txt"):
        if line.startswith("  "):
            share, _, pose = line.partition("|")
            keys[-1].append((float(share), _read_pose(pose)))
        else:
            heads.append(line)
            keys.append([])
    gestures = []
    for head, poses in zip(heads, keys, strict=True):
        name, _, rest = head.partition(":")
        seconds, *options = (part.strip() for part in rest.split(","))
        turning = sum(float(option.removeprefix("turning ")) for option in options if option.startswith("turning "))
        gestures.append(Gesture(name, float(seconds.removesuffix(" s")), tuple(poses), "mirrored" in options, turning))
    return tuple(gestures)


_STANCES: dict[str, dict[str, float]] = {}
for _line in _read_lines("stances.txt"):
    _name, _, _text = _line.partition(" | ")
    _STANCES[_name] = _read_pose(_text)

STANDING: dict[str, float] = _STANCES["stand"]
GESTURES: tuple[Gesture, ...] = _read_movements()
