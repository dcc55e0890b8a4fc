"""The folder opensim/ in OpenSim itself."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.flows.cli.cli import main
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.interop.writers.opensim_files import write_opensim
from hfb.motion.motion_file import save_motion
from hfb.motion.sampled import SampledMotion
from tests.interop.writers.motions import motion_of

pytestmark = pytest.mark.integration

BODY = load_default_body(torch.float64)
_BENT = ("pelvis", "hip", "knee", "spine1", "shoulder", "elbow")
_MOST_MM, _MOST_DEG = 1.0, 0.5
_LOOK = """
import json, numpy as np, opensim
opensim.Logger.removeFileSink()
model = opensim.Model("model.osim")
state = model.initSystem()
tool = opensim.InverseKinematicsTool("ik_setup.xml")
assert tool.run()
seen, found = opensim.TimeSeriesTableVec3("markers.trc"), opensim.TimeSeriesTable("motion.mot")
apart = []
for row in range(found.getNumRows()):
    values, markers = found.getRowAtIndex(row), seen.getRowAtIndex(row)
    for number, name in enumerate(found.getColumnLabels()):
        coordinate = model.getCoordinateSet().get(name)
        turns = coordinate.getMotionType() == opensim.Coordinate.Rotational
        coordinate.setValue(state, np.radians(values[number]) if turns else values[number], False)
    model.realizePosition(state)
    for number, name in enumerate(seen.getColumnLabels()):
        place = model.getMarkerSet().get(name).getLocationInGround(state).to_numpy()
        apart.append(float(np.linalg.norm(1000 * place - markers[number].to_numpy())))
print("FOUND " + json.dumps({
    "rows": found.getNumRows(), "mm": apart, "tasks": tool.get_IKTaskSet().getSize(),
    "knee": found.getDependentColumn("knee_angle_l").to_numpy().tolist(),
}))
"""


def bending() -> SampledMotion:
    """`motion_of` with its knees and elbows as hinges and nothing but the larger joints bent."""
    motion = motion_of(BODY, frames=2)
    poses = motion.poses.reshape(-1, 24, 3) * [[name.rpartition("_")[2] in _BENT] for name in JOINT_NAMES]
    for name, axis, sign in (("left_knee", 0, 1), ("right_knee", 0, 1), ("left_elbow", 1, -1), ("right_elbow", 1, 1)):
        joint = JOINT_NAMES.index(name)
        poses[:, joint] = np.eye(3)[axis] * (0.6 + poses[:, joint, axis : axis + 1]) * sign
    shaped = BODY.shape(torch.from_numpy(motion.betas))
    joints = shaped.joints_of(axis_angle_to_matrix(torch.from_numpy(poses)), torch.from_numpy(motion.trans)).numpy()
    return replace(motion, poses=poses.reshape(-1, 72), joints=joints)


def test_opensim_opens_them_and_its_motion_meets_the_markers(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("opensim", reason="OpenSim is not installed")
    motion = bending()
    save_motion(tmp_path / "motion.npz", motion, "hfb")
    assert main(["export", str(tmp_path / "motion.npz"), "--formats", "mot", "--json"]) == 0
    folder = tmp_path / "export" / "opensim"
    names = {"model.osim", "ik_setup.xml", "markers.trc", "motion.mot"}
    assert {path.name for path in folder.iterdir()} == names | {".hfb-files.json"}
    told = json.loads(capsys.readouterr().out.splitlines()[-1])["files"]
    assert told == {f"opensim/{name}": (folder / name).stat().st_size for name in names}

    done = subprocess.run([sys.executable, "-c", _LOOK], cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "warning" not in (done.stdout + done.stderr).lower()
    found = json.loads(done.stdout.partition("FOUND ")[2])
    assert found["tasks"] == 24
    assert np.sqrt(np.mean(np.square(found["mm"]))) < _MOST_MM
    bent_deg = np.degrees(motion.poses[:, 3 * JOINT_NAMES.index("left_knee")])
    assert np.abs(np.array(found["knee"][:8]) - bent_deg[:8]).max() < _MOST_DEG  # the first exposure's sub-frames


def test_the_longest_stretch_with_the_person(tmp_path: Path) -> None:
    """OpenSim refuses times without any marker."""
    pytest.importorskip("opensim", reason="OpenSim is not installed")
    motion = motion_of(BODY, frames=6, missing=(2,))
    write_opensim(tmp_path, motion)
    rows = (tmp_path / "motion.mot").read_text().splitlines()
    assert float(rows[-1].split()[0]) == pytest.approx(motion.times_s[-1], abs=0.002)
    start_s = motion.times_s[motion.frame_index == 3][0]
    first = next(number for number, row in enumerate(rows) if row.startswith("time")) + 1
    assert float(rows[first].split()[0]) == pytest.approx(start_s, abs=0.003)
