"""Skeletons whose rest pose is none, or has another up than the world: the person stands, or is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.motions.built_in.procedural import ProceduralMotions
from hfb.datasets.motions.skeletons.kinematics import joint_positions, rest_joints, to_world
from hfb.datasets.motions.skeletons.retargeting import retarget
from hfb.errors import InputError
from hfb.geometry.quaternions import conjugate, from_axis_angle, multiply, rotate
from tests.datasets.motions.skeletons import Foreign, bones_along_one_axis

_J = {name: number for number, name in enumerate(JOINT_NAMES)}
_TURNS = {
    "z up": Rotation.from_euler("x", 90, degrees=True),
    "z down": Rotation.from_euler("x", -90, degrees=True),
    "x up": Rotation.from_euler("z", -90, degrees=True),
    "y down": Rotation.from_euler("x", 180, degrees=True),
}
_BANDAI = (
    "Hips",
    "UpperLeg_L",
    "UpperLeg_R",
    "Spine",
    "LowerLeg_L",
    "LowerLeg_R",
    "Spine1",
    "Foot_L",
    "Foot_R",
    "Chest",
    "Toes_L",
    "Toes_R",
    "Neck",
    "Shoulder_L",
    "Shoulder_R",
    "Head",
    "UpperArm_L",
    "UpperArm_R",
    "LowerArm_L",
    "LowerArm_R",
    "Hand_L",
    "Hand_R",
    "Mid_L",
    "Mid_R",
)


def _motion(name: str) -> tuple[np.ndarray, np.ndarray]:
    source = ProceduralMotions(3)
    clip = source.load(next(number for number, found in enumerate(source.names()) if name in found))
    return clip.poses[::8], clip.translations[::8]


def _joints(poses: np.ndarray, translations: np.ndarray) -> np.ndarray:
    return joint_positions(to_world(from_axis_angle(poses)), translations, rest_joints())


def _apart(true: np.ndarray, got: np.ndarray) -> np.ndarray:
    """(F, 24) distances after one turn about the vertical and one step for the whole clip."""
    a, b = (joints - joints[:, :1].mean(0) for joints in (true, got))
    angle = np.arctan2((b[..., 2] * a[..., 0] - b[..., 0] * a[..., 2]).sum(), (b[..., [0, 2]] * a[..., [0, 2]]).sum())
    turned = Rotation.from_euler("y", angle).apply(b.reshape(-1, 3)).reshape(b.shape)
    return np.linalg.norm(turned - a, axis=-1)


@pytest.mark.parametrize("name", ["walk", "roundhouse kick", "squat"])
@pytest.mark.parametrize("turn", list(_TURNS))
def test_up_is_where_the_person_stands(turn, name):
    poses, translations = _motion(name)
    world = _TURNS[turn].as_quat(scalar_first=True)
    got = retarget(Foreign(world=world).carry(poses, translations, 15.0))
    assert "up in its world" in got.remarks[0]
    body = [joint for joint in range(24) if "foot" not in JOINT_NAMES[joint] and "hand" not in JOINT_NAMES[joint]]
    assert _apart(_joints(poses, translations), _joints(got.poses, got.translations))[:, body].max() < 0.012


@pytest.mark.parametrize("name", ["walk", "overhead throw", "hook"])
@pytest.mark.parametrize("turn", [None, "z up"])
def test_a_rest_pose_with_all_bones_along_one_axis(turn, name):
    poses, translations = _motion(name)
    world = None if turn is None else _TURNS[turn].as_quat(scalar_first=True)
    skeleton = Foreign(names=_BANDAI, frames=bones_along_one_axis(), world=world)
    recorded = skeleton.carry(poses, translations, 15.0)
    assert np.abs(recorded.offsets[4:9:3] / recorded.offsets[4:9:3, :1] - [1, 0, 0]).max() < 1e-9  # shins, feet ...
    got = retarget(recorded)
    true, joints = _joints(poses, translations), _joints(got.poses, got.translations)
    up = rotate(from_axis_angle(got.poses[:, 0]), np.array([0, 1.0, 0]))[:, 1]
    assert np.median(up) > 0.9
    limbs = [_J[f"{side}_{part}"] for side in ("left", "right") for part in ("knee", "ankle", "elbow", "wrist")]
    apart = _apart(true, joints)
    assert apart[:, limbs].max() < 0.12  # the trunk's lean is known by a few degrees
    assert apart.mean() < 0.05
    chest, own = (to_world(from_axis_angle(one))[:, _J["spine3"]] for one in (got.poses, poses))
    between = to_world(from_axis_angle(poses))[:, 0], to_world(from_axis_angle(got.poses))[:, 0]
    apart = multiply(conjugate(multiply(conjugate(between[0]), own)), multiply(conjugate(between[1]), chest))
    assert np.degrees(2 * np.arccos(np.abs(apart[:, 0]).clip(0, 1))).max() < 25


def test_position_channels_tell_the_bones_where_offsets_do_not():
    poses, translations = _motion("walk")
    recorded = Foreign(names=_BANDAI, frames=bones_along_one_axis()).carry(poses, translations, 15.0)
    straight = np.linalg.norm(recorded.offsets, axis=1)[:, None] * [0, 1.0, 0]  # all along y, hips and collars too
    got = retarget(replace(recorded, offsets=straight))
    assert np.median(rotate(from_axis_angle(got.poses[:, 0]), np.array([0, 1.0, 0]))[:, 1]) > 0.9
    assert _apart(_joints(poses, translations), _joints(got.poses, got.translations)).mean() < 0.05


def test_whoever_lies_goes_on_lying():
    """In a world with the rest pose's up: stretched along an axis, on the floor."""
    poses, _ = _motion("walk")
    poses = poses * 0.1
    poses[:, 0] = [-np.pi / 2, 0, 0]  # on the back, the head along -z
    joints = _joints(poses, np.zeros((len(poses), 3)))
    places = np.tile([0, 0, 3.0], (len(poses), 1)) - [0, joints[..., 1].min(), 0]
    got = retarget(Foreign().carry(poses, places, 15.0))
    assert not got.remarks
    assert np.abs(rotate(from_axis_angle(got.poses[:, 0]), np.array([0, 1.0, 0]))[:, 1]).max() < 0.1
    floating = places + [0, 1.5, 0]
    with pytest.raises(InputError, match="lies all the time, or the world has another up"):
        retarget(Foreign().carry(poses, floating, 15.0))


