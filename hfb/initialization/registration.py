"""Registration of the body to 33 landmarks: pose, translation and a little shape, in camera coordinates.

The body's joints and a few surface points (nose, ears, heels, toes) are fitted to the landmarks: their pixels determine
positions in the image, the metric landmarks the directions of bones, an anatomical prior the rest.
"""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.model import Body, ShapedBody
from hfb.body.skeleton import JOINT_NAMES, PARENTS
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.procrustes import nearest_rotations
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.landmarks import LANDMARK, Landmarks
from hfb.motion.static_pose import FirstBody
from hfb.priors.anatomy import AnatomicalPrior
from hfb.typing import Float, Int, Tensor

_SAME_JOINTS = tuple(
    f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")
)
# Directions that are compared in 3D, with weights: long bones well seen by the network count more.
_DIRECTIONS = (
    ("left_hip", "right_hip", 1.0),
    ("left_shoulder", "right_shoulder", 1.0),
    ("left_hip", "left_shoulder", 1.0),
    ("right_hip", "right_shoulder", 1.0),
    ("left_shoulder", "left_elbow", 1.0),
    ("left_elbow", "left_wrist", 1.0),
    ("right_shoulder", "right_elbow", 1.0),
    ("right_elbow", "right_wrist", 1.0),
    ("left_hip", "left_knee", 1.0),
    ("left_knee", "left_ankle", 1.0),
    ("right_hip", "right_knee", 1.0),
    ("right_knee", "right_ankle", 1.0),
    ("left_heel", "left_foot_index", 0.4),
    ("right_heel", "right_foot_index", 0.4),
    ("left_ear", "nose", 0.3),
    ("right_ear", "nose", 0.3),
    ("left_ear", "right_ear", 0.3),
)
_TRUNK = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
_LEAST_DEPTH_M = 0.5


@dataclass(frozen=True)
class Attachments:
    """Positions of the landmarks on a body: joint plus offset [m] in the joint's rest frame."""

    landmarks: Int[Tensor, "L"]
    joints: Int[Tensor, "L"]
    offsets: Float[Tensor, "L 3"]
    weights: Float[Tensor, "L"]

    def positions(self, joints: Float[Tensor, "24 3"], R_world_joint: Float[Tensor, "24 3 3"]) -> Float[Tensor, "L 3"]:
        """Return the points [m] on a posed body.

        Args:
            joints: joints of the posed body [m].
            R_world_joint: rotation of every joint.
        """
        return joints[self.joints] + (R_world_joint[self.joints] @ self.offsets[..., None]).squeeze(-1)


def attach_landmarks(shaped: ShapedBody) -> Attachments:
    """Find nose, ears, heels and toes on the rest pose: extreme points of the parts that head and feet move.

    Args:
        shaped: the body with its shape.
    """
    owner = shaped.body.skinning_weights.argmax(1)
    rows: list[tuple[str, str, Tensor, float]] = [
        (name, name, shaped.joints.new_zeros(3), 1.0) for name in _SAME_JOINTS
    ]

    def extreme(parts: tuple[str, ...], axis: int, sign: float) -> Tensor:
        members = torch.isin(owner, torch.tensor([JOINT_NAMES.index(part) for part in parts]))
        points = shaped.vertices[members]
        return points[(points[:, axis] * sign).argmax()]

    def add(landmark: str, joint: str, point: Tensor, weight: float) -> None:
        rows.append((landmark, joint, point - shaped.joints[JOINT_NAMES.index(joint)], weight))

    add("nose", "head", extreme(("head",), 2, 1), 0.5)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        add(f"{side}_ear", "head", extreme(("head",), 0, sign), 0.5)
        foot = (f"{side}_ankle", f"{side}_foot")
        add(f"{side}_heel", f"{side}_ankle", extreme(foot, 2, -1), 0.5)
        add(f"{side}_foot_index", f"{side}_ankle", extreme(foot, 2, 1), 0.5)
    names, joints, offsets, weights = zip(*rows, strict=True)
    return Attachments(
        torch.tensor([LANDMARK[name] for name in names]),
        torch.tensor([JOINT_NAMES.index(name) for name in joints]),
        torch.stack(list(offsets)).detach(),
        shaped.joints.new_tensor(weights),
    )


