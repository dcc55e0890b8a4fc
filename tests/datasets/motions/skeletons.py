"""Foreign skeletons that carry a known SMPL motion: what a retargeting must give back."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hfb.body.skeleton import JOINT_NAMES, PARENTS
from hfb.datasets.motions.files.bvh import BvhMotion
from hfb.datasets.motions.skeletons.kinematics import joint_positions, rest_joints, to_world
from hfb.geometry.quaternions import between, conjugate, from_axis_angle, multiply, rotate, unit
from hfb.typing import Array, Float

MIXAMO = (
    "Hips",
    "LeftUpLeg",
    "RightUpLeg",
    "Spine",
    "LeftLeg",
    "RightLeg",
    "Spine1",
    "LeftFoot",
    "RightFoot",
    "Spine2",
    "LeftToeBase",
    "RightToeBase",
    "Neck",
    "LeftShoulder",
    "RightShoulder",
    "Head",
    "LeftArm",
    "RightArm",
    "LeftForeArm",
    "RightForeArm",
    "LeftHand",
    "RightHand",
    "LeftHandMiddle1",
    "RightHandMiddle1",
)


@dataclass(frozen=True)
class Foreign:
    """A skeleton with SMPL's joints.

    Attributes:
        scale: its units per metre.
        axes: rotation (w, x, y, z) of its world against SMPL's axes.
        rest: SMPL pose (axis-angle) of the person in its rest pose.
        frames: of every joint's own axes against the world's at rest (w, x, y, z); zero angles are then no pose.
        world: rotation (w, x, y, z) of the file's world against its rest pose's; only the root's channels have it.
    """

    names: tuple[str, ...] = MIXAMO
    scale: float = 100.0
    axes: Float[Array, "4"] | None = None
    rest: Float[Array, "24 3"] | None = None
    frames: Float[Array, "24 4"] | None = None
    world: Float[Array, "4"] | None = None

    def carry(self, poses: Float[Array, "F 24 3"], translations: Float[Array, "F 3"], fps: float) -> BvhMotion:
        """The same movement on this skeleton: every bone turns in the world as SMPL's does."""
        still = np.array([1.0, 0, 0, 0])
        axes = still if self.axes is None else self.axes
        rest_pose = np.zeros((24, 3)) if self.rest is None else self.rest
        joints = rest_joints()
        at_rest = to_world(from_axis_angle(rest_pose)[None])
        places = joint_positions(at_rest, np.zeros((1, 3)), joints)[0]
        own = np.tile(still, (24, 1)) if self.frames is None else self.frames
        now = to_world(from_axis_angle(poses))
        # Rest: SMPL's frame is at_rest, the foreign one `own`; later both have turned by now / at_rest.
        since = multiply(now, conjugate(at_rest))
        world = multiply(multiply(multiply(axes, since), own[None]), conjugate(axes) if self.frames is None else still)
        local = world.copy()
        local[:, 1:] = multiply(conjugate(world[:, PARENTS[1:]]), world[:, 1:])
        offsets = np.zeros((24, 3))
        for joint in range(1, 24):
            bone = self.scale * (places[joint] - places[PARENTS[joint]])
            parent = own[PARENTS[joint]]
            offsets[joint] = rotate(axes, bone) if self.frames is None else rotate(conjugate(parent), bone)
        repeated = np.repeat(offsets[None], len(poses), 0)
        repeated[:, 0] = self.scale * rotate(axes, joints[0] + translations)
        if self.world is not None:
            local[:, 0] = multiply(self.world, local[:, 0])
            repeated[:, 0] = rotate(self.world, repeated[:, 0])
        ends = np.zeros((24, 3))
        return BvhMotion(self.names, PARENTS, offsets, ends, local, repeated, fps)


def bones_along_one_axis() -> Float[Array, "24 4"]:
    """Every joint's frame with its x axis along the bone to its child: with zero angles all bones lie along x."""
    places = rest_joints()
    child = {parent: joint for joint, parent in reversed(list(enumerate(PARENTS))) if parent >= 0}
    child |= {JOINT_NAMES.index("pelvis"): JOINT_NAMES.index("spine1"), JOINT_NAMES.index("spine3"): 12}
    frames = np.tile([1.0, 0, 0, 0], (24, 1))
    for joint in range(24):
        tip = child.get(joint)
        bone = places[tip] - places[joint] if tip else places[joint] - places[PARENTS[joint]]
        frames[joint] = between(np.array([1.0, 0, 0]), unit(bone))
    return frames


def own_frames() -> Float[Array, "24 4"]:
    """Trunk and head along the world's axes; each limb's joints with frames of their own, as bone-aligned rigs have."""
    frames = np.tile([1.0, 0, 0, 0], (24, 1))
    for joint, name in enumerate(JOINT_NAMES):
        if any(part in name for part in ("hip", "knee", "ankle", "foot")):
            frames[joint] = [0, 0, 0, 1]  # half a turn about the line of sight: legs point up when all angles are zero
        if any(part in name for part in ("shoulder", "elbow", "wrist", "hand")):
            side = "left" if name.startswith("left") else "right"
            frames[joint] = _ARM_FRAME[side]
    return frames


_ARM_FRAME = {
    side: Rotation.random(rng=np.random.default_rng(seed)).as_quat(scalar_first=True)
    for seed, side in enumerate(("left", "right"))
}
