"""Retargeting: known motions come back from skeletons of other sizes, axes and rest poses; real ones look human."""

import numpy as np
import pytest
import torch

from hfb.body.skeleton import JOINT_NAMES, PARENTS
from hfb.datasets.motions.built_in.procedural import ProceduralMotions
from hfb.datasets.motions.files.bvh import BvhMotion, read_bvh
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.resampling import has_jump
from hfb.datasets.motions.skeletons.joint_names import map_joints
from hfb.datasets.motions.skeletons.kinematics import joint_positions, rest_joints, to_world
from hfb.datasets.motions.skeletons.retargeting import retarget
from hfb.errors import InputError
from hfb.geometry.quaternions import from_axis_angle, rotate, unit
from hfb.priors.anatomy import AnatomicalPrior
from tests.datasets.motions.skeletons import MIXAMO, Foreign, own_frames
from tests.shared import SHARED_DATA

_MOCAP = SHARED_DATA / "cmu_bvh"
_J = {name: number for number, name in enumerate(JOINT_NAMES)}
_LIMB_BONES = [
    (_J[f"{side}_{a}"], _J[f"{side}_{b}"])
    for side in ("left", "right")
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
]
_A_POSE = np.zeros((24, 3))
_A_POSE[_J["left_shoulder"], 2], _A_POSE[_J["right_shoulder"], 2] = -0.8, 0.8
_A_POSE[_J["left_hip"], 2], _A_POSE[_J["right_hip"], 2] = 0.3, -0.3
_Z_UP = np.array([np.sqrt(0.5), np.sqrt(0.5), 0, 0])
_HALF_TURN = np.array([0, 0, 1.0, 0])


def _motion(name: str) -> tuple[np.ndarray, np.ndarray]:
    source = ProceduralMotions(3)
    index = next(number for number, found in enumerate(source.names()) if name in found)
    clip = source.load(index)
    return clip.poses[::4], clip.translations[::4]


def _joints(poses: np.ndarray, translations: np.ndarray) -> np.ndarray:
    return joint_positions(to_world(from_axis_angle(poses)), translations, rest_joints())


@pytest.mark.parametrize("name", ["run", "roundhouse kick", "overhead throw", "disco"])
@pytest.mark.parametrize(
    ("skeleton", "tolerance_m"),
    [
        (Foreign(), 0.012),
        (Foreign(scale=39.37, axes=_Z_UP), 0.012),
        (Foreign(scale=1.0, axes=_HALF_TURN), 0.012),
        (Foreign(names=tuple(f"mixamorig:{name}" for name in MIXAMO), rest=_A_POSE), 0.012),
        (
            Foreign(
                names=(
                    "hip",
                    "lThigh",
                    "rThigh",
                    "spine",
                    "lShin",
                    "rShin",
                    "abdomen",
                    "lFoot",
                    "rFoot",
                    "chest",
                    "lToe",
                    "rToe",
                    "neck",
                    "lCollar",
                    "rCollar",
                    "head",
                    "lShldr",
                    "rShldr",
                    "lForeArm",
                    "rForeArm",
                    "lHand",
                    "rHand",
                    "lMid",
                    "rMid",
                )
            ),
            0.012,
        ),
        (Foreign(frames=own_frames()), 0.06),
    ],
)
def test_a_known_motion_comes_back(skeleton, tolerance_m, name):
    poses, translations = _motion(name)
    got = retarget(skeleton.carry(poses, translations, 30.0))
    true, joints = _joints(poses, translations), _joints(got.poses, got.translations)
    for start, end in _LIMB_BONES:
        cosine = (unit(true[:, end] - true[:, start]) * unit(joints[:, end] - joints[:, start])).sum(-1)
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.01
    body = [joint for joint in range(24) if "foot" not in JOINT_NAMES[joint] and "hand" not in JOINT_NAMES[joint]]
    # The trunk's bend is shared evenly, whatever the skeleton had: ends agree, the middle nearly. Where the rest pose
    # does not show, collars stay with the chest.
    assert np.linalg.norm(joints - true, axis=-1)[:, body].max() < tolerance_m


