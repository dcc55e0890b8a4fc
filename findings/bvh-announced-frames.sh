#!/usr/bin/env bash
# BVH: of a file that is cut off, pymotion makes up the missing frames, all zeros, and bvh reports frames that it does not have.
#
# No guess was written down: it came up beside one about TRC files that are cut off, which every reader takes as they are.
# Seen with upc-pymotion 0.3.4 and bvh 0.3: 4 frames, the last two a person in the rest pose at the origin; bvh says 4 and raises an IndexError at the third.
# pybvh 0.9.0 refuses the file, as hfb does. Blender 5.0.1 reads the frames that are there.
# So: compare the rows with the number of frames before a recording is used.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check upc-pymotion==0.3.4 bvh==0.3 pybvh==0.9.0 numpy==2.4.6
cd "$place"; "$place/venv/bin/python" - <<'PY'
import importlib.metadata

import bvh
import numpy as np
import pybvh
from pymotion.io.bvh import BVH

TEXT = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 4
Frame Time: 0.01
1 90 2 10 20 30 5 6 7
1 90 2 10 20 30 5 6 7
"""
with open("a.bvh", "w") as file:
    file.write(TEXT)
read = BVH()
read.load("a.bvh")
turns = np.asarray(read.data["rotations"])
announced = bvh.Bvh(TEXT)
try:
    announced.frame_joint_channel(3, "Spine", "Xrotation")
    raised = False
except IndexError:
    raised = True
try:
    pybvh.read_bvh_file("a.bvh")
    refused = False
except ValueError:
    refused = True
print("pymotion:", turns.shape, np.abs(turns).max((1, 2)), "bvh:", announced.nframes, raised, "pybvh refuses:", refused)
assert len(turns) == 4 and np.abs(turns[1]).max() > 5 and not turns[2:].any()
assert announced.nframes == 4 and raised and refused
print(", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("upc-pymotion", "bvh", "pybvh")) + ": as found")
PY