def register(
    landmarks: Landmarks, camera: PinholeCamera, body: Body, iterations: int = 150, source: str = "mediapipe"
) -> FirstBody:
    """Lay the body onto the landmarks.

    Minimises, over root and joint rotations, translation and betas (Adam, deterministic): robust reprojection in
    units of the trunk, 1 - cosine of the directions between landmarks, the anatomical prior and |betas|^2. A
    landmark counts as much as the network is sure to see it.

    Args:
        landmarks: landmarks of the person.
        camera: camera of the image.
        body: the body model.
        iterations: number of Adam's iterations.
        source: recorded in the result.
    """
    dtype = body.template.dtype
    betas = torch.zeros(body.shape_count, dtype=dtype)
    shaped = body.shape(betas)
    attachments = attach_landmarks(shaped)
    pixels = torch.as_tensor(landmarks.pixels, dtype=dtype)
    world = torch.as_tensor(world_in_camera(landmarks, camera), dtype=dtype)
    sure = torch.as_tensor(landmarks.visibility, dtype=dtype).clamp(0.05, 1)
    R_root = _first_root(shaped, attachments, world)
    translation = _first_translation(shaped, camera, world, pixels, sure)
    # The optimised root turn is relative to the first guess: no wrap-around at pi, where upright people are.
    free_pose = torch.cat([torch.zeros(1, 3, dtype=dtype), natural_pose(dtype)])
    variables = [free.requires_grad_() for free in (free_pose, translation, betas)]
    optimiser = torch.optim.Adam(
        [{"params": [free], "lr": rate} for free, rate in zip(variables, (0.05, 0.02, 0.02), strict=True)]
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations, 0.002)
    prior = AnatomicalPrior()
    targets = _targets(pixels, world, sure)
    for _ in range(iterations):
        optimiser.zero_grad()
        rotations = axis_angle_to_matrix(free_pose)
        rotations = torch.cat([(rotations[0] @ R_root)[None], rotations[1:]])
        rest = body.joint_template + body.joint_shape_directions @ betas
        points = attachments.positions(*follow_chain(rest, rotations, translation))
        loss = _misfit(points, attachments, camera, targets)
        loss = loss + 0.03 * prior(free_pose[None, 1:])[0] + 0.5 * (betas * betas).sum()
        loss.backward()
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        final = free_pose.clone()
        final[0] = matrix_to_axis_angle(axis_angle_to_matrix(free_pose[0]) @ R_root)
    return FirstBody(final.detach(), translation.detach(), betas.detach(), source)


def world_in_camera(landmarks: Landmarks, camera: PinholeCamera) -> Float[np.ndarray, "33 3"]:
    """Rotate the metric landmarks from "along the region's view ray" to "along the optical axis".

    Args:
        landmarks: landmarks of the person.
        camera: camera of the image.
    """
    ray = np.array([(landmarks.region.x - camera.cx) / camera.fx, (landmarks.region.y - camera.cy) / camera.fy, 1.0])
    ray /= np.linalg.norm(ray)
    cross = np.cross([0.0, 0.0, 1.0], ray)
    x, y, z = cross
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R_camera_ray = np.eye(3) + skew + skew @ skew / (1 + ray[2])
    return landmarks.world @ R_camera_ray.T


def natural_pose(dtype: torch.dtype) -> Float[Tensor, "23 3"]:
    """Return a pose with arms down and knees hardly bent: nearer to most poses than the rest pose T.

    Args:
        dtype: precision of the result.
    """
    pose = torch.zeros(24, 3, dtype=dtype)
    for name, value in {
        "left_shoulder": (0, 0, -1.0), "right_shoulder": (0, 0, 1.0), "left_elbow": (0, -0.4, 0),
        "right_elbow": (0, 0.4, 0), "left_knee": (0.2, 0, 0), "right_knee": (0.2, 0, 0),
    }.items():  # fmt: skip
        pose[JOINT_NAMES.index(name)] = torch.tensor(value, dtype=dtype)
    return pose[1:]


def _first_root(shaped: ShapedBody, attachments: Attachments, world: Float[Tensor, "33 3"]) -> Float[Tensor, "3 3"]:
    """Return the rotation of the rest trunk (shoulders, hips) that fits the landmarks' trunk best (Kabsch)."""
    rest = torch.stack([shaped.joints[JOINT_NAMES.index(name)] for name in _TRUNK])
    seen = torch.stack([world[LANDMARK[name]] for name in _TRUNK])
    rest, seen = rest - rest.mean(0), seen - seen.mean(0)
    # A trunk is nearly flat: its normal, added as a point, decides the front.
    rest, seen = (torch.cat([p, _trunk_normal(p)[None]]) for p in (rest, seen))
    return nearest_rotations((seen.T @ rest)[None])[0]


def _trunk_normal(points: Float[Tensor, "4 3"]) -> Float[Tensor, "3"]:
    left_shoulder, right_shoulder, left_hip, right_hip = points
    across = left_shoulder + left_hip - right_shoulder - right_hip
    up = left_shoulder + right_shoulder - left_hip - right_hip
    normal = torch.linalg.cross(across, up)
    return 0.3 * normal / normal.norm().clamp_min(1e-6)