def test_the_turn_of_a_limb_shows_in_its_joints():
    poses, translations = _motion("hook")
    for skeleton in (Foreign(), Foreign(rest=_A_POSE), Foreign(frames=own_frames())):
        got, *_ = retarget(skeleton.carry(poses, translations, 30.0))
        for name in ("left_elbow", "right_elbow", "left_knee", "right_knee", "left_hip", "right_hip"):
            across = [1, 2] if "elbow" not in name else [0, 2]
            if "hip" in name:
                np.testing.assert_allclose(got[:, _J[name]], poses[:, _J[name]], atol=0.12)
            else:
                assert np.abs(got[:, _J[name]][:, across]).max() < 0.25


def test_straight_limbs_do_not_turn_round():
    """Knees that go a few degrees past straight are noise, not legs turned by half a turn."""
    frames = 60
    poses = np.zeros((frames, 24, 3))
    poses[:, _J["left_knee"], 0] = 0.08 * np.sin(np.arange(frames))
    poses[:, _J["left_hip"], 0] = -0.6
    got, *_ = retarget(Foreign().carry(poses, np.zeros((frames, 3)), 60.0))
    np.testing.assert_allclose(got[:, _J["left_hip"]], poses[:, _J["left_hip"]], atol=0.15)


def test_elbows_that_bend_backwards_are_put_right():
    poses, translations = _motion("hook")
    broken = poses.copy()
    for name in ("left_elbow", "right_elbow"):
        broken[:, _J[name]] *= -1
    got, *_ = retarget(Foreign().carry(broken, translations, 30.0))
    penalty = AnatomicalPrior().limit_penalty(torch.from_numpy(got[:, 1:]))
    assert penalty.median() < 0.5
    assert AnatomicalPrior().limit_penalty(torch.from_numpy(broken[:, 1:])).median() > 100


def test_feet_that_stand_stay():
    poses, translations = _motion("squat")
    got = retarget(Foreign(scale=77.0).carry(poses, translations, 30.0))
    np.testing.assert_allclose(got[1] - got[1][0], translations - translations[0], atol=0.01)


