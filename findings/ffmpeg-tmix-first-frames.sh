#!/usr/bin/env bash
# FFmpeg's tmix: the first K - 1 of its pictures are no means of K frames, and means of an even number are rounded up.
#
# Guess (2026-11-28): `tmix=frames=8`, a common way to make long exposures, first gives the mean of the first eight frames; means have no bias.
# Seen with av 18.1.0 (libavfilter 11): as many pictures as frames come out, the first as if it had been there eight times; of eight random
# frames the mean is .06 levels too bright (halves are rounded up).
# So: drop the first K - 1 pictures, or they show an exposure that no camera made; picture n ends with frame n, its middle lies (K - 1) / 2 earlier.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import av
import numpy as np
from av.filter import Graph


def mixed(frames, count):
    graph = Graph()
    source = graph.add_buffer(width=frames[0].shape[1], height=frames[0].shape[0], format="gray", time_base="1/60")
    mix, sink = graph.add("tmix", f"frames={count}"), graph.add("buffersink")
    source.link_to(mix)
    mix.link_to(sink)
    graph.configure()
    pictures = []
    for number, values in enumerate([*frames, None]):
        frame = None if values is None else av.VideoFrame.from_ndarray(values, format="gray")
        if frame is not None:
            frame.pts = number
        graph.push(frame)
        while True:
            try:
                pictures.append(graph.pull().to_ndarray())
            except (av.BlockingIOError, av.EOFError):
                break
    return pictures


steps = [int(picture[0, 0]) for picture in mixed([np.full((16, 16), 10 * n, np.uint8) for n in range(1, 13)], 8)]
print("frames 10, 20 ... 120 mixed by eight:", steps)
assert steps == [10, 11, 14, 18, 23, 29, 36, 45, 55, 65, 75, 85], steps
random = np.random.default_rng(0)
frames = [random.integers(0, 256, (128, 128)).astype(np.uint8) for _ in range(24)]
bias = {}
for count in (5, 8):
    pictures = mixed(frames, count)[count - 1 :]
    bias[count] = np.mean([picture - np.mean(frames[k : k + count], 0) for k, picture in enumerate(pictures)])
print("bias [levels]:", {count: round(float(value), 4) for count, value in bias.items()})
assert abs(bias[5]) < 0.01 and 0.055 < bias[8] < 0.07, bias
print(f"av {av.__version__}: as found")
PY
