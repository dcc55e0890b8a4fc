"""Every format without a surface, read back: our joints within a tenth of a millimetre, at the times they say."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.motions.files.bvh import read_bvh
from hfb.datasets.motions.files.smpl_motions import load_smpl_motion
from hfb.datasets.real.markers import read_trc
from hfb.errors import InputError
from hfb.geometry.placement import y_up, z_up
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.geometry.world import LEVEL
from hfb.interop.writers.amass import write_amass
from hfb.interop.writers.bvh import write_bvh
from hfb.interop.writers.c3d_file import c3d_bytes, write_c3d
from hfb.interop.writers.joint_tables import marker_table, write_csv, write_trc
from hfb.interop.writers.keys import even_keys
from hfb.motion.footing import standing_feet
from hfb.motion.sampled import SampledMotion
from tests.interop.writers.motions import joints_at, motion_of

BODY = load_default_body(torch.float64)
_BOUND_MM = 0.1
_Y_UP = np.array([1.0, -1.0, -1.0])
MOTIONS = {
    "one frame": motion_of(BODY, frames=1, exposure_s=1 / 30),
    "closed between": motion_of(BODY, frames=3),
    "always open": motion_of(BODY, frames=3, exposure_s=1 / 30),
}


@pytest.fixture(params=MOTIONS.values(), ids=MOTIONS.keys())
def motion(request: pytest.FixtureRequest) -> SampledMotion:
    return request.param


def worst_mm(read: np.ndarray, times_s: np.ndarray, motion: SampledMotion) -> float:
    """Largest distance of even samples, interpolated at the sub-frames' instants, from the motion's joints."""
    inside = motion.times_s <= times_s[-1] + 1e-9
    at = CubicSpline(times_s, read, axis=0)(motion.times_s[inside])
    return float(1000 * np.linalg.norm(at - motion.joints[inside], axis=-1).max())


def test_bvh(motion: SampledMotion, tmp_path: Path) -> None:
    path = tmp_path / "motion.bvh"
    write_bvh(path, motion)
    read = read_bvh(path)
    places = read.world()[1][:, [read.names.index(name) for name in JOINT_NAMES]] * _Y_UP
    times_s = np.arange(len(places)) / read.fps
    assert worst_mm(places, times_s, motion) < _BOUND_MM
    assert read.rest()[:, 1].max() > 0.3  # the rest pose stands upright
    assert read.rest()[:, 1].min() < -0.6


def test_trc(motion: SampledMotion, tmp_path: Path) -> None:
    path = tmp_path / "joints.trc"
    write_trc(path, motion)
    read = read_trc(path)
    assert read.names == JOINT_NAMES
    assert read.rate_hz is not None
    times_s = read.frames / read.rate_hz
    np.testing.assert_allclose(times_s, even_keys(motion, read.rate_hz).times_s, atol=1e-6)
    assert worst_mm(read.xyz_m * _Y_UP, times_s, motion) < _BOUND_MM


def test_c3d_by_a_reader_of_other_makers(motion: SampledMotion, tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    pytest.importorskip("c3d")
    path = tmp_path / "joints.c3d"
    write_c3d(path, motion)
    read = ezc3d.c3d(str(path))
    points = read["parameters"]["POINT"]
    assert tuple(points["LABELS"]["value"]) == JOINT_NAMES
    assert points["UNITS"]["value"] == ["mm"]
    places = read["data"]["points"][:3].transpose(2, 1, 0)[..., [0, 2, 1]] * [1, -1, 1] / 1000  # z is up
    times_s = np.arange(len(places)) / points["RATE"]["value"][0]
    assert worst_mm(places, times_s, motion) < _BOUND_MM


def test_csv_has_the_rows_of_the_motion_and_their_exact_times(motion: SampledMotion, tmp_path: Path) -> None:
    path = tmp_path / "joints.csv"
    write_csv(path, motion)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_allclose([float(row["time_s"]) for row in rows], motion.times_s, atol=1e-9)
    np.testing.assert_array_equal([int(row["frame"]) for row in rows], motion.frame_index)
    assert [int(row["sub_frame"]) for row in rows[:8]] == list(range(8))
    read = np.array([[[float(row[f"{name}_{axis}_m"]) for axis in "xyz"] for name in JOINT_NAMES] for row in rows])
    assert 1000 * np.linalg.norm(read - motion.joints, axis=-1).max() < _BOUND_MM
    radius = np.array([[float(row[f"{name}_radius_mm"]) for name in JOINT_NAMES] for row in rows])
    np.testing.assert_allclose(radius, motion.joint_radius_mm, atol=0.01)
    standing = [[int(row[f"{side}_foot_stands"]) for side in ("left", "right")] for row in rows]
    np.testing.assert_array_equal(standing, standing_feet(motion, np.array([0.0, -1, 0])))
    write_csv(path, replace(motion, joint_radius_mm=None))
    assert "radius" not in path.read_text()


@pytest.mark.parametrize("rate", [30, 60, 120])
def test_amass(rate: int, tmp_path: Path) -> None:
    motion = motion_of(BODY, frames=5)
    path = tmp_path / "amass.npz"
    write_amass(path, motion, "hfb", rate)
    with np.load(path, allow_pickle=False) as file:
        content = {name: file[name] for name in file.files}
    count = int(motion.times_s[-1] * rate + 1e-9) + 1
    assert content["poses"].shape == (count, 156)
    assert content["dmpls"].shape == (count, 8)
    assert float(content["mocap_framerate"]) == rate
    assert not content["poses"][:, 66:].any()

    times_s = np.arange(count) / rate
    shaped = BODY.shape(torch.from_numpy(motion.betas))
    body_poses = np.pad(content["poses"][:, :66], ((0, 0), (0, 6)))
    rotations = axis_angle_to_matrix(torch.from_numpy(body_poses).unflatten(1, (24, 3)))
    joints = shaped.joints_of(rotations, torch.from_numpy(content["trans"])).numpy()
    true = joints_at(times_s, BODY, motion.betas)[..., [0, 2, 1]] * [1.0, 1.0, -1.0]  # the camera looks along +y
    seen = content["hfb_observed"]
    assert 1000 * np.linalg.norm(joints - true, axis=-1)[seen].max() < _BOUND_MM
    np.testing.assert_allclose(joints[:, :22], content["hfb_joints"][:, :22], atol=1e-4)
    assert joints[0, 15, 2] > joints[0, 7, 2] + 1  # the head is above the ankle: z is up

    clip = load_smpl_motion(path, "again")  # our own reader of AMASS takes it too
    assert clip.fps == rate
    assert clip.poses.shape == (count, 24, 3)


def test_amass_marks_whose_betas_it_has(tmp_path: Path) -> None:
    motion = motion_of(BODY, frames=1)
    for space, betas in (("hfb", np.zeros(16)), ("smpl", np.pad(motion.betas, (0, 6)))):
        write_amass(tmp_path / "amass.npz", motion, space)
        with np.load(tmp_path / "amass.npz", allow_pickle=False) as file:
            assert str(file["betas_space"]) == space
            np.testing.assert_array_equal(file["betas"], betas)
            np.testing.assert_array_equal(file["hfb_betas"], motion.betas)


def test_rows_in_which_the_person_is_absent_are_empty(tmp_path: Path) -> None:
    motion = motion_of(BODY, frames=9, missing=(3, 4, 5))
    write_trc(tmp_path / "joints.trc", motion)
    read = read_trc(tmp_path / "joints.trc")
    times_s = read.frames / 350
    gone = (times_s > 2 / 30 + 0.02) & (times_s < 6 / 30 - 1e-9)
    np.testing.assert_array_equal(np.isnan(read.xyz_m).all((1, 2)), gone)
    assert gone.sum() > 20
    rows = [line.split("\t") for line in (tmp_path / "joints.trc").read_text().splitlines()[6:]]
    assert {len(row) for row in rows} == {2 + 3 * 24}
    assert {cell for row, away in zip(rows, gone, strict=True) if away for cell in row[2:]} == {"NaN"}
    ezc3d = pytest.importorskip("ezc3d")
    write_c3d(tmp_path / "joints.c3d", motion)
    points = ezc3d.c3d(str(tmp_path / "joints.c3d"))["data"]["points"]
    np.testing.assert_array_equal(np.isnan(points[0]).all(0), gone)


def test_lost_points_of_a_c3d_are_zeros_with_a_negative_residual(tmp_path: Path) -> None:
    c3d = pytest.importorskip("c3d")
    motion = motion_of(BODY, frames=9, missing=(3, 4, 5))
    write_c3d(tmp_path / "joints.c3d", motion)
    with (tmp_path / "joints.c3d").open("rb") as file, pytest.warns(UserWarning, match="No analog data"):
        points = np.array([frame for _, frame, _ in c3d.Reader(file).read_frames()])
    rate, _, places = marker_table(motion, z_up(LEVEL))
    gone = np.isnan(places[:, 0, 0])
    assert gone.sum() > 20
    np.testing.assert_array_equal(points[gone][..., :3], 0)  # not the last place where the person was seen
    assert (points[gone][..., 3] == -1).all()
    np.testing.assert_allclose(points[~gone][..., :3], places[~gone], atol=1e-3)
    assert rate == 350


def test_opensim_reads_a_table_with_a_gap(tmp_path: Path) -> None:
    """OpenSim itself; its wheel has 72 MB, so that it is no requirement of the tests."""
    opensim = pytest.importorskip("opensim", reason="OpenSim is not here: pip install opensim (Python 3.11)")
    motion = motion_of(BODY, frames=9, missing=(0, 3, 4, 5, 8))
    write_trc(tmp_path / "joints.trc", motion)
    table = opensim.TimeSeriesTableVec3(str(tmp_path / "joints.trc"))
    rate, times_s, places = marker_table(motion, y_up(LEVEL))
    flat = table.flatten()
    read = np.stack([flat.getDependentColumn(label).to_numpy() for label in flat.getColumnLabels()], -1)
    np.testing.assert_allclose(read.reshape(places.shape), places, atol=1e-3)  # NaN at the same places
    np.testing.assert_allclose(table.getIndependentColumn(), times_s, atol=1e-6)
    assert table.getColumnLabels() == JOINT_NAMES
    facts = {key: table.getTableMetaDataString(key) for key in ("DataRate", "Units")}
    assert (float(facts["DataRate"]), facts["Units"]) == (rate, "mm")
    assert opensim.MarkerData(str(tmp_path / "joints.trc")).getNumFrames() == len(times_s)


def test_the_same_motion_gives_the_same_bytes(tmp_path: Path) -> None:
    motion = motion_of(BODY)
    for name, write in (("a.bvh", write_bvh), ("a.trc", write_trc), ("a.csv", write_csv), ("a.c3d", write_c3d)):
        write(tmp_path / name, motion)
        first = (tmp_path / name).read_bytes()
        write(tmp_path / name, motion)
        assert (tmp_path / name).read_bytes() == first
        assert [path.name for path in tmp_path.iterdir() if ".part" in path.name] == []


def test_c3d_without_its_library_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hfb.interop.writers.export_names.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"\.\[c3d\]"):
        c3d_bytes(motion_of(BODY, frames=1))