_CONVENTIONS = {
    "cmu": "Hips LHipJoint LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot LowerBack Spine Spine1 "
    "Head LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand",
    "biped": "Bip01 X Bip01_L_Thigh Bip01_L_Calf Bip01_L_Foot Bip01_L_Toe0 Bip01_R_Thigh Bip01_R_Calf Bip01_R_Foot "
    "Bip01_Spine Bip01_Spine1 Bip01_Spine2 Bip01_Head Bip01_L_Clavicle Bip01_L_UpperArm Bip01_L_Forearm Bip01_L_Hand "
    "Bip01_R_Clavicle Bip01_R_UpperArm Bip01_R_Forearm Bip01_R_Hand",
    "unreal": "pelvis x thigh_l calf_l foot_l ball_l thigh_r calf_r foot_r spine_01 spine_02 spine_03 head clavicle_l "
    "upperarm_l lowerarm_l hand_l clavicle_r upperarm_r lowerarm_r hand_r",
    "joints": "Hips x LeftHip LeftKnee LeftAnkle LeftToe RightHip RightKnee RightAnkle Chest Chest2 Chest3 Head "
    "LeftCollar LeftShoulder LeftElbow LeftWrist RightCollar RightShoulder RightElbow RightWrist",
}
_MORE_NAMES = {
    "bandai": "joint_Root x UpperLeg_L LowerLeg_L Foot_L Toes_L UpperLeg_R LowerLeg_R Foot_R Spine Spine2 Chest Head "
    "Shoulder_L UpperArm_L LowerArm_L Hand_L Shoulder_R UpperArm_R LowerArm_R Hand_R",
    "rokoko": "Hips x LeftThigh LeftShin LeftFoot LeftToe RightThigh RightShin RightFoot Spine1 Spine2 Spine4 Head "
    "LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand",
    "lafan": "Hips x LeftUpLeg LeftLeg LeftFoot LeftToe RightUpLeg RightLeg RightFoot Spine Spine1 Spine2 Head "
    "LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand",
    "xsens": "Pelvis x LeftUpperLeg LeftLowerLeg LeftFoot LeftToe RightUpperLeg RightLowerLeg RightFoot L5 L3 T8 Head "
    "LeftShoulder LeftUpperArm LeftForeArm LeftHand RightShoulder RightUpperArm RightForeArm RightHand",
    "optitrack": "Skeleton_Hip Skeleton_x Skeleton_LThigh Skeleton_LShin Skeleton_LFoot Skeleton_LToe Skeleton_RThigh "
    "Skeleton_RShin Skeleton_RFoot Skeleton_Ab Skeleton_Ab2 Skeleton_Chest Skeleton_Head Skeleton_LShoulder "
    "Skeleton_LUArm Skeleton_LFArm Skeleton_LHand Skeleton_RShoulder Skeleton_RUArm Skeleton_RFArm Skeleton_RHand",
    "motionbuilder": "Ann:Hips Ann:x Ann:LeftUpLeg Ann:LeftLeg Ann:LeftFoot Ann:LeftToeBase Ann:RightUpLeg "
    "Ann:RightLeg Ann:RightFoot Ann:Spine Ann:Spine1 Ann:Spine2 Ann:Head Ann:LeftShoulder Ann:LeftArm Ann:LeftForeArm "
    "Ann:LeftHand Ann:RightShoulder Ann:RightArm Ann:RightForeArm Ann:RightHand",
    "neuron": "Robot_Hips Robot_x Robot_LeftUpLeg Robot_LeftLeg Robot_LeftFoot Robot_LeftToe Robot_RightUpLeg "
    "Robot_RightLeg Robot_RightFoot Robot_Spine Robot_Spine1 Robot_Spine3 Robot_Head Robot_LeftShoulder Robot_LeftArm "
    "Robot_LeftForeArm Robot_LeftHand Robot_RightShoulder Robot_RightArm Robot_RightForeArm Robot_RightHand",
    "blender": "hips x thigh.L shin.L foot.L toe.L thigh.R shin.R foot.R spine.001 spine.002 spine.003 spine.006 "
    "shoulder.L upper_arm.L forearm.L hand.L shoulder.R upper_arm.R forearm.R hand.R",
    "smpl": "Pelvis x L_Hip L_Knee L_Ankle L_Foot R_Hip R_Knee R_Ankle Spine1 Spine2 Spine3 Head L_Collar L_Shoulder "
    "L_Elbow L_Wrist R_Collar R_Shoulder R_Elbow R_Wrist",
    "asf": "root lhipjoint lfemur ltibia lfoot ltoes rfemur rtibia rfoot lowerback upperback thorax head lclavicle "
    "lhumerus lradius lwrist rclavicle rhumerus rradius rwrist",
    "vrm": "J_Bip_C_Hips x J_Bip_L_UpperLeg J_Bip_L_LowerLeg J_Bip_L_Foot J_Bip_L_ToeBase J_Bip_R_UpperLeg "
    "J_Bip_R_LowerLeg J_Bip_R_Foot J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_UpperChest J_Bip_C_Head J_Bip_L_Shoulder "
    "J_Bip_L_UpperArm J_Bip_L_LowerArm J_Bip_L_Hand J_Bip_R_Shoulder J_Bip_R_UpperArm J_Bip_R_LowerArm J_Bip_R_Hand",
    "deepmotion": "hips_JNT x l_upleg_JNT l_leg_JNT l_foot_JNT l_toebase_JNT r_upleg_JNT r_leg_JNT r_foot_JNT "
    "spine_JNT spine1_JNT spine2_JNT head_JNT l_shoulder_JNT l_arm_JNT l_forearm_JNT l_hand_JNT r_shoulder_JNT "
    "r_arm_JNT r_forearm_JNT r_hand_JNT",
    "smpl's fbx": "m_avg_Pelvis x m_avg_L_Hip m_avg_L_Knee m_avg_L_Ankle m_avg_L_Foot m_avg_R_Hip m_avg_R_Knee "
    "m_avg_R_Ankle m_avg_Spine1 m_avg_Spine2 m_avg_Spine3 m_avg_Head m_avg_L_Collar m_avg_L_Shoulder m_avg_L_Elbow "
    "m_avg_L_Wrist m_avg_R_Collar m_avg_R_Shoulder m_avg_R_Elbow m_avg_R_Wrist",
    "makehuman": "root x upperleg01.L lowerleg01.L foot.L toe.L upperleg01.R lowerleg01.R foot.R spine05 spine03 "
    "spine01 head clavicle.L upperarm01.L lowerarm01.L wrist.L clavicle.R upperarm01.R lowerarm01.R wrist.R",
}
_MORE_NAMES["motive"] = _MORE_NAMES["optitrack"].replace("Skeleton_", "Skeleton-001_")  # a space in the file
_CONVENTIONS |= _MORE_NAMES
_PARENTS = (-1, 0, 1, 2, 3, 4, 0, 6, 7, 0, 9, 10, 11, 11, 13, 14, 15, 11, 17, 18, 19)


