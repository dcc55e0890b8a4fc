#!/usr/bin/env bash
# OpenCV: undistortPoints stops after five steps, .8 px beside the point of a common wide lens; Rodrigues makes turns below 1e-5 rad nothing.
#
# Guesses (2026-11-28): undistortPoints inverts projectPoints to .05 px inside of a 1920 x 1080 image; Rodrigues there and back keeps 5e-6 rad.
# Seen with OpenCV 5.0.0.93: with f = 1000 px, k1 = -.25 and k2 = .06 the error is .82 px at worst and above .1 px for a quarter of the image, although
# it runs in float64; with `criteria` of 50 steps it is 1e-12 px. A rotation matrix of 9e-6 rad has the vector 0 0 0; one of 2e-5 rad is kept.
# So: always pass `criteria` before triangulating; keep small corrections of a camera as vectors, never by way of a matrix.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import cv2
import numpy as np

K, lens = np.array([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]]), np.array([-0.25, 0.06, 0, 0])
x, y = np.meshgrid(np.linspace(-0.9, 0.9, 37), np.linspace(-0.55, 0.55, 23))
rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], -1)
stored, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, lens)
inside = ((stored[:, 0] >= 0) & (stored[:, 0] < [1920, 1080])).all(1)
truth = rays[inside, :2] * 1000 + [960, 540]


def errors_px(**options):
    return np.linalg.norm(cv2.undistortPoints(stored[inside], K, lens, P=K, **options)[:, 0] - truth, axis=1)


usual, steps = errors_px(), errors_px(criteria=(cv2.TERM_CRITERIA_COUNT, 50, 0))
print(f"by default {usual.max():.3f} px, {(usual > 0.1).mean():.0%} above .1 px; with 50 steps {steps.max():.1e} px")
assert usual.max() > 0.5 and (usual > 0.1).mean() > 0.15 and steps.max() < 1e-9
kept = {angle: float(cv2.Rodrigues(cv2.Rodrigues(np.array([angle, 0, 0]))[0])[0][0, 0]) for angle in (2e-5, 9e-6, 5e-6)}
print("there and back [rad]:", kept)
assert abs(kept[2e-5] - 2e-5) < 1e-12 and kept[9e-6] == kept[5e-6] == 0
print(f"OpenCV {cv2.__version__}: as found")
PY
