#!/usr/bin/env bash
# pyomeca: neither the .mot that OpenSim writes nor an ordinary TRC file opens.
#
# Guess (2026-11-29): Analogs.from_mot and Markers.from_trc read both, angles in degrees.
# Seen with pyomeca 2026.0.2 and pandas 3.1.1: IndexError. An empty line of the header, which OpenSim's and Sports2D's files have, ends the search for
# `endheader`; reading the table of a TRC file ends in an index that is out of bounds.
# So: read both by pandas (a .mot's table begins below `endheader`), or by opensim.TimeSeriesTable.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check pyomeca==2026.0.2 pandas==3.1.1 numpy==2.4.6
cd "$place"; "$place/venv/bin/python" - <<'PY' 2>/dev/null
import importlib.metadata

from pyomeca import Analogs, Markers

with open("a.mot", "w") as file:
    file.write(
        "Coordinates\nversion=1\nnRows=3\nnColumns=2\ninDegrees=yes\n\nUnits are S.I. units\n\nendheader\ntime\tknee\n0.00\t1\n0.01\t2\n0.02\t3\n"
    )
with open("a.trc", "w") as file:
    file.write(
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
        "100\t100\t3\t1\tmm\t100\t1\t3\nFrame#\tTime\tA\t\t\n\t\tX1\tY1\tZ1\n\n1\t0.00\t1\t2\t3\n2\t0.01\t1\t2\t3\n3\t0.02\t1\t2\t3\n"
    )
found = []
for read, name in ((Analogs.from_mot, "a.mot"), (Markers.from_trc, "a.trc")):
    try:
        read(name)
        found.append("read")
    except IndexError as error:
        found.append(f"IndexError: {error}")
print(found)
assert all(one.startswith("IndexError") for one in found), found
print(", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("pyomeca", "pandas")) + ": as found")
PY
