#!/usr/bin/env bash
# trc-data-reader: an empty cell of a TRC row moves every marker behind it one name ahead; the last ones become NaN.
#
# Guess (2026-11-29): a marker whose three cells are empty, as Pose2Sim and Sports2D write a gap, is NaN, and the others stay.
# Seen with trc-data-reader 0.4.1: rows are split at any white space, so that B has the place of C, without a word. `NaN` in the cells is read right.
# So: write gaps as NaN (hfb does), or read such files by pandas with sep="\t".
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check trc-data-reader==0.4.1
cd "$place"; "$place/venv/bin/python" - <<'PY'
import importlib.metadata
import math

from trc import TRCData

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t2\t3\tmm\t100\t1\t2\nFrame#\tTime\tA\t\t\tB\t\t\tC\t\t\n\t\t" + "\t".join(f"{axis}{n}" for n in (1, 2, 3) for axis in "XYZ") + "\n\n"
)
found = {}
for word in ("", "NaN"):
    with open("a.trc", "w") as file:
        file.write(HEAD + "1\t0.00\t1\t1\t1\t2\t2\t2\t3\t3\t3\n" + "\t".join(["2", "0.01", *"111", word, word, word, *"333"]) + "\n")
    read = TRCData()
    read.load("a.trc")
    found[word] = {name: read[name][1] for name in "ABC"}
print("second row, B unknown, C at 3:", found)
assert found[""]["B"] == [3, 3, 3] and all(map(math.isnan, found[""]["C"])), found
assert all(map(math.isnan, found["NaN"]["B"])) and found["NaN"]["C"] == [3, 3, 3], found
print(f"trc-data-reader {importlib.metadata.version('trc-data-reader')}: as found")
PY
