"""Measured joints: what is written is read, what is damaged is refused in one sentence."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.real.markers import Markers, body_columns, read_joints_npz, read_trc, smpl_joint
from hfb.datasets.real.truth_source import truth_kind, truth_offsets_mm
from hfb.errors import InputError
from tests.datasets.real.videos import write_trc
from tests.shared import SHARED_DATA

_NAMES = ("RHip", "LWrist", "Neck")


def _points() -> np.ndarray:
    points = np.random.default_rng(0).normal(0, 1, (5, 3, 3))
    points[2, 1] = points[3, 2] = np.nan
    return points


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_a_trc_comes_back_in_metres_with_its_gaps(tmp_path: Path, unit: str) -> None:
    write_trc(tmp_path / "a.trc", _points(), _NAMES, 60, unit)
    read = read_trc(tmp_path / "a.trc")
    assert read.names == _NAMES
    assert read.rate_hz == 60
    assert read.frames.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(read.xyz_m, _points(), atol=1e-12)


def test_a_half_known_point_is_unknown_and_cut_off_gaps_are_gaps(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", _points(), _NAMES, 60)
    lines = (tmp_path / "a.trc").read_text().splitlines()
    cells = lines[5].split("\t")
    cells[3] = ""
    lines[5], lines[8] = "\t".join(cells), lines[8].rstrip("\t")
    (tmp_path / "a.trc").write_text("\n".join(lines))
    read = read_trc(tmp_path / "a.trc")
    assert np.isnan(read.xyz_m[0, 0]).all()
    assert np.isnan(read.xyz_m[3, 2]).all()


@pytest.mark.parametrize("word", ["0.00000", "0", "-0.0", "NaN", "nan"])
def test_lost_markers_that_are_written_as_numbers(tmp_path: Path, word: str) -> None:
    write_trc(tmp_path / "a.trc", _points(), _NAMES, 60)
    lines = (tmp_path / "a.trc").read_text().splitlines()
    cells = lines[5].split("\t")
    cells[2:5] = [word] * 3
    cells[5] = "0"  # a coordinate alone may be zero
    lines[5] = "\t".join(cells)
    (tmp_path / "a.trc").write_text("\n".join(lines))
    read = read_trc(tmp_path / "a.trc")
    assert np.isnan(read.xyz_m[0, 0]).all()
    assert read.xyz_m[0, 1, 0] == 0


@pytest.mark.parametrize("code", ["cp1252", "utf-16", "utf-8-sig"])
def test_a_path_in_the_writers_own_code_and_decimal_commas(tmp_path: Path, code: str) -> None:
    write_trc(tmp_path / "a.trc", _points(), _NAMES, 60)
    text = (tmp_path / "a.trc").read_text().replace("a.trc", "C:\\Users\\Jörg\\a.trc", 1)
    head, rows = text.split("\n", 5)[:5], text.split("\n", 5)[5]
    (tmp_path / "a.trc").write_bytes("\r\n".join([*head, rows.replace(".", ",")]).encode(code))
    assert "Jörg" in text
    np.testing.assert_allclose(read_trc(tmp_path / "a.trc").xyz_m, _points(), atol=1e-12)


@pytest.mark.parametrize(("stated", "true", "digits"), [("60", 60 / 1.001, 6), ("240", 240, 3)])
def test_times_that_are_rounded_or_contradict_the_rate(tmp_path: Path, stated: str, true: float, digits: int) -> None:
    """OpenSim goes by the times, whatever DataRate says."""
    points = np.random.default_rng(0).normal(0, 1, (900, 3, 3))
    write_trc(tmp_path / "a.trc", points, _NAMES, int(stated))
    lines = (tmp_path / "a.trc").read_text().splitlines()
    for number, line in enumerate(lines[5:]):
        count, _, rest = line.split("\t", 2)
        lines[5 + number] = f"{count}\t{number / true:.{digits}f}\t{rest}"
    (tmp_path / "a.trc").write_text("\n".join(lines))
    read = read_trc(tmp_path / "a.trc")
    assert read.rate_hz == pytest.approx(true, rel=1e-5)
    np.testing.assert_array_equal(read.frames, np.arange(900))


def test_rows_are_placed_by_their_time(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", _points(), _NAMES, 60)
    lines = (tmp_path / "a.trc").read_text().splitlines()
    for number, line in enumerate(lines[5:], start=5):
        _, _, rest = line.split("\t", 2)
        lines[number] = f"{number}\t{(number + 5) / 60:.5f}\t{rest}"  # rows 10 .. 14
    (tmp_path / "a.trc").write_text("\n".join(lines))
    read = read_trc(tmp_path / "a.trc")
    rows = read.rows(9, 3)
    assert np.isnan(rows[0]).all()
    np.testing.assert_allclose(rows[1:], _points()[:2], atol=1e-9)
    assert np.isnan(read.rows(15, 2)).all()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("PathFileType", "Path", "PathFileType"),
        ("\tm\t", "\tfurlong\t", "Units"),
        ("60\t60\t5\t3", "60\t60\t5\t4", "NumMarkers"),
        ("60\t60\t5\t3", "-1\t60\t5\t3", "DataRate"),
        ("60\t60\t5\t3", "nan\t60\t5\t3", "DataRate"),
        ("RHip", "Neck", "one name"),
        ("\n1\t", "\n1\tsoon\t", "line 7"),
        ("\n1\t0.016666666666666666", "\n1\t0.02", "do not lie on its DataRate"),
        ("\n1\t0.016666666666666666", "\n1\t0.1", "increase"),
        ("\n1\t0.016666666666666666", "\n1\tinf", "line 7"),
        ("\n1\t0.016666666666666666", "\n1\t0.016666666666666666\t1e9", "line 7"),
    ],
)
def test_a_damaged_trc_is_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    write_trc(tmp_path / "a.trc", np.random.default_rng(1).normal(0, 1, (5, 3, 3)), _NAMES, 60)
    text = (tmp_path / "a.trc").read_text()
    assert old in text
    (tmp_path / "a.trc").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=says):
        read_trc(tmp_path / "a.trc")


def test_a_wrong_unit_shows(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", 1500 * np.ones((2, 3, 3)), _NAMES, 60)
    with pytest.raises(InputError, match="units"):
        read_trc(tmp_path / "a.trc")


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00\x01", b"PathFileType\t4\n" * 3, b"\x00" * 1000])
def test_what_is_no_trc(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.trc").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.trc"):
        read_trc(tmp_path / "a.trc")
    with pytest.raises(InputError, match=r"no\.trc"):
        read_trc(tmp_path / "no.trc")


def test_joints_npz(tmp_path: Path) -> None:
    good = {"frames": np.arange(3, 8), "names": np.array(_NAMES), "xyz": _points().astype(np.float32)}
    np.savez(tmp_path / "good.npz", **good)
    read = read_joints_npz(tmp_path / "good.npz")
    assert read.names == _NAMES
    assert read.rate_hz is None
    np.testing.assert_allclose(read.rows(3, 5), _points(), atol=1e-6)
    bad = {
        "xyz": good["xyz"][:, :2],
        "names": np.array([{"a": 1}] * 3, object),
        "frames": np.array([3, 3, 4, 5, 6]),
    }
    for name, value in bad.items():
        np.savez(tmp_path / "bad.npz", **(good | {name: value}))
        with pytest.raises(InputError, match=r"bad\.npz"):
            read_joints_npz(tmp_path / "bad.npz")
    np.savez(tmp_path / "bad.npz", frames=good["frames"], names=good["names"])
    with pytest.raises(InputError, match="xyz"):
        read_joints_npz(tmp_path / "bad.npz")
    (tmp_path / "bad.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:200])
    with pytest.raises(InputError, match=r"bad\.npz"):
        read_joints_npz(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        ("RHip", "right_hip"),
        ("LKnee", "left_knee"),
        ("left_wrist", "left_wrist"),
        ("Right Ankle", "right_ankle"),
        ("l_shoulder", "left_shoulder"),
        ("RElbow", "right_elbow"),
        ("ankle.left", "left_ankle"),
        ("Anna:RHip", "right_hip"),
        ("Anna:LHJC", "left_hip"),
        ("RKJC", "right_knee"),
        ("LWJC", "left_wrist"),
        ("HJC", None),
        ("Neck", None),
        ("Nose", None),
        ("Head", None),
        ("Hip", None),
        ("CHip", None),
        ("RBigToe", None),
        ("LHeel", None),
        ("left", None),
        ("", None),
    ],
)
def test_names_of_joints(name: str, joint: str | None) -> None:
    assert smpl_joint(name) == (None if joint is None else JOINT_NAMES.index(joint))


def test_columns_follow_the_joints_order() -> None:
    assert body_columns(("LWrist", "Nose", "RHip", "right_hip", "LHip")) == ([4, 2, 0], [1, 2, 20])


def test_turning_up_undoes_pose2sims_own_turn(tmp_path: Path) -> None:
    z_up = _points()
    write_trc(tmp_path / "a.trc", z_up[..., [1, 2, 0]], _NAMES, 60)  # as Pose2Sim writes: x = y, y = z, z = x
    np.testing.assert_allclose(read_trc(tmp_path / "a.trc").turned().xyz_m, z_up, atol=1e-12)


def _skeleton(bones_m: np.ndarray, bend_deg: np.ndarray) -> Markers:
    """A leg and an arm of given bone lengths over time that bend."""
    count = len(bend_deg)
    bend = np.deg2rad(bend_deg)
    middle = np.stack([0 * bend, 0 * bend, -bones_m], 1)
    end = middle + np.stack([np.sin(bend) * bones_m, 0 * bend, -np.cos(bend) * bones_m], 1)
    points = np.stack([np.zeros((count, 3)), middle, end], 1)
    names = ("RHip", "RKnee", "RAnkle", "LShoulder", "LElbow", "LWrist")
    return Markers(np.arange(count), None, names, np.concatenate([points, points + 1], 1))


def test_what_measured_joints_are() -> None:
    bend, rng = 30 * np.sin(np.arange(40) / 5), np.random.default_rng(0)
    rigid, noisy = np.full(40, 0.4), 0.4 + rng.normal(0, 0.01, 40)
    assert truth_kind(_skeleton(rigid, bend), cameras=1) == "markers"
    assert truth_kind(_skeleton(rigid, bend), cameras=3) == "markers"
    assert truth_kind(_skeleton(noisy, bend), cameras=1) == "measured"
    assert truth_kind(_skeleton(noisy, bend), cameras=2) == "multi-view"
    assert truth_kind(_skeleton(rigid, 0 * bend), cameras=2) == "multi-view"  # who does not move tells nothing
    assert truth_kind(replace(_skeleton(rigid, bend), views_known=True), cameras=1) == "multi-view"
    assert truth_kind(replace(_skeleton(noisy, bend), rate_hz=60.0), cameras=1) == "multi-view"  # Pose2Sim's .trc


@pytest.mark.parametrize(
    ("recording", "cameras", "kind"),
    [("opencap_walk_a", 1, "markers"), ("opencap_squat", 1, "markers"), ("pose2sim_balancing", 2, "multi-view")],
)
def test_what_the_shared_recordings_are(recording: str, cameras: int, kind: str) -> None:
    path = SHARED_DATA / recording / "joints3d.npz"
    if not path.is_file():
        pytest.skip("the shared recordings are not here")
    assert truth_kind(read_joints_npz(path), cameras) == kind


def test_offsets_of_joints_are_said() -> None:
    offsets = truth_offsets_mm(tuple(range(24)))
    assert offsets["left_hip"] == offsets["right_shoulder"] == (20, 50)
    assert set(offsets) == {"left_hip", "right_hip", "left_shoulder", "right_shoulder"}


def test_an_endless_time_is_told_shortly(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", _points(), _NAMES, 60)
    lines = (tmp_path / "a.trc").read_text().splitlines()
    lines[6] = "\t".join([lines[6].split("\t")[0], "9" * 5000, *lines[6].split("\t")[2:]])
    (tmp_path / "a.trc").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"line 7 has the time 9{40};"):
        read_trc(tmp_path / "a.trc")
