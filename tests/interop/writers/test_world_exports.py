"""Every export of a calibrated motion, read back and compared in the calibration's world."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.config import WorldUp
from hfb.datasets.motions.files.bvh import read_bvh
from hfb.datasets.real.markers import read_trc
from hfb.geometry.placement import in_world, world_of_pose, world_of_up
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.interop.writers.amass import write_amass
from hfb.interop.writers.bvh import write_bvh
from hfb.interop.writers.c3d_file import write_c3d
from hfb.interop.writers.export_world import describe_world
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.joint_tables import write_csv, write_trc
from hfb.interop.writers.keys import even_keys
from hfb.interop.writers.mesh_files import write_meshes
from hfb.interop.writers.skinned_glb import skinned_glb
from hfb.motion.sampled import SampledMotion
from tests.interop.writers.motions import joints_at, motion_of
from tests.interop.writers.test_skinned_glb import Glb

BODY = load_default_body(torch.float64)
MOTION = motion_of(BODY, frames=2)
_R = Rotation.from_euler("xyz", [112, 17, -40], degrees=True).as_matrix()
_T = np.array([0.4, -0.7, 2.5])
_BOUND_MM = 1.0
_OF_Z_UP = {
    "z": np.eye(3),
    "-z": np.diag([1, -1, -1]),
    "y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
}
"""From a world with z up to the calibration's own axes: its second row is up, for example, where y is."""


@pytest.fixture(params=["z", "-z", "y", "-y"])
def up(request: pytest.FixtureRequest) -> WorldUp:
    return request.param


@pytest.fixture
def motion(up: WorldUp) -> SampledMotion:
    return replace(MOTION, world=world_of_pose(_R, _T, up))


def true_world(points: np.ndarray) -> np.ndarray:
    """From the camera's frame to the calibration's world: x = R X + t, solved for X."""
    return np.linalg.solve(_R, (points - _T).reshape(-1, 3).T).T.reshape(points.shape)


def of_y_up(points: np.ndarray, up: WorldUp) -> np.ndarray:
    """From the y up of files to the calibration's axes, by way of what Blender makes of them."""
    return points[..., [0, 2, 1]] * [1, -1, 1] @ _OF_Z_UP[up].T


def apart_mm(one: np.ndarray, other: np.ndarray) -> float:
    return float(1000 * np.linalg.norm(one - other, axis=-1).max())


