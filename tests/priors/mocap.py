"""Real poses for the tests: CMU motion capture (BVH), retargeted to the SMPL layout.

For the 120 fps files only: their rest pose is a T-pose with world-aligned joint frames, as SMPL's is. Their arms are
rebuilt from the directions of the bones, since that skeleton bends its elbows about axes of its own.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hfb.body.skeleton import PARENTS

FOLDER = Path(__file__).parents[3] / "shared" / "data" / "cmu_bvh"

_BONES = {
    0: "hip", 1: "lThigh", 2: "rThigh", 3: "abdomen", 4: "lShin", 5: "rShin", 7: "lFoot", 8: "rFoot", 9: "chest",
    12: "neck", 13: "lCollar", 14: "rCollar", 15: "head", 16: "lShldr", 17: "rShldr", 18: "lForeArm",
    19: "rForeArm", 20: "lHand", 21: "rHand",
}  # fmt: skip
_LEGS = {1: "lShin", 2: "rShin", 4: "lFoot", 5: "rFoot"}


def read_bvh(path: Path) -> tuple[dict[str, Rotation], dict[str, np.ndarray]]:
    """World rotation of every joint over time, and every joint's offset from its parent."""
    header, motion = path.read_text().split("MOTION")
    offsets, channels, parent, stack = {}, {}, {}, []
    words = iter(header.split())
    for word in words:
        if word in ("ROOT", "JOINT", "End"):
            name = next(words)
            parent[name] = stack[-1] if stack else None
            stack.append(name)
        elif word == "OFFSET":
            offsets[stack[-1]] = np.array([float(next(words)) for _ in range(3)])
        elif word == "CHANNELS":
            channels[stack[-1]] = [next(words) for _ in range(int(next(words)))]
        elif word == "}":
            stack.pop()
    values = np.array([line.split() for line in motion.strip().splitlines()[2:]], dtype=float)
    world, column = {}, 0
    for name, kinds in channels.items():
        angles = values[:, column : column + len(kinds)][:, [kind.endswith("rotation") for kind in kinds]]
        column += len(kinds)
        order = "".join(kind[0] for kind in kinds if kind.endswith("rotation"))
        local = Rotation.from_euler(order, angles, degrees=True)
        world[name] = world[parent[name]] * local if parent[name] else local
    return world, offsets


def _between(source: np.ndarray, target: np.ndarray) -> Rotation:
    """The smallest rotation from one direction to another."""
    source, target = source / np.linalg.norm(source), target / np.linalg.norm(target)
    axis, cosine = np.cross(source, target), source @ target
    return Rotation.from_rotvec(axis * np.arctan2(np.linalg.norm(axis), cosine) / max(np.linalg.norm(axis), 1e-9))


def smpl_poses(path: Path) -> np.ndarray:
    """Axis-angle (R, 24, 3) of the frames whose elbows are bent enough to tell how the upper arm is turned."""
    bones, offsets = read_bvh(path)
    world = {joint: bones[name] for joint, name in _BONES.items()}
    for joint, child in _LEGS.items():  # this skeleton's legs are not straight at rest, SMPL's are nearly so
        world[joint] = world[joint] * _between(np.array([0.0, -1.0, 0.0]), offsets[child])
    # One rotation of this skeleton's back and neck stands for two or three of SMPL's.
    world[6] = world[3] * _fraction(world[3].inv() * world[9], 0.5)
    bend = world[0].inv() * world[9]
    world[3], world[6] = world[0] * _fraction(bend, 1 / 3), world[0] * _fraction(bend, 2 / 3)
    world[12] = world[9] * _fraction(world[9].inv() * world[15], 0.5)
    bent = np.ones(len(bones["hip"]), dtype=bool)
    for side, sign, shoulder in (("l", 1, 16), ("r", -1, 17)):
        upper = bones[f"{side}Shldr"].apply(offsets[f"{side}ForeArm"])
        fore = bones[f"{side}ForeArm"].apply(offsets[f"{side}Hand"])
        bent &= _rebuild_arm(world, upper, fore, sign, shoulder)
    for joint in (10, 11, 22, 23):
        world[joint] = world[PARENTS[joint]]
    local = [(world[PARENTS[j]].inv() * world[j] if j else world[0]).as_rotvec() for j in range(24)]
    return np.stack(local, 1)[bent]


def _fraction(rotation: Rotation, share: float) -> Rotation:
    return Rotation.from_rotvec(share * rotation.as_rotvec())


def _rebuild_arm(world: dict, upper: np.ndarray, fore: np.ndarray, sign: int, shoulder: int) -> np.ndarray:
    """Shoulder and elbow from the two bones: the elbow is a hinge, half the hand's turn happens in the forearm."""
    upper = upper / np.linalg.norm(upper, axis=1, keepdims=True)
    fore = fore / np.linalg.norm(fore, axis=1, keepdims=True)
    cosine = (upper * fore).sum(1)
    forward = fore - cosine[:, None] * upper
    sine = np.linalg.norm(forward, axis=1)
    forward = forward / np.maximum(sine, 1e-6)[:, None]
    left = sign * upper
    world[shoulder] = Rotation.from_matrix(np.stack([left, np.cross(forward, left), forward], -1))
    flexion = -sign * np.arctan2(sine, cosine)
    elbow = world[shoulder] * Rotation.from_rotvec(flexion[:, None] * np.array([0.0, 1.0, 0.0]))
    turn = (elbow.inv() * world[shoulder + 4]).as_quat()
    twist = 2 * np.arctan2(turn[:, 0] * np.sign(turn[:, 3]), np.abs(turn[:, 3]))
    world[shoulder + 2] = elbow * Rotation.from_rotvec(twist[:, None] / 2 * np.array([1.0, 0.0, 0.0]))
    return sine > 0.35
