"""Correspondence of a foreign skeleton's joints to SMPL's: limbs and head by name, the trunk by its chain."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hfb.errors import InputError

_LIMBS: dict[str, tuple[str, ...]] = {
    "hip": ("thigh", "thighbend", "upleg", "upperleg", "upperleg01", "femur", "hip"),
    "knee": ("shin", "calf", "leg", "lowerleg", "lowerleg01", "lowleg", "knee", "tibia"),
    "ankle": ("ankle", "foot"),
    "shoulder": ("shldr", "shldrbend", "upperarm", "upperarm01", "uparm", "uarm", "arm", "humerus", "shoulder"),
    "elbow": ("forearm", "forearmbend", "lowerarm", "lowerarm01", "lowarm", "farm", "elbow", "radius"),
    "wrist": ("wrist", "hand"),
}
"""What a limb's joint is called, without its side; the first that the skeleton has counts.

Seen in: CMU's database by cgspeed for Daz figures (lThigh, lShldr) and for MotionBuilder (LeftUpLeg, LeftArm), iClone's
Character Creator (CC_Base_L_Thigh), Mixamo (mixamorig:LeftUpLeg), 3ds Max' Biped (Bip01 L Thigh), Unreal (thigh_l),
Vicon's and others' LeftHip / LeftKnee / LeftAnkle, OptiTrack (LThigh, LUArm, LFArm), Bandai-Namco (UpperLeg_L), Blender
(upper_arm.L), SMPL (L_Ankle with L_Foot for the toes: an ankle is one, and a foot the next joint; m_avg_L_Ankle in its
own FBX), DeepMotion (l_upleg_JNT), MakeHuman (upperleg01.L).
"""

_HEAD = ("head", "skull", "spine006", "neck1", "neck")
_TOE = ("toe", "toebase", "toes", "toe0", "ball", "foot")
_PREFIX = re.compile(
    r"^(mixamorig\d*|ccbase|valvebipedbip\d+|jbip[clr]?(?=[lr]?[a-z]{4})|bip\d+|bip|character\d*|def|org)(?=[a-z])"
)
_OF_ALL = 0.8
_SEPARATORS = re.compile(r"[_:|. -]")


@dataclass(frozen=True)
class JointMap:
    """Numbers of a skeleton's joints; None where it has none of that kind.

    Attributes:
        limbs: by SMPL's name (`left_knee`).
        pelvis: the joint that both legs and the trunk hang from.
        chest: the one that both arms hang from.
        collars: parent of each shoulder, where it moves relative to the chest.
    """

    pelvis: int
    chest: int
    head: int
    limbs: dict[str, int]
    collars: dict[str, int | None]
    toes: dict[str, int | None]


def map_joints(names: Sequence[str], parents: Sequence[int]) -> JointMap:
    """Find a person's joints in a skeleton.

    Args:
        names: names of the skeleton's joints.
        parents: number of each joint's parent, -1 for the root.

    Raises:
        InputError: some are missing; the text names them.
    """
    known: dict[str, int] = {}
    for spelling in (names, _without_shared(names)):
        for number, name in enumerate(spelling):
            known.setdefault(_normal(name), number)
    limbs: dict[str, int] = {}
    missing = []
    for side in ("left", "right"):
        for part, aliases in _LIMBS.items():
            found = _find(known, [sided for alias in aliases for sided in _sided(side, alias)])
            if found is None:
                missing.append(f"{side} {part}")
            else:
                limbs[f"{side}_{part}"] = found
    head = _find(known, _HEAD)
    if head is None:
        missing.append("head")
    if missing or head is None:
        raise InputError(
            f"its skeleton has no joint known as {', '.join(missing)} (its joints are {', '.join(names)[:300]}); "
            "rename them as Mixamo or CMU do (LeftUpLeg, LeftLeg, LeftFoot, LeftArm, LeftForeArm, LeftHand, Head)"
        )
    above = [_chain(parents, number) for number in range(len(names))]
    for side in ("left", "right"):
        for chain in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist")):
            numbers = [limbs[f"{side}_{part}"] for part in chain]
            if numbers[0] not in above[numbers[1]] or numbers[1] not in above[numbers[2]]:
                raise InputError(f"its {side} {', '.join(chain)} do not hang from one another")
    chest = _common(above, limbs["left_shoulder"], limbs["right_shoulder"])
    pelvis = _common(above, _common(above, limbs["left_hip"], limbs["right_hip"]), chest)
    collars: dict[str, int | None] = {}
    toes: dict[str, int | None] = {}
    for side in ("left", "right"):
        over = parents[limbs[f"{side}_shoulder"]]
        collars[side] = over if over not in (chest, -1) else None
        toe = _find(known, [sided for alias in _TOE for sided in _sided(side, alias)])
        toes[side] = toe if toe != limbs[f"{side}_ankle"] else None
    return JointMap(pelvis, chest, head, limbs, collars, toes)


def _without_shared(names: Sequence[str]) -> list[str]:
    """Remove words that nearly all names begin or end with: a subject's, an armature's, "m_avg_", "_JNT"."""
    words = [_SEPARATORS.split(name) for name in names]
    for end, kept in ((0, slice(1, None)), (-1, slice(-1))):
        count = len(names)
        while count:
            counts = Counter(one[end] for one in words if len(one) > 1).most_common(1)
            shared, count = next((found for found in counts if found[1] >= _OF_ALL * len(names)), ("", 0))
            words = [one[kept] if len(one) > 1 and one[end] == shared else one for one in words]
    return ["_".join(one) for one in words]


def _normal(name: str) -> str:
    """Normalise a name: no name space, prefix, case or punctuation."""
    plain = re.sub(r"[^a-z0-9]", "", re.split(r"[:|]", name)[-1].lower())
    return _PREFIX.sub("", plain)


def _sided(side: str, part: str) -> tuple[str, ...]:
    return (f"{side[0]}{part}", f"{side}{part}", f"{part}{side[0]}", f"{part}{side}")


def _find(known: dict[str, int], aliases: Sequence[str]) -> int | None:
    return next((known[alias] for alias in aliases if alias in known), None)


def _chain(parents: Sequence[int], joint: int) -> list[int]:
    """Return the joint and all its ancestors."""
    chain = [joint]
    while parents[chain[-1]] >= 0:
        chain.append(parents[chain[-1]])
    return chain


def _common(above: Sequence[Sequence[int]], first: int, second: int) -> int:
    """Return the lowest common ancestor of two joints."""
    return next(joint for joint in above[first] if joint in above[second])
