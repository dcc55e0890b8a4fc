"""Registration of the body to 33 landmarks: pose, translation and a little shape, in camera coordinates.

The body's joints and a few surface points (nose, ears, heels, toes) are fitted to the landmarks: their pixels determine
positions in the image, the lifted landmarks the depth, priors the rest.
"""

from dataclasses import dataclass

import torch

from hfb.body.model import Body, ShapedBody, placed
from hfb.body.skeleton import JOINT_NAMES
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.procrustes import nearest_rotations
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.landmark_lift import HIPS, JOINT_POINTS, POINTS, LiftedPoints
from hfb.initialization.landmarks import LANDMARK, Landmarks
from hfb.initialization.torch_adam import Adam
from hfb.motion.static_pose import FirstBody
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.mixture import shipped_mixture
from hfb.typing import Float, Int, Tensor

_TRUNK = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
_LEAST_DEPTH_M = 0.5
_PRIOR = 0.1
"""Weight of each prior: three times one of them moves real starts by 1 mm, a third of recorded poses alone costs 2."""
_WIDER, _SPREAD_M = 1.3, (0.025, 0.3)
"""Standard deviation per Laplace scale of a lifted coordinate, and its range: rendered people are easier than real."""
_ROBUST = 4.5
"""Mean square from which on the distance from a lifted point counts linearly."""


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
        (name, name, shaped.joints.new_zeros(3), 1.0) for name in JOINT_POINTS
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
    landmarks: Landmarks,
    lifted: LiftedPoints,
    camera: PinholeCamera,
    body: Body,
    iterations: int = 100,
    source: str = "mediapipe",
) -> FirstBody:
    """Lay the body onto the landmarks.

    Minimises, over root and joint rotations, translation and betas (Adam, deterministic): robust reprojection in
    units of the trunk, robust distance from the lifted points in units of their scale, the priors of anatomy and of
    recorded poses, and |betas|^2. In the image a landmark counts as much as the network is sure to see it.

    Args:
        landmarks: landmarks of the person.
        lifted: the same as points of the body.
        camera: camera of the image.
        body: the body model.
        iterations: number of Adam's iterations.
        source: recorded in the result.
    """
    dtype = body.template.dtype
    betas = torch.zeros(body.shape_count, dtype=dtype)
    shaped = body.shape(betas)
    attachments = attach_landmarks(shaped)
    targets = _Targets.of(landmarks, lifted, attachments)
    R_root = _first_root(shaped, targets.points)
    translation = _first_translation(shaped, camera, targets)
    # The optimised root turn is relative to the first guess: no wrap-around at pi, where upright people are.
    free_pose = torch.cat([torch.zeros(1, 3, dtype=dtype), natural_pose(dtype)])
    variables = [free.requires_grad_() for free in (free_pose, translation, betas)]
    optimiser = Adam(list(zip(variables, (0.15, 0.02, 0.02), strict=True)), cosine=(iterations, 0.002))
    anatomy, recorded = AnatomicalPrior(), shipped_mixture()
    for _ in range(iterations):
        rotations = axis_angle_to_matrix(free_pose)
        rotations = torch.cat([(rotations[0] @ R_root)[None], rotations[1:]])
        rest = body.joint_template + body.joint_shape_directions @ betas
        points = attachments.positions(*follow_chain(rest, rotations, translation))
        loss = _misfit(points, camera, targets)
        pose = free_pose[None, 1:]
        loss = loss + _PRIOR * (anatomy(pose)[0] + recorded(pose)[0]) + 2 * (betas * betas).sum()
        loss.backward()
        optimiser.step()
    with torch.no_grad():
        final = free_pose.clone()
        final[0] = matrix_to_axis_angle(axis_angle_to_matrix(free_pose[0]) @ R_root)
    return FirstBody(final.detach(), translation.detach(), betas.detach(), source)


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


