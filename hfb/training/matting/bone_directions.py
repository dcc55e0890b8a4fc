"""Mocap for the matting images: bone directions of any BVH skeleton, transferred to the SMPL layout.

Only silhouettes are rendered, so a limb takes the smallest rotation to its direction; its twist is not recovered.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hfb.typing import Array, Float

# Our name -> the joint's name in the two families of files.
_NAMES = {
    "hips": ("CC_Base_Hip", "hip"),
    "neck": ("CC_Base_NeckTwist01", "neck"),
    "head": ("CC_Base_Head", "head"),
    "left_hip": ("CC_Base_L_Thigh", "lThigh"),
    "left_knee": ("CC_Base_L_Calf", "lShin"),
    "left_ankle": ("CC_Base_L_Foot", "lFoot"),
    "left_toe": ("CC_Base_L_ToeBase", "lFoot_end"),
    "left_shoulder": ("CC_Base_L_Upperarm", "lShldr"),
    "left_elbow": ("CC_Base_L_Forearm", "lForeArm"),
    "left_wrist": ("CC_Base_L_Hand", "lHand"),
}
_NAMES |= {
    ours.replace("left", "right"): (cc.replace("_L_", "_R_"), "r" + daz[1:])
    for ours, (cc, daz) in _NAMES.items()
    if ours.startswith("left")
}
_METRES = 0.01  # the files are in centimetres


@dataclass(frozen=True)
class Recording:
    """Joint positions of a recording: name -> (F, 3) [m], y up."""

    name: str
    subject: int
    fps: float
    joints: dict[str, Float[Array, "F 3"]]

    @property
    def seconds(self) -> float:
        """Duration from the first to the last frame."""
        return (len(self.joints["hips"]) - 1) / self.fps


def read_recording(path: Path) -> Recording:
    """Compute joint positions of a BVH file by forward kinematics.

    Args:
        path: the file, in centimetres.
    """
    header, motion = path.read_text().split("MOTION")
    offsets, channels, parents = _hierarchy(header)
    lines = motion.strip().splitlines()
    fps = 1 / float(lines[1].split(":")[1])
    values = np.array([line.split() for line in lines[2:]], dtype=float)
    turns: dict[str, Rotation] = {}
    places: dict[str, np.ndarray] = {}
    column = 0
    for name, parent in parents.items():
        kinds = channels.get(name, [])
        mine = values[:, column : column + len(kinds)]
        column += len(kinds)
        move = mine[:, [kind.endswith("position") for kind in kinds]]
        angles = mine[:, [kind.endswith("rotation") for kind in kinds]]
        if parent is None:
            places[name] = move + offsets[name]
        else:
            places[name] = places[parent] + turns[parent].apply(offsets[name])
        if kinds:
            local = Rotation.from_euler("".join(kind[0] for kind in kinds if kind.endswith("rotation")), angles, True)
            turns[name] = local if parent is None else turns[parent] * local
    joints = {ours: places[next(name for name in names if name in places)] * _METRES for ours, names in _NAMES.items()}
    return Recording(path.stem, int(path.stem.split("_")[1]), fps, joints)


def _hierarchy(header: str) -> tuple[dict[str, np.ndarray], dict[str, list[str]], dict[str, str | None]]:
    offsets: dict[str, np.ndarray] = {}
    channels: dict[str, list[str]] = {}
    parents: dict[str, str | None] = {}
    stack: list[str] = []
    words = iter(header.split())
    for word in words:
        if word in ("ROOT", "JOINT", "End"):
            name = next(words)
            name = f"{stack[-1]}_end" if word == "End" else name
            parents[name] = stack[-1] if stack else None
            stack.append(name)
        elif word == "OFFSET":
            offsets[stack[-1]] = np.array([float(next(words)) for _ in range(3)])
        elif word == "CHANNELS":
            channels[stack[-1]] = [next(words) for _ in range(int(next(words)))]
        elif word == "}":
            stack.pop()
    return offsets, channels, parents


def poses_at(
    recording: Recording, times_s: Float[Array, "S"], rest: Float[Array, "24 3"]
) -> tuple[Float[Array, "S 24 3 3"], Float[Array, "S 3"]]:
    """Return rotations in the SMPL layout (local, the root's in the y-up world) and the pelvis' position [m].

    Args:
        recording: joint positions.
        times_s: instants since the first frame.
        rest: joints of the body in its rest pose [m].
    """
    clock = np.arange(len(recording.joints["hips"])) / recording.fps
    at = {
        name: np.stack([np.interp(times_s, clock, place[:, axis]) for axis in range(3)], -1)
        for name, place in recording.joints.items()
    }
    world = np.tile(np.eye(3), (len(times_s), 24, 1, 1))
    middle = (at["left_hip"] + at["right_hip"]) / 2
    world[:, 0] = _frame(at["left_hip"] - at["right_hip"], at["neck"] - middle)
    chest = _frame(at["left_shoulder"] - at["right_shoulder"], at["neck"] - middle)
    bend = (Rotation.from_matrix(world[:, 0]).inv() * Rotation.from_matrix(chest)).as_rotvec()
    for joint, share in ((3, 1 / 3), (6, 2 / 3), (9, 1.0)):
        world[:, joint] = world[:, 0] @ Rotation.from_rotvec(share * bend).as_matrix()
    world[:, 12] = _swing(world[:, 9], rest[15] - rest[12], at["head"] - at["neck"])
    world[:, 15] = world[:, 12]
    for side, (hip, knee, ankle, foot, collar, shoulder, elbow, wrist, hand) in (
        ("left", (1, 4, 7, 10, 13, 16, 18, 20, 22)),
        ("right", (2, 5, 8, 11, 14, 17, 19, 21, 23)),
    ):
        chain = (
            (hip, 0, knee, "hip", "knee"),
            (knee, hip, ankle, "knee", "ankle"),
            (ankle, knee, foot, "ankle", "toe"),
            (shoulder, 9, elbow, "shoulder", "elbow"),
            (elbow, shoulder, wrist, "elbow", "wrist"),
        )
        for joint, parent, child, start, end in chain:
            bone = at[f"{side}_{end}"] - at[f"{side}_{start}"]
            world[:, joint] = _swing(world[:, parent], rest[child] - rest[joint], bone)
        world[:, collar], world[:, foot] = world[:, 9], world[:, ankle]
        world[:, wrist] = world[:, hand] = world[:, elbow]
    parents = np.array([0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21])
    local = world[:, parents].swapaxes(-1, -2) @ world
    local[:, 0] = world[:, 0]
    return local, at["hips"]


def _frame(left: Float[Array, "S 3"], up: Float[Array, "S 3"]) -> Float[Array, "S 3 3"]:
    x = left / np.linalg.norm(left, axis=-1, keepdims=True)
    y = up - (up * x).sum(-1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], -1)


def _swing(parent: Float[Array, "S 3 3"], rest: Float[Array, "3"], bone: Float[Array, "S 3"]) -> Float[Array, "S 3 3"]:
    """Return the parent's rotation followed by the smallest rotation of the rest bone to its direction."""
    source = parent @ (rest / np.linalg.norm(rest))
    target = bone / np.maximum(np.linalg.norm(bone, axis=-1, keepdims=True), 1e-9)
    axis = np.cross(source, target)
    sine, cosine = np.linalg.norm(axis, axis=-1, keepdims=True), (source * target).sum(-1, keepdims=True)
    turn = Rotation.from_rotvec(axis / np.maximum(sine, 1e-9) * np.arctan2(sine, cosine))
    return turn.as_matrix() @ parent