@pytest.mark.parametrize("convention", list(_CONVENTIONS))
def test_names_of_many_makers(convention):
    names = [name.replace("-", " ") for name in _CONVENTIONS[convention].split()]
    found = map_joints(names, _PARENTS)
    assert (found.pelvis, found.chest, found.head) == (0, 11, 12)
    assert found.limbs == {
        "left_hip": 2,
        "left_knee": 3,
        "left_ankle": 4,
        "right_hip": 6,
        "right_knee": 7,
        "right_ankle": 8,
        "left_shoulder": 14,
        "left_elbow": 15,
        "left_wrist": 16,
        "right_shoulder": 18,
        "right_elbow": 19,
        "right_wrist": 20,
    }
    assert found.collars == {"left": 13, "right": 17}
    assert found.toes == {"left": 5, "right": None}


def test_a_skeleton_without_a_person_is_refused():
    names = ["Hips", *("Tail" + str(k) for k in range(20))]
    with pytest.raises(InputError, match=r"left knee.*head.*Tail3"):
        map_joints(names, _PARENTS)
    swapped = (
        _CONVENTIONS["cmu"].replace("LeftUpLeg", "x").replace("RightLeg", "LeftUpLeg").replace(" x ", " RightLeg ")
    )
    with pytest.raises(InputError, match="do not hang from one another"):
        map_joints(swapped.split(), _PARENTS)


def test_legs_without_length_are_refused():
    motion = Foreign().carry(np.zeros((2, 24, 3)), np.zeros((2, 3)), 30.0)
    flat = BvhMotion(motion.names, PARENTS, 0 * motion.offsets, motion.ends, motion.rotations, 0 * motion.places, 30.0)
    with pytest.raises(InputError, match="no length"):
        retarget(flat)


def _recorded(name: str) -> tuple[BvhMotion, np.ndarray, np.ndarray]:
    path = _MOCAP / f"cmu_{name}.bvh"
    if not path.is_file():
        pytest.skip("the shared motion capture is not here")
    motion = read_bvh(path)
    got = retarget(motion)
    return motion, got.poses, got.translations


_CLIPS = {  # largest mean penalty for limits; largest median speed of the slower foot [m/s]
    "02_01": (0.1, 0.25), "07_01": (0.1, 0.25), "02_04": (0.5, 0.15), "06_10": (2, 0.15), "01_01_a": (1, 0.15),
    "09_01": (0.1, 2.0), "10_01": (0.1, 0.3), "13_26_a": (0.1, 0.3), "13_33": (0.1, 0.3), "13_18_a": (0.1, 0.4),
}  # fmt: skip


@pytest.mark.parametrize("name", list(_CLIPS))
def test_recorded_people_stay_human(name):
    motion, poses, translations = _recorded(name)
    joints = _joints(poses, translations)
    _, places = motion.world()
    limbs = map_joints(motion.names, motion.parents).limbs
    bones = _LIMB_BONES if name != "13_18_a" else [bone for bone in _LIMB_BONES if "elbow" not in JOINT_NAMES[bone[0]]]
    for start, end in bones:
        theirs = unit(places[:, limbs[JOINT_NAMES[end]]] - places[:, limbs[JOINT_NAMES[start]]])
        cosine = (theirs * unit(joints[:, end] - joints[:, start])).sum(-1)
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 0.01
    for side, sign in (("left", -1.0), ("right", 1.0)):
        assert np.percentile(poses[:, _J[f"{side}_knee"], 0], 2) > -0.15  # shins go back, forearms forward
        assert np.percentile(sign * poses[:, _J[f"{side}_elbow"], 1], 2) > -0.15
    assert not has_jump(MotionClip(name, poses, translations, motion.fps), 0, len(poses) / motion.fps)
    penalty, slow = _CLIPS[name]
    assert AnatomicalPrior().limit_penalty(torch.from_numpy(poses[:, 1:])).mean() < penalty
    up = rotate(from_axis_angle(poses[:, 0]), np.array([0, 1.0, 0]))[:, 1]
    assert np.median(up) > 0.9
    feet = np.linalg.norm(np.diff(joints[:, [_J["left_foot"], _J["right_foot"]]], axis=0), axis=-1) * motion.fps
    assert np.median(feet.min(1)) < slow
    assert -0.1 < np.percentile(joints[..., 1].min(1), 1) < 0.1