def test_all_formats_hold_the_calibrations_world(motion: SampledMotion, up: WorldUp, tmp_path: Path) -> None:
    pytest.importorskip("c3d")
    ezc3d = pytest.importorskip("ezc3d")
    keys = even_keys(motion, 350)
    true = true_world(keys.places)

    write_trc(tmp_path / "joints.trc", motion)
    read = read_trc(tmp_path / "joints.trc")
    table = read.turned().xyz_m if up == "z" else of_y_up(read.xyz_m, up)
    assert apart_mm(table, true) < _BOUND_MM

    write_c3d(tmp_path / "joints.c3d", motion)
    points = ezc3d.c3d(str(tmp_path / "joints.c3d"))
    assert points["parameters"]["POINT"]["Y_SCREEN"]["value"] == ["+Z"]
    assert apart_mm(points["data"]["points"][:3].transpose(2, 1, 0) / 1000 @ _OF_Z_UP[up].T, true) < _BOUND_MM

    write_bvh(tmp_path / "motion.bvh", motion)
    bvh = read_bvh(tmp_path / "motion.bvh")
    places = bvh.world()[1][:, [bvh.names.index(name) for name in JOINT_NAMES]]
    assert apart_mm(of_y_up(places, up), true) < _BOUND_MM

    glb = Glb(skinned_glb(Exported(motion, "hfb", load_default_body())))
    nodes = glb.document["skins"][0]["joints"]
    posed = [glb.posed(glb.document["animations"][0], key) for key in range(len(motion.times_s))]
    shown = np.array([[worlds[node][:3, 3] for node in nodes] for worlds in posed])
    assert apart_mm(of_y_up(shown, up), true_world(motion.joints)) < _BOUND_MM
    assert glb.document["asset"]["extras"]["world"] == "calibration"

    write_csv(tmp_path / "joints.csv", motion, "world")
    with (tmp_path / "joints.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    values = [[[float(row[f"{name}_world_{axis}_m"]) for axis in "xyz"] for name in JOINT_NAMES] for row in rows]
    assert apart_mm(np.array(values), true_world(motion.joints)) < _BOUND_MM
    write_csv(tmp_path / "joints.csv", motion)
    assert "world" not in (tmp_path / "joints.csv").read_text()


def test_amass_holds_the_calibrations_world_with_z_up(motion: SampledMotion, up: WorldUp, tmp_path: Path) -> None:
    write_amass(tmp_path / "amass.npz", motion, "hfb", 120)
    with np.load(tmp_path / "amass.npz", allow_pickle=False) as file:
        content = {name: file[name] for name in file.files}
    assert str(content["hfb_world"]) == "calibration"
    rotations = axis_angle_to_matrix(
        torch.from_numpy(np.pad(content["poses"][:, :66], ((0, 0), (0, 6)))).unflatten(1, (24, 3))
    )
    shaped = BODY.shape(torch.from_numpy(motion.betas))
    joints = shaped.joints_of(rotations, torch.from_numpy(content["trans"])).numpy()
    true = true_world(joints_at(np.arange(len(joints)) / 120, BODY, motion.betas))
    seen = content["hfb_observed"]
    assert apart_mm(joints[seen] @ _OF_Z_UP[up].T, true[seen]) < _BOUND_MM
    assert apart_mm(content["hfb_joints"][seen] @ _OF_Z_UP[up].T, true[seen]) < _BOUND_MM


def test_meshes_lie_in_the_calibrations_world(motion: SampledMotion, up: WorldUp, tmp_path: Path) -> None:
    path = next(write_meshes(tmp_path, motion, BODY, "ply"))
    shaped = BODY.shape(torch.from_numpy(motion.betas))
    rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses[:1]).unflatten(1, (24, 3)))
    vertices = shaped.pose(rotations, torch.from_numpy(motion.trans[:1])).vertices[0].numpy()
    read = np.asarray(trimesh.load(path, process=False).vertices)
    assert apart_mm(of_y_up(read, up), true_world(vertices)) < _BOUND_MM


def test_a_stated_direction_turns_about_the_camera() -> None:
    """The camera looks down by 30 degrees: 2 m along its axis are 1 m below it."""
    world = world_of_up(np.array([0.0, -np.cos(np.pi / 6), -0.5]))
    np.testing.assert_allclose(in_world(world).points(np.array([[0.0, 0, 2]])), [[0, np.sqrt(3), -1]], atol=1e-12)
    facts = describe_world(replace(MOTION, world=world))
    assert (facts.source, facts.tilt_deg, facts.roll_deg) == ("options", 30.0, 0.0)
    assert "--camera.tilt-deg" in describe_world(MOTION).says
    assert describe_world(MOTION).doubtful


def test_a_person_who_contradicts_the_calibration_is_said(up: WorldUp) -> None:
    """Somebody upright in the world, while another axis than the right one is given as up."""
    level = world_of_pose(_level_camera(up), _T, up)
    assert not describe_world(replace(MOTION, world=level)).doubtful
    for wrong in sorted({"z", "-z", "y", "-y"} - {up}):
        facts = describe_world(replace(MOTION, world=level.model_copy(update={"up": wrong})))
        assert facts.doubtful
        assert facts.lean_deg > 60
        assert facts.says.endswith(f"give --camera.world-up={up}")


def test_a_translation_in_other_units_is_said() -> None:
    """A camera 1.2 m above the floor and 4 m before the person, and the same in decimetres."""
    far = {unit: world_of_pose(_level_camera("z"), unit * np.array([0, 1.2, 4.0]), "z") for unit in (1, 10)}
    assert not describe_world(replace(MOTION, world=far[1])).doubtful
    facts = describe_world(replace(MOTION, world=far[10]))
    assert facts.doubtful
    assert facts.says.endswith("give its translation in metres")


def _level_camera(up: WorldUp) -> np.ndarray:
    """World to camera of a level one: the world's up is -y there."""
    return np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) @ np.linalg.inv(_OF_Z_UP[up])
