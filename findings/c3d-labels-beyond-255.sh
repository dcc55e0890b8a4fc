#!/usr/bin/env bash
# C3D: of 300 named points both c3d and ezc3d list 255 labels, while the frames have all 300; the rest is in another parameter.
#
# Guess (2026-11-28): as many labels as points are read, since files of more than 255 points are usual (bodies' surfaces, two persons' markers).
# Seen with c3d 0.6.0 and ezc3d 1.7.2: `point_labels` has 255 entries for frames of 300 points. `LABELS2` has the others, which ezc3d writes
# by itself and does not put together again when it reads.
# So: join POINT:LABELS, LABELS2 ... before labels and points are zipped, which is silent about what is left over.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check c3d==0.6.0 ezc3d==1.7.2 numpy==2.4.6
cd "$place"
"$place/venv/bin/python" - <<'PY' 2>/dev/null
import c3d
import ezc3d
import numpy as np

COUNT = 300
written = ezc3d.c3d()
written["parameters"]["POINT"]["RATE"]["value"] = [100.0]
written["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
written["parameters"]["POINT"]["LABELS"]["value"] = [f"p{number:03d}" for number in range(COUNT)]
written["data"]["points"] = np.random.default_rng(0).random((4, COUNT, 5)) * 1000
written.write("many.c3d")
read = ezc3d.c3d("many.c3d")
point = read["parameters"]["POINT"]
ezc3d_counts = len(point["LABELS"]["value"]), len(point["LABELS2"]["value"]), read["data"]["points"].shape[1]
with open("many.c3d", "rb") as file:
    reader = c3d.Reader(file)
    c3d_counts = len(reader.point_labels), next(iter(reader.read_frames()))[1].shape[0]
print("ezc3d (labels, labels 2, points):", ezc3d_counts, "c3d (labels, points):", c3d_counts)
assert ezc3d_counts == (255, 45, 300) and c3d_counts == (255, 300)
print(f"c3d 0.6.0, ezc3d {ezc3d.__version__}: as found")
PY