def _first_root(shaped: ShapedBody, points: Float[Tensor, "19 3"]) -> Float[Tensor, "3 3"]:
    """Return the rotation of the rest trunk (shoulders, hips) that fits the points' trunk best (Kabsch)."""
    rest = torch.stack([shaped.joints[JOINT_NAMES.index(name)] for name in _TRUNK])
    seen = torch.stack([points[POINTS.index(name)] for name in _TRUNK])
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


def _first_translation(shaped: ShapedBody, camera: PinholeCamera, targets: "_Targets") -> Float[Tensor, "3"]:
    """Return the position of a body of this size that appears at these pixels: linear in the translation.

    For every joint f (X + t_x) = (u - c_x) (Z + t_z), and the same for y, weighted by certainty.
    """
    count = len(JOINT_POINTS)
    rest = shaped.joints[[JOINT_NAMES.index(name) for name in JOINT_POINTS]]
    trunk = [POINTS.index(name) for name in _TRUNK]
    size = _spread(rest[trunk]) / _spread(targets.points[trunk]).clamp_min(1e-3)
    points, weight = targets.points[:count] * size, targets.sure[:count].sqrt()
    pixels = targets.pixels[:count]
    slope = (pixels - pixels.new_tensor([camera.cx, camera.cy])) / pixels.new_tensor([camera.fx, camera.fy])
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
    """Targets of `POINTS`: pixels, certainties with the points' own weights, and lifted points.

    Attributes:
        points: about the hips' middle [m], as if it were ``distance_m`` away.
        spread: standard deviation of each coordinate [m].
    """

    pixels: Float[Tensor, "19 2"]
    sure: Float[Tensor, "19"]
    weights: Float[Tensor, "19"]
    points: Float[Tensor, "19 3"]
    spread: Float[Tensor, "19 3"]
    distance_m: Float[Tensor, ""]

    @staticmethod
    def of(landmarks: Landmarks, lifted: LiftedPoints, attachments: Attachments) -> "_Targets":
        dtype = attachments.offsets.dtype
        pixels, sure = (torch.as_tensor(one, dtype=dtype) for one in (landmarks.pixels, landmarks.visibility))
        return _Targets(
            pixels[attachments.landmarks],
            attachments.weights * sure[attachments.landmarks].clamp(0.05, 1),
            attachments.weights,
            lifted.points.to(dtype),
            (_WIDER * lifted.scale.to(dtype)).clamp(*_SPREAD_M),
            lifted.distance_m.to(dtype),
        )


def _misfit(points: Float[Tensor, "19 3"], camera: PinholeCamera, targets: _Targets) -> Float[Tensor, ""]:
    """Return robust reprojection errors in units of the trunk, and robust distances from the lifted points."""
    in_front = torch.cat([points[:, :2], points[:, 2:].clamp_min(_LEAST_DEPTH_M / 2)], 1)
    trunk_px = camera.fx * 0.5 / points[:, 2].detach().mean().clamp_min(_LEAST_DEPTH_M)
    # Geman-McClure: an invented limb must not drag the whole body along.
    square = ((camera.project(in_front) - targets.pixels) / trunk_px).square().sum(1)
    reprojection = (targets.sure * square / (square + 0.2**2)).sum() * 0.2**2 * 50
    hips = points[HIPS].mean(0)
    # The distance is held here: a smaller body that stands nearer must not look like a better one.
    off = (points - hips - targets.points * (hips[2].detach() / targets.distance_m)) / targets.spread
    mean_square = off.square().mean(1)
    distances = (targets.weights * ((1 + mean_square / _ROBUST).sqrt() - 1)).sum()
    return reprojection + 1.5 * _ROBUST * distances


def follow_chain(
    rest: Float[Tensor, "24 3"], rotations: Float[Tensor, "24 3 3"], translation: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "24 3"], Float[Tensor, "24 3 3"]]:
    """Return posed joints [m] and each joint's rotation in camera coordinates, without skinning.

    Args:
        rest: joints of the rest pose [m].
        rotations: rotations of every joint in its parent's frame.
        translation: translation of the body [m].
    """
    transforms, joints = placed(rotations[None], translation[None], rest)
    return joints[0], transforms[0, :, :, :3]