def _first_translation(
    shaped: ShapedBody,
    camera: PinholeCamera,
    world: Float[Tensor, "33 3"],
    pixels: Float[Tensor, "33 2"],
    sure: Float[Tensor, "33"],
) -> Float[Tensor, "3"]:
    """Return the position of a body of this size that appears at these pixels: linear in the translation.

    For every landmark f (X + t_x) = (u - c_x) (Z + t_z), and the same for y, weighted by certainty.
    """
    chosen = [LANDMARK[name] for name in _SAME_JOINTS]
    joints = [JOINT_NAMES.index(name) for name in _SAME_JOINTS]
    rest = shaped.joints[joints]
    size = _spread(rest[[0, 1, 6, 7]]) / _spread(world[chosen][[0, 1, 6, 7]]).clamp_min(1e-3)
    points, weight = world[chosen] * size, sure[chosen].sqrt()
    slope = (pixels[chosen] - pixels.new_tensor([camera.cx, camera.cy])) / pixels.new_tensor([camera.fx, camera.fy])
    zero, one = torch.zeros_like(weight), torch.ones_like(weight)
    rows_x = torch.stack([one, zero, -slope[:, 0]], 1) * weight[:, None]
    rows_y = torch.stack([zero, one, -slope[:, 1]], 1) * weight[:, None]
    right_x = (slope[:, 0] * points[:, 2] - points[:, 0]) * weight
    right_y = (slope[:, 1] * points[:, 2] - points[:, 1]) * weight
    rows, right = torch.cat([rows_x, rows_y]).double(), torch.cat([right_x, right_y]).double()
    # Normal equations, summed without a library's kernels: LAPACK's least squares differ in the last bit by run.
    normal = (rows[:, :, None] * rows[:, None, :]).sum(0)
    hips = torch.linalg.solve(normal, (rows * right[:, None]).sum(0)).to(points)
    if hips[2] < _LEAST_DEPTH_M:
        hips = hips * (_LEAST_DEPTH_M / hips[2]) if hips[2] > 1e-3 else hips.new_tensor([0.0, 0.0, 3.0])
    middle = (shaped.joints[JOINT_NAMES.index("left_hip")] + shaped.joints[JOINT_NAMES.index("right_hip")]) / 2
    # The root turns about its own joint; the hips' middle is close to it.
    return hips - middle


def _spread(points: Float[Tensor, "n 3"]) -> Float[Tensor, ""]:
    return (points - points.mean(0)).norm()


@dataclass(frozen=True)
class _Targets:
    """Targets of the body: pixels with certainties, unit directions with weights and their landmark pairs."""

    pixels: Float[Tensor, "33 2"]
    sure: Float[Tensor, "33"]
    direction: Float[Tensor, "D 3"]
    weight: Float[Tensor, "D"]
    pairs: Int[Tensor, "D 2"]


def _targets(pixels: Float[Tensor, "33 2"], world: Float[Tensor, "33 3"], sure: Float[Tensor, "33"]) -> _Targets:
    pairs = torch.tensor([(LANDMARK[start], LANDMARK[end]) for start, end, _ in _DIRECTIONS])
    direction = world[pairs[:, 1]] - world[pairs[:, 0]]
    weight = torch.tensor([w for *_, w in _DIRECTIONS]).to(world) * sure[pairs].amin(1)
    return _Targets(pixels, sure, direction / direction.norm(dim=1, keepdim=True).clamp_min(1e-6), weight, pairs)


def _misfit(
    points: Float[Tensor, "L 3"], attachments: Attachments, camera: PinholeCamera, targets: _Targets
) -> Float[Tensor, ""]:
    """Return robust reprojection errors in units of the trunk, and 1 - cosine of the directions."""
    in_front = torch.cat([points[:, :2], points[:, 2:].clamp_min(_LEAST_DEPTH_M / 2)], 1)
    trunk_px = camera.fx * 0.5 / points[:, 2].detach().mean().clamp_min(_LEAST_DEPTH_M)
    miss = (camera.project(in_front) - targets.pixels[attachments.landmarks]) / trunk_px
    weight = attachments.weights * targets.sure[attachments.landmarks]
    # Geman-McClure: an invented limb must not drag the whole body along.
    square = (miss * miss).sum(1)
    reprojection = (weight * square / (square + 0.2**2)).sum() * 0.2**2 * 100
    by_landmark = points.new_zeros(33, 3).index_copy(0, attachments.landmarks, points)
    along = by_landmark[targets.pairs[:, 1]] - by_landmark[targets.pairs[:, 0]]
    cosine = (along * targets.direction).sum(1) / (along * along).sum(1).clamp_min(1e-8).sqrt()
    return reprojection + 4 * (targets.weight * (1 - cosine)).sum()


def follow_chain(
    rest: Float[Tensor, "24 3"], rotations: Float[Tensor, "24 3 3"], translation: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "24 3"], Float[Tensor, "24 3 3"]]:
    """Return posed joints [m] and each joint's rotation in camera coordinates, without skinning.

    Args:
        rest: joints of the rest pose [m].
        rotations: rotations of every joint in its parent's frame.
        translation: translation of the body [m].
    """
    places, turns = [rest[0] + translation], [rotations[0]]
    for joint, parent in enumerate(PARENTS[1:], start=1):
        places.append(places[parent] + turns[parent] @ (rest[joint] - rest[parent]))
        turns.append(turns[parent] @ rotations[joint])
    return torch.stack(places), torch.stack(turns)
