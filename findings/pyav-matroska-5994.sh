#!/usr/bin/env bash
# PyAV: a Matroska file written at 60000/1001 frames a second says 19001/317 when it is read, and AVI with B-frames has times that run back.
#
# Guess (2026-11-28): the rate that a stream was made with is the rate that is read, as for MP4; times of decoded frames rise.
# Seen with av 18.1.0 (libavformat 62.12): MP4, MOV, AVI and MPEG-TS keep 60000/1001. Matroska and WebM store whole milliseconds and no
# rate: the reader guesses it from the times. H.264 in AVI has no presentation times: decoded frames
# step back by three intervals.
# So: compare rates with a tolerance of one tick, and count frames where times do not rise.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY' 2>/dev/null
import io
from fractions import Fraction

import av
import numpy as np

RATE = Fraction(60000, 1001)


def written(form):
    file = io.BytesIO()
    with av.open(file, "w", format=form) as video:
        stream = video.add_stream("libx264", rate=RATE)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(12):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 10 * number, np.uint8), format="rgb24")
            video.mux(stream.encode(frame))
        video.mux(stream.encode())
    file.seek(0)
    return file


rates, steps = {}, {}
for form in ("mp4", "mov", "mpegts", "avi", "matroska"):
    with av.open(written(form)) as video:
        stream = video.streams.video[0]
        times = [float(frame.time) for frame in video.decode(stream)]
        rates[form], steps[form] = stream.average_rate, float(np.diff(times).min())
print({form: str(rate) for form, rate in rates.items()}, "smallest step in AVI [s]:", round(steps["avi"], 4))
assert all(rates[form] == RATE for form in ("mp4", "mov", "mpegts", "avi")), rates
assert rates["matroska"] == Fraction(19001, 317), rates
assert steps["avi"] < 0 < min(step for form, step in steps.items() if form != "avi"), steps
print(f"av {av.__version__}: as found")
PY
