"""The skeleton of the SMPL layout: 24 joints, their parents, their mirror images and the bones between them."""

JOINT_NAMES: tuple[str, ...] = (
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hand",
    "right_hand",
)
"""Names in SMPL's order; "left" is the person's own left, +x in the rest pose."""

PARENTS: tuple[int, ...] = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
"""Parent of every joint; -1 for the root. A parent comes before its children."""

PARENT_OR_SELF: tuple[int, ...] = tuple(max(parent, 0) for parent in PARENTS)
"""The same with the root as its own parent, whose bone has no length."""

JOINT_COUNT: int = len(PARENTS)

BONES: tuple[tuple[int, int], ...] = tuple((parent, child) for child, parent in enumerate(PARENTS) if parent >= 0)
"""(parent, child) joints of the 23 bones."""

MIRROR: tuple[int, ...] = (0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22)
"""``MIRROR[j]`` is the joint on the other side of the body; joints of the spine mirror themselves."""

H36M_14: tuple[int, ...] = (8, 5, 2, 1, 4, 7, 21, 19, 17, 16, 18, 20, 12, 15)
"""The 14 joints that Human3.6M-style protocols evaluate, as SMPL joints, in their usual order: right ankle, knee, hip,
left hip, knee, ankle, right wrist, elbow, shoulder, left shoulder, elbow, wrist, neck, head. SMPL's own joints stand
in for the regressed ones (the head is the joint at the skull's base, not its top)."""


def _ancestors_by_doubling() -> tuple[tuple[int, ...], ...]:
    """Return, for every round k, the joint 2**k steps up the tree; ``JOINT_COUNT`` stands for "above the root".

    Multiplying every joint's transform by that of its ancestor at distance 1, 2, 4, 8 composes the whole chain
    in four batched products instead of 24 single ones.
    """
    above = [parent if parent >= 0 else JOINT_COUNT for parent in PARENTS] + [JOINT_COUNT]
    rounds = []
    while any(joint != JOINT_COUNT for joint in above):
        rounds.append(tuple(above))
        above = [above[joint] for joint in above]
    return tuple(rounds)


ANCESTORS_BY_DOUBLING: tuple[tuple[int, ...], ...] = _ancestors_by_doubling()
"""See `_ancestors_by_doubling`; each round has ``JOINT_COUNT + 1`` entries."""
