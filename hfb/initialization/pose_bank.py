"""About fifty everyday and athletic poses as joint angles, the starts of a search without networks.

Angles in degrees. An arm is (raise, azimuth, elbow): 0 hangs down, 90 is horizontal, 180 points up; azimuth 0 is
sideways, 90 forward, -90 backward; the elbow's bend. A leg is (flexion, abduction, knee): flexion lifts the thigh
forward. The trunk is (forward bend, turn to the left). Left side first.
"""

from dataclasses import dataclass
from math import cos, radians, sin

import torch

from hfb.body.skeleton import JOINT_NAMES, MIRROR
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.typing import Float, Tensor

Limb = tuple[float, float, float]


@dataclass(frozen=True)
class BankPose:
    """One named pose."""

    name: str
    left_arm: Limb
    right_arm: Limb
    left_leg: Limb
    right_leg: Limb
    trunk: tuple[float, float] = (0.0, 0.0)


_REST_ARM: Limb = (15, 20, 15)
_STAND: Limb = (3, 4, 5)
BANK: tuple[BankPose, ...] = (
    BankPose("standing", _REST_ARM, _REST_ARM, _STAND, _STAND),
    BankPose("legs apart", (25, 0, 10), (25, 0, 10), (5, 20, 5), (5, 20, 5)),
    BankPose("arms crossed", (30, 60, 110), (30, 60, 110), _STAND, _STAND),
    BankPose("hands on hips", (45, -20, 95), (45, -20, 95), (3, 8, 5), (3, 8, 5)),
    BankPose("T", (90, 0, 5), (90, 0, 5), _STAND, _STAND),
    BankPose("star", (135, 0, 5), (135, 0, 5), (3, 28, 5), (3, 28, 5)),
    BankPose("arms up", (170, 0, 10), (170, 0, 10), _STAND, _STAND),
    BankPose("arms forward", (90, 85, 10), (90, 85, 10), _STAND, _STAND),
    BankPose("one arm up", (160, 20, 10), _REST_ARM, _STAND, _STAND),
    BankPose("one arm out", (90, 0, 10), _REST_ARM, _STAND, _STAND),
    BankPose("one arm forward", (90, 85, 10), _REST_ARM, _STAND, _STAND),
    BankPose("waving", (100, 10, 80), _REST_ARM, _STAND, _STAND),
    BankPose("phone", (40, 50, 130), _REST_ARM, _STAND, _STAND),
    BankPose("stride", (28, -75, 15), (28, 75, 25), (28, 3, 8), (-18, 3, 12), (3, 0)),
    BankPose("short stride", (18, -60, 15), (18, 60, 20), (16, 3, 10), (-10, 3, 15), (2, 0)),
    BankPose("mid swing", (20, 0, 15), (20, 30, 20), (22, 3, 50), (-2, 3, 5), (3, 0)),
    BankPose("push off", (25, -60, 20), (25, 60, 25), (22, 3, 15), (-18, 3, 35), (4, 0)),
    BankPose("run, drive", (45, -80, 90), (45, 80, 95), (65, 3, 80), (-20, 3, 30), (12, 0)),
    BankPose("run, swing", (40, -60, 85), (40, 60, 90), (35, 3, 95), (5, 3, 25), (10, 0)),
    BankPose("lunge", (25, 0, 20), (25, 0, 20), (70, 5, 75), (-20, 5, 35), (5, 0)),
    BankPose("side lunge", (60, 20, 40), (60, 20, 40), (35, 35, 60), (5, 40, 5), (15, 0)),
    BankPose("half squat", (60, 80, 20), (60, 80, 20), (55, 12, 75), (55, 12, 75), (25, 0)),
    BankPose("crouch", (45, 60, 50), (45, 60, 50), (105, 15, 130), (105, 15, 130), (35, 0)),
    BankPose("bent over", (35, 80, 10), (35, 80, 10), (45, 5, 25), (45, 5, 25), (60, 0)),
    BankPose("sitting", (25, 70, 50), (25, 70, 50), (85, 6, 85), (85, 6, 85), (5, 0)),
    BankPose("knee up", (25, 30, 40), (25, 30, 40), (85, 5, 85), _STAND),
    BankPose("front kick", (40, 20, 70), (40, 20, 70), (80, 5, 15), (5, 3, 10), (-8, 0)),
    BankPose("side kick", (50, 0, 60), (50, 0, 60), (15, 70, 10), (5, 5, 10)),
    BankPose("back leg", (70, 20, 10), (70, 20, 10), (-35, 5, 15), (5, 5, 10), (25, 0)),
    BankPose("balance", (80, 0, 10), (80, 0, 10), (20, 35, 20), (5, 2, 10)),
    BankPose("jump, tucked", (120, 30, 30), (120, 30, 30), (50, 10, 80), (50, 10, 80), (10, 0)),
    BankPose("throw", (110, -20, 80), (70, 70, 20), (-15, 8, 10), (25, 8, 20), (0, 25)),
    BankPose("boxing", (55, 70, 110), (75, 80, 40), (15, 10, 25), (-8, 10, 20), (10, 20)),
    BankPose("reaching down", (60, 80, 10), _REST_ARM, (60, 8, 70), (60, 8, 70), (50, 0)),
)


