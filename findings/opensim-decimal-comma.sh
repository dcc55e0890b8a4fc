#!/usr/bin/env bash
# OpenSim: a TRC file with decimal commas is read without a word, every coordinate cut to whole millimetres.
#
# Guess (2026-11-29): of BVH files, where it held, that every reader refuses decimal commas, which programs of a German or French locale write.
# Seen with opensim 4.6: 636,96 is 636; pandas, Pose2Sim's reader and the BVH readers refuse such numbers.
# So: look for commas in a TRC file that comes from elsewhere; hfb takes them for decimals.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check opensim==4.6 numpy==2.4.6
cd "$place"; "$place/venv/bin/python" - <<'PY'
import opensim

opensim.Logger.setLevelString("Off")
with open("a.trc", "w") as file:
    file.write(
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
        "100\t100\t2\t1\tmm\t100\t1\t2\nFrame#\tTime\tA\t\t\n\t\tX1\tY1\tZ1\n\n1\t0.00\t636,96\t12,5\t-3,75\n2\t0.01\t637,02\t12,5\t-3,75\n"
    )
table = opensim.TimeSeriesTableVec3("a.trc")
found = [table.getRowAtIndex(0)[0][axis] for axis in range(3)]
print("636,96 12,5 -3,75 are", found)
assert found == [636, 12, -3], found
print(f"opensim {opensim.__version__}: as found")
PY
