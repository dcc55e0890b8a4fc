"""Videos that are written: whole or not at all, at the times and in the colours that were given."""

import os
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from hfb.io.media.video.video_writing import VideoWriter


def read(path: Path) -> tuple[list[float], list[np.ndarray], av.container.InputContainer]:
    container = av.open(str(path))
    frames = list(container.decode(video=0))
    return (
        [float(frame.pts * frame.time_base) for frame in frames],
        [f.to_ndarray(format="rgb24") for f in frames],
        container,
    )


def flat(*colour: float) -> np.ndarray:
    return np.full((48, 64, 3), colour, np.float32)


def test_exact_times_and_colours(tmp_path: Path) -> None:
    times_s = [0.0, 1 / 210, 2 / 210, 0.1, 0.1047619]
    colours = [flat(0.8, 0.1, 0.1), flat(0.1, 0.7, 0.2), flat(0.2, 0.2, 0.9), flat(0.5, 0.5, 0.5), flat(1, 1, 0)]
    with VideoWriter(tmp_path / "v.mp4", None, "a comment") as writer:
        for time_s, picture in zip(times_s, colours, strict=True):
            writer.write(picture, time_s)
    shown, pictures, container = read(tmp_path / "v.mp4")
    np.testing.assert_allclose(shown, times_s, atol=6e-7)
    for seen, given in zip(pictures, colours, strict=True):
        assert np.abs(seen / 255 - given).max() < 0.02
    stream = container.streams.video[0]
    assert stream.codec_context.name == "h264"
    assert (stream.codec_context.colorspace, stream.codec_context.color_trc) == (1, 13)
    assert container.metadata["comment"] == "a comment"
    data = (tmp_path / "v.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # a browser shows it while it loads


def test_constant_rate_and_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        with VideoWriter(tmp_path / name, 30) as writer:
            for level in np.linspace(0, 1, 7):
                writer.write(flat(level, level, level))
    shown, pictures, _ = read(tmp_path / "a.mp4")
    np.testing.assert_allclose(shown, np.arange(7) / 30, atol=1e-4)
    assert pictures[-1].min() > 250
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


FILM = """
import sys
from pathlib import Path
import numpy as np
from hfb.io.media.video.video_writing import VideoWriter
with VideoWriter(Path(sys.argv[1]), 30) as writer:
    for picture in np.random.default_rng(0).random((6, 128, 178, 3)).astype(np.float32):
        writer.write(picture)
"""


@pytest.mark.integration
def test_bytes_do_not_depend_on_what_lay_in_memory(tmp_path: Path) -> None:
    for level in ("1", "255"):  # glibc fills memory with it before it hands it out
        filled = {"MALLOC_PERTURB_": level, "MALLOC_MMAP_THRESHOLD_": str(1 << 30), "MALLOC_TOP_PAD_": str(1 << 26)}
        words = [sys.executable, "-c", FILM, str(tmp_path / f"{level}.mp4")]
        subprocess.run(words, check=True, env={**os.environ, **filled})
    assert (tmp_path / "1.mp4").read_bytes() == (tmp_path / "255.mp4").read_bytes()


def test_nothing_is_left_of_a_video_that_was_not_finished(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="all the input array"):
        fail_half_way(tmp_path / "v.mp4")
    assert list(tmp_path.iterdir()) == []


def fail_half_way(path: Path) -> None:
    with VideoWriter(path, 30) as writer:
        writer.write(flat(0, 0, 0))
        np.concatenate([np.zeros(1), np.zeros((1, 1))])