def test_what_cannot_be_told_is_refused():
    poses, translations = _motion("walk")
    turns = Rotation.from_euler("x", np.linspace(0, 4 * np.pi, len(poses))[:, None])  # somersaults without a floor
    poses[:, 0] = turns.as_rotvec()
    with pytest.raises(InputError, match="seldom upright"):
        retarget(Foreign(frames=bones_along_one_axis()).carry(poses, translations, 15.0))


def test_a_head_that_is_turned_impossibly_is_told_and_made_straight():
    poses, translations = _motion("walk")
    recorded = Foreign().carry(poses, translations, 15.0)
    turned = recorded.rotations.copy()
    twist = Rotation.from_euler("y", 150, degrees=True).as_quat(scalar_first=True)
    turned[:, _J["head"]] = multiply(turned[:, _J["head"]], twist)
    got = retarget(replace(recorded, rotations=turned))
    assert "head" in got.remarks[0]
    world = to_world(from_axis_angle(got.poses))
    relative = multiply(conjugate(world[:, _J["spine3"]]), world[:, _J["head"]])
    assert np.degrees(2 * np.arccos(np.abs(relative[:, 0]).clip(0, 1))).max() < 45
    spinning = recorded.rotations.copy()
    spin = Rotation.random(len(poses), rng=np.random.default_rng(0)).as_quat(scalar_first=True)
    spinning[:, _J["head"]] = multiply(spinning[:, _J["head"]], spin)
    got = retarget(replace(recorded, rotations=spinning))
    assert any("left at rest" in remark for remark in got.remarks)
    assert not got.poses[:, _J["head"]].any()


@pytest.mark.parametrize(("joint", "angle"), [("left_hip", [0, 0, -2.6]), ("right_shoulder", [0, -2.6, 0])])
def test_a_limb_that_no_person_can_turn_so_is_refused_by_name(joint, angle):
    poses, translations = _motion("walk")
    poses[:, _J[joint]] = angle
    with pytest.raises(InputError, match=f"{joint}.*as no person can"):
        retarget(Foreign().carry(poses, translations, 15.0))


def test_exchanged_sides_are_refused():
    """Left and right exchanged make a person who walks backwards, knees to the back."""
    poses, translations = _motion("walk")
    exchanged = tuple(
        name.replace("Left", "R-").replace("Right", "Left").replace("R-", "Right") for name in Foreign().names
    )
    with pytest.raises(InputError, match="left and right"):
        retarget(Foreign(names=exchanged).carry(poses, translations, 15.0))


def test_directions_survive_any_unit():
    poses, translations = _motion("walk")
    one, other = (retarget(Foreign(scale=scale).carry(poses, translations, 15.0)) for scale in (1.0, 39.37))
    np.testing.assert_allclose(one.poses, other.poses, atol=1e-6)
    np.testing.assert_allclose(one.translations, other.translations, atol=1e-6)
