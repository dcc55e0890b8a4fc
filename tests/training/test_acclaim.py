"""CMU's own recordings become BVH files that motions are read from."""

from pathlib import Path

import numpy as np
import pytest

from hfb.datasets.motions.folder import FolderMotions
from hfb.training.confidence import acclaim
from tests.shared import SHARED_DATA

ROOT = Path(__file__).parents[2]


def test_a_take_is_the_same_motion_as_in_another_conversion(tmp_path: Path) -> None:
    """A run of subject 2, retargeted by somebody else to another skeleton: knees and elbows bend alike."""
    if not (SHARED_DATA / "cmu_amc").is_dir():
        pytest.skip(f"{SHARED_DATA / 'cmu_amc'} is not there")
    root = acclaim.read_skeleton((SHARED_DATA / "cmu_amc" / "02.asf").read_text())
    frames = acclaim.read_take((SHARED_DATA / "cmu_amc" / "02_03.amc").read_text())
    (tmp_path / "cmu_02_03.bvh").write_text(acclaim.bvh(root, frames))
    mine = FolderMotions(tmp_path).load(0)
    assert mine.fps == pytest.approx(120)
    assert len(mine.poses) == len(frames)
    theirs = FolderMotions(SHARED_DATA / "cmu_bvh")
    other = theirs.load(list(theirs.names()).index("cmu_02_03.bvh"))
    ours = mine.poses[:: round(mine.fps / other.fps)]
    for joint in (4, 5, 18, 19):
        bends = [np.linalg.norm(poses[:, joint], axis=-1) for poses in (ours, other.poses)]
        count = min(map(len, bends))
        best = max(
            np.corrcoef(bends[0][shift : shift + count - 20], bends[1][: count - 20])[0, 1] for shift in range(20)
        )
        assert best > 0.9, joint