def bank_rotations(dtype: torch.dtype = torch.float32) -> tuple[list[str], Float[Tensor, "P 23 3"]]:
    """Return names and axis-angles below the root; asymmetric poses are followed by their mirror image.

    Args:
        dtype: precision of the result.
    """
    names, poses = [], []
    for entry in BANK:
        pose = _rotations(entry)
        names.append(entry.name)
        poses.append(pose)
        if entry.left_arm != entry.right_arm or entry.left_leg != entry.right_leg or entry.trunk[1]:
            names.append(entry.name + ", mirrored")
            # A mirror in x = 0 keeps rotations about x and turns those about y and z around.
            poses.append(pose[list(MIRROR)] * torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    return names, torch.stack(poses)[:, 1:].to(dtype)


def _rotations(entry: BankPose) -> Float[Tensor, "24 3"]:
    pose = torch.zeros(24, 3, dtype=torch.float64)

    def put(joint: str, *turns: tuple[float, float, float]) -> None:
        """Axis-angles in degrees, the last one applied first."""
        matrix = torch.eye(3, dtype=torch.float64)
        for turn in turns:
            matrix = matrix @ axis_angle_to_matrix(torch.tensor([radians(a) for a in turn], dtype=torch.float64))
        pose[JOINT_NAMES.index(joint)] = matrix_to_axis_angle(matrix)

    bend, turn = entry.trunk
    for spine, share in (("spine1", 0.4), ("spine2", 0.3), ("spine3", 0.3)):
        put(spine, (share * bend, share * turn, 0))
    put("neck", (-0.3 * bend, 0, 0))
    for side, sign, arm, leg in (
        ("left", 1.0, entry.left_arm, entry.left_leg),
        ("right", -1.0, entry.right_arm, entry.right_leg),
    ):
        put(f"{side}_shoulder", *_arm(arm, sign))
        put(f"{side}_elbow", (0, -sign * arm[2], 0))
        put(f"{side}_hip", (-leg[0], 0, 0), (0, 0, sign * leg[1]))
        put(f"{side}_knee", (leg[2], 0, 0))
        put(f"{side}_ankle", (min(0.0, leg[0] - leg[2]) * 0.1, 0, 0))
    return pose


def _arm(arm: Limb, sign: float) -> tuple[tuple[float, float, float], ...]:
    """Return the shortest turn from the rest direction (sideways) to the wanted one, as an axis-angle in degrees."""
    up, azimuth = radians(arm[0]), radians(arm[1])
    wanted = torch.tensor([sign * sin(up) * cos(azimuth), -cos(up), sin(up) * sin(azimuth)], dtype=torch.float64)
    rest = torch.tensor([sign, 0.0, 0.0], dtype=torch.float64)
    axis = torch.linalg.cross(rest, wanted)
    angle = torch.atan2(axis.norm(), (rest * wanted).sum())
    turn = torch.rad2deg(axis / axis.norm().clamp_min(1e-9) * angle)
    return ((float(turn[0]), float(turn[1]), float(turn[2])),)
