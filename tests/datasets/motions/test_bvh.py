"""BVH: angles in the file's own order, places from its channels, and a sentence for everything that is broken."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hfb.datasets.motions.files.bvh import read_bvh
from hfb.errors import InputError

_ARM = """HIERARCHY
ROOT Hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Arm
  {
    OFFSET 0 10 0
    CHANNELS 3 Yrotation Zrotation Xrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 3
Frame Time: .0083333
0 90 0 90 0 0 0 0 0
1 90 0 0 0 90 30 -40 50
2 90 0 10 20 30 0 0 90
"""


def _write(folder: Path, text: str | bytes) -> Path:
    path = folder / "clip.bvh"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_angles_places_and_rate(tmp_path, newline):
    motion = read_bvh(_write(tmp_path, _ARM.replace("\n", newline)))
    assert motion.names == ("Hips", "Left Arm")
    assert motion.parents == (-1, 0)
    assert motion.fps == 120
    np.testing.assert_array_equal(motion.ends, [[0, 0, 0], [0, 5, 0]])
    rotations, places = motion.world()
    np.testing.assert_allclose(places[0, 1], [-10, 90, 0], atol=1e-12)  # up, turned by a right angle about z
    np.testing.assert_allclose(places[1, 1], [1, 100, 0], atol=1e-12)
    expected = Rotation.from_euler("YXZ", [90, 0, 0], degrees=True)  # of frame 1; capital letters: about its own axes
    expected = expected * Rotation.from_euler("YZX", [30, -40, 50], degrees=True)
    got = Rotation.from_quat(rotations[1, 1], scalar_first=True)
    assert (got.inv() * expected).magnitude() < 1e-12
    third = Rotation.from_quat(rotations[2, 0], scalar_first=True)
    assert (third.inv() * Rotation.from_euler("ZXY", [10, 20, 30], degrees=True)).magnitude() < 1e-12
    np.testing.assert_array_equal(motion.rest(), [[1, 2, 3], [1, 12, 3]])


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("HIERARCHY", "HIERARCHIE", "does not begin with HIERARCHY"),
        ("MOTION", "", "no MOTION"),
        ("OFFSET 0 10 0", "OFFSET 0 ten 0", "line 8.*ten"),
        ("OFFSET 0 10 0", "OFFSET 0 nan 0", "line 8"),
        ("OFFSET 0 10 0", "", "line 14.*no OFFSET"),
        ("Yrotation Zrotation Xrotation", "Yrotation Yrotation Xrotation", "line 9"),
        ("Yrotation Zrotation Xrotation", "Yrotation Wrotation Xrotation", "line 9"),
        ("CHANNELS 3", "CHANNELS 3000000000", "line 9"),
        ("CHANNELS 3", "CHANNELS 2", "line 9"),
        ("JOINT", "JUNK", "line 6.*JUNK"),
        ("JOINT Left Arm", "ROOT Left Arm", "line 6"),
        ("  }\n}\n", "  }\n", "not closed"),
        ("Frames: 3", "Frames: many", "line 17.*Frames"),
        ("Frames: 3", "Frames: 999999999", "announces 999999999 frames and has 3"),
        ("Frames: 3", "Frames: 1", "1 frames"),
        ("Frame Time: .0083333", "Frame Time: 0", "line 18.*Frame Time"),
        ("Frame Time: .0083333", "Frame Time: nan", "line 18"),
        ("1 90 0 0 0 90 30 -40 50\n", "1 90 0 0 0 90 30 -40\n", "line 20 has 8 values.*9 channels"),
        ("1 90 0 0 0 90 30 -40 50\n", "1 90 0 0 0 nan 30 -40 50\n", "line 20.*not finite"),
        ("1 90 0 0 0 90 30 -40 50\n", "1 90 0 0 0 x 30 -40 50\n", "line 20.*not a row of numbers"),
        ("2 90 0 10 20 30 0 0 90\n", "", "announces 3 frames and has 2"),
        ("2 90 0 10 20 30 0 0 90\n", "2 90 0 10", "line 21 has 4 values"),
    ],
)
def test_broken_files_say_where(tmp_path, old, new, reason):
    text = _ARM.replace(old, new, 1)
    assert text != _ARM
    with pytest.raises(InputError, match=reason) as caught:
        read_bvh(_write(tmp_path, text))
    assert "clip.bvh" in str(caught.value)


@pytest.mark.parametrize(
    ("written", "fps"),
    [("0.033", 30), (".0333", 30), ("0.017", 60), ("0.042", 24), ("0.0083", 120), ("0.008", 125), ("0.0334", 29.94)],
)
def test_a_rounded_frame_time(tmp_path, written, fps):
    motion = read_bvh(_write(tmp_path, _ARM.replace(".0083333", written)))
    assert motion.fps == pytest.approx(fps, abs=0.001)


def test_any_cut_is_an_input_error(tmp_path):
    data = _ARM.encode()
    for length in range(0, len(data) - 25, 7):
        with pytest.raises(InputError):
            read_bvh(_write(tmp_path, data[:length]))


def test_bytes_that_are_no_text_and_no_file(tmp_path):
    with pytest.raises(InputError, match="HIERARCHY"):
        read_bvh(_write(tmp_path, bytes(range(256)) * 10))
    with pytest.raises(InputError, match="cannot be read"):
        read_bvh(tmp_path / "none.bvh")


def test_a_skeleton_of_endless_joints_is_refused(tmp_path):
    with pytest.raises(InputError, match="more than 1000 joints"):
        read_bvh(_write(tmp_path, "HIERARCHY\nROOT a\n{\n" + "JOINT b\n{\n" * 100_000 + "MOTION\n"))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("MOTION\n", "MOTION\n\n"),
        ("MOTION\n", "Motion\n \n\t\n"),
        ("End Site", "End site"),
        ("End Site", "END SITE"),
        ("End Site", "End Site left_end"),
        ("OFFSET 0 5 0\n", "OFFSET 0 5 0\n      CHANNELS 0\n"),
        ("JOINT", "joint"),
        ("HIERARCHY", "Hierarchy"),
        ("Frames: 3", "FRAMES:3"),
        ("Frames: 3", "Frames:\t3\n"),
        ("Frame Time: .0083333", "Frame time:  0.00833333"),
        ("0 0 90\n", "0 0 90\n\n\n"),
        ("Zrotation Xrotation Yrotation", "ZROTATION xrotation YRotation"),
    ],
)
def test_harmless_variants_of_exporters(tmp_path, old, new):
    text = _ARM.replace(old, new, 1)
    assert text != _ARM
    got, same = read_bvh(_write(tmp_path, text)), read_bvh(_write(tmp_path, _ARM))
    np.testing.assert_array_equal(got.ends, same.ends)
    np.testing.assert_array_equal(got.rotations, same.rotations)
    np.testing.assert_array_equal(got.places, same.places)
    for encoding in ("utf-16", "utf-8-sig"):
        again = read_bvh(_write(tmp_path, text.encode(encoding)))
        np.testing.assert_array_equal(again.places, same.places)
    again = read_bvh(_write(tmp_path, text.replace("\n", "\r")))
    np.testing.assert_array_equal(again.places, same.places)


@pytest.mark.parametrize("more", [1, 3])
def test_more_rows_than_announced_are_read_with_a_remark(tmp_path, caplog, more):
    motion = read_bvh(_write(tmp_path, _ARM + "2 91 0 10 20 30 0 0 90\n" * more))
    assert len(motion.places) == 3 + more
    assert motion.places[-1, 0, 1] == 91
    assert f"announces 3 frames and has {3 + more}" in caplog.text
    with pytest.raises(InputError, match="line 22 has 3 values"):
        read_bvh(_write(tmp_path, _ARM + "2 91 0\n"))


def test_position_channels_of_joints(tmp_path):
    """They are the place itself (Blender, MotionBuilder), but where they stay at zero they are added to the offset."""
    text = _ARM.replace("CHANNELS 3 Yr", "CHANNELS 6 Xposition Yposition Zposition Yr")
    rows = [line for line in text.splitlines() if line[0].isdigit()]
    for place, expected in (("0 12 0", [0, 12, 0]), ("0 0 12", [0, 0, 12]), ("0 0.5 0", [0, 10.5, 0])):
        moved = text
        for row in rows:
            words = row.split()
            moved = moved.replace(row, " ".join([*words[:6], place, *words[6:]]))
        np.testing.assert_array_equal(read_bvh(_write(tmp_path, moved)).places[:, 1], [expected] * 3)
