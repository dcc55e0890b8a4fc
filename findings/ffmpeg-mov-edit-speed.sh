#!/usr/bin/env bash
# FFmpeg: the speed of an edit in an MP4 or QuickTime file is not applied: slow motion plays fast, and of fast motion only the beginning is read.
#
# Guess (2026-11-28): an edit list's rate changes times (1/8: eight times as long), as QuickTime's specification and its player have it.
# Seen with av 18.1.0 (libavformat 62): of 24 frames in .8 s an edit of 6.4 s at 1/8 is read as .8 s. An edit of .4 s at twice the speed, which shows
# all 24 frames, is read as the first 12 of them.
# So: read the edit list's rate oneself where footage may be slow motion, and count frames against the sample table.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY' 2>/dev/null
import io
import struct

import av
import numpy as np

file = io.BytesIO()
with av.open(file, "w", format="mp4") as video:
    stream = video.add_stream("libx264", rate=30, options={"bf": "0"})
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    for number in range(24):
        frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 10 * number, np.uint8), format="rgb24")
        video.mux(stream.encode(frame))
    video.mux(stream.encode())
plain = file.getvalue()
edit = plain.index(b"elst") + 12  # version, flags, one entry: duration [ms], media time, rate
duration, start, *_ = struct.unpack(">IIhh", plain[edit : edit + 12])


def read(speed):
    entry = struct.pack(">III", int(duration / speed), start, int(speed * 65536))
    with av.open(io.BytesIO(plain[:edit] + entry + plain[edit + 12 :])) as video:
        times = [frame.time for frame in video.decode(video=0)]
    return len(times), round(times[-1] + 1 / 30, 3)


found = {speed: read(speed) for speed in (1, 0.125, 2)}
print("speed: (frames, seconds):", found, "- by the edit list 0.8, 6.4 and 0.4 s of 24 frames")
assert found == {1: (24, 0.8), 0.125: (24, 0.8), 2: (12, 0.4)}, found
print(f"av {av.__version__}: as found")
PY
