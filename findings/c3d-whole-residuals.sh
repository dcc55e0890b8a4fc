#!/usr/bin/env bash
# c3d: a file of floats keeps residuals as whole numbers from 0 to 255 (.4 is 0, 300 is 44); one of integers keeps volts as whole numbers.
#
# Guesses (2026-11-28): a residual of .5 mm comes back as .5 from a file of floats; analog values come back to 1e-4.
# Seen with c3d 0.6.0: the format packs a residual into one byte, in units of POINT:SCALE, which is -1 for floats, whose coordinates are exact all the
# same. With `point_scale=.1` the residuals are kept to .1, but analog channels become whole numbers (3.14 V is 3), as their own scale is 1. No warning.
# So: choose |point_scale| for the residuals (above 255 steps they wrap round), and give analog channels a scale of their own in files of integers.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check c3d==0.6.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import importlib.metadata
import io

import c3d
import numpy as np

RESIDUALS = (0.4, 0.9, 1.7, 300.0)


def read_back(point_scale, analog_scale=None):
    writer = c3d.Writer(point_rate=100, analog_rate=200, point_scale=point_scale, point_units="mm")
    writer.set_point_labels(["A", "B", "C"])
    writer.set_analog_labels(["force"])
    if analog_scale is not None:
        writer.set_analog_scales([analog_scale])
    frames = []
    for residual in RESIDUALS:
        points = np.zeros((3, 5), np.float32)
        points[:, :3], points[:, 3] = 100.25, residual
        frames.append((points, np.full((1, 2), 3.14, np.float32)))
    writer.add_frames(frames)
    writer.set_start_frame(1)
    file = io.BytesIO()
    writer.write(file)
    file.seek(0)
    read = list(c3d.Reader(file).read_frames())
    return [float(round(points[0, 3], 3)) for _, points, _ in read], float(read[0][1][0, 0]), float(read[0][2][0, 0])


floats, wholes, scaled = read_back(-1.0), read_back(0.1), read_back(0.1, 0.001)
print("floats (residuals, coordinate, volts):", floats)
print("integers:", wholes, "- with an analog scale of .001:", scaled)
assert floats[0] == [0, 1, 2, 44] and floats[1] == 100.25 and abs(floats[2] - 3.14) < 1e-6, floats
assert np.allclose(wholes[0][:3], RESIDUALS[:3], atol=1e-3) and wholes[2] == 3 and abs(scaled[2] - 3.14) < 0.002, (wholes, scaled)
print(f"c3d {importlib.metadata.version('c3d')}: as found")
PY
