#!/usr/bin/env bash
# x264: the average of eight frames of a compressed video shows a still background no better than one of them.
#
# Guess (2026-11-28): the codec's errors of frames are independent enough that the average of 8 has a third of one's error.
# Seen with av 18.1.0 (libx264): a textured background behind a moving bar, 640 x 360, errors of one frame and of the average of eight differ
# by less than 10 %, at crf 23 and at 2 Mbit/s, with sensor noise (2 levels) too: skipped blocks carry one error through all frames.
# So: a long exposure made from K frames, or a plate as their median, keeps the codec's error of one frame; its noise is not a camera's.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import io

import av
import numpy as np

HEIGHT, WIDTH, FRAMES, BAR = 360, 640, 24, 40
random = np.random.default_rng(0)
coarse = random.normal(0, 25, (HEIGHT // 4 + 1, WIDTH // 4 + 1))
rows, columns = np.arange(HEIGHT) / 4, np.arange(WIDTH) / 4
lines = np.stack([np.interp(columns, np.arange(coarse.shape[1]), line) for line in coarse])
background = 120 + np.stack([np.interp(rows, np.arange(coarse.shape[0]), column) for column in lines.T], 1)
background = np.clip(background, 0, 255)


def decoded(noise, options):
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as video:
        stream = video.add_stream("libx264", rate=60, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for number in range(FRAMES):
            picture = background + random.normal(0, noise, background.shape)
            picture[100:260, 100 + 6 * number : 100 + 6 * number + BAR] = 230
            frame = av.VideoFrame.from_ndarray(np.clip(picture.round(), 0, 255).astype(np.uint8), format="gray")
            video.mux(stream.encode(frame.reformat(format="yuv420p", src_color_range="JPEG", dst_color_range="JPEG")))
        video.mux(stream.encode())
    file.seek(0)
    with av.open(file) as video:
        planes = [frame.planes[0] for frame in video.decode(video=0)]
    return np.array([np.frombuffer(p, np.uint8).reshape(p.height, p.line_size)[:, :WIDTH] for p in planes], float)


ratios = {}
still = np.s_[290:350, 20:620]
for noise in (0, 2):
    for options in ({"crf": "23"}, {"b": "2M"}):
        frames = decoded(noise, options)[8:16]
        error_of_one = np.mean([np.std((frame - background)[still]) for frame in frames])
        error_of_mean = np.std((frames.mean(0) - background)[still])
        ratios[noise, *options.items()] = error_of_one / error_of_mean
        print(f"noise {noise}, {options}: one frame {error_of_one:.2f} levels, average of eight {error_of_mean:.2f}")
assert all(0.95 < ratio < 1.15 for ratio in ratios.values()), ratios
print(f"av {av.__version__}: as found")
PY
