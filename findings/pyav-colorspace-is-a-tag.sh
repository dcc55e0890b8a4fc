#!/usr/bin/env bash
# PyAV: `colorspace` and `color_range` of an encoder are written into the file and change no pixel; RGB frames are converted by BT.601.
#
# Guess (2026-11-28): an encoder that is told BT.709 converts its RGB frames by BT.709.
# Seen with av 18.1.0: luma and chroma of a red are the same whatever the encoder is told. The file says BT.709, so the red is read back with
# green 55 for 40; one that says full range is read back pale (189 for 200).
# So: convert frames by `reformat(format=..., dst_colorspace=..., dst_color_range=...)` before they are encoded, and set the tags as well.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY' 2>/dev/null
import io

import av
import numpy as np

RED = np.broadcast_to(np.uint8([200, 40, 40]), (64, 64, 3)).copy()
BT601, BT709, LIMITED, FULL = 5, 1, 1, 2


def through_a_file(colorspace, color_range):
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as video:
        stream = video.add_stream("libx264", rate=30, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv444p"
        stream.codec_context.colorspace, stream.codec_context.color_range = colorspace, color_range
        video.mux(stream.encode(av.VideoFrame.from_ndarray(RED, format="rgb24")))
        video.mux(stream.encode())
    file.seek(0)
    with av.open(file) as video:
        frame = next(video.decode(video=0))
    stored = [int(np.frombuffer(plane, np.uint8)[0]) for plane in frame.planes]
    return stored, (int(frame.colorspace), int(frame.color_range)), frame.to_ndarray(format="rgb24")[0, 0].tolist()


found = {told: through_a_file(*told) for told in ((BT601, LIMITED), (BT709, LIMITED), (BT601, FULL))}
for told, (stored, tags, read) in found.items():
    print(f"told {told}: stored {stored}, the file says {tags}, read as {read}")
    assert stored == [91, 104, 198] and tags == told, found  # BT.601, limited range
assert found[BT601, LIMITED][2] == [199, 40, 39], found
assert found[BT709, LIMITED][2] == [213, 55, 37], found
assert found[BT601, FULL][2] == [189, 49, 48], found
print(f"av {av.__version__}: as found")
PY
