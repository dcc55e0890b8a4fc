"""Video: exact frames, rotation, averages in linear light, a bounded-memory plate."""

import struct
from pathlib import Path

import av
import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.media.video.video_reading import median_plate, read_frames


def _write_video(path: Path, frames: list[np.ndarray], codec: str = "libx264", pixels: str = "yuv444p") -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options={"qp": "0"} if codec == "libx264" else {})
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve gray frames: frame k has the level 10 k; a bright square wanders over the left half."""
    frames = []
    for k in range(12):
        frame = np.full((32, 48, 3), 10 * k, np.uint8)
        frame[:16, 4 * k : 4 * k + 4] = 255
        frames.append(frame)
    path = tmp_path_factory.mktemp("video") / "clip.mp4"
    _write_video(path, frames)
    return path


def test_frames_are_the_ones_asked_for(clip: Path) -> None:
    levels = [float(frame[24].mean() * 255) for frame in read_frames(clip, 3, 7)]
    assert np.allclose(levels, [30, 40, 50, 60], atol=1.5)
    assert len(list(read_frames(clip))) == 12
    assert len(list(read_frames(clip, 10, 99))) == 2


def test_plate_removes_what_moves_in_any_memory(clip: Path) -> None:
    plate = median_plate(clip, range(12))
    assert abs(plate[:16].mean() * 255 - 60) < 8
    assert plate.max() < 0.5
    assert np.array_equal(plate, median_plate(clip, range(12), memory_bytes=5000))
    with pytest.raises(InputError, match="no frame 20"):
        median_plate(clip, [0, 20])


@pytest.mark.parametrize(("start", "stop", "says"), [(12, None, "12 frames"), (3, 3, "empty range"), (-1, 2, "range")])
def test_ranges_outside(clip: Path, start: int, stop: int | None, says: str) -> None:
    with pytest.raises(InputError, match=says):
        list(read_frames(clip, start, stop))


def test_what_is_no_video(tmp_path: Path, clip: Path) -> None:
    for name, content, says in [("a.mp4", b"", "video"), ("b.mp4", b"text" * 100, "video"), ("c.mp4", None, "no such")]:
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=says):
            list(read_frames(tmp_path / name))
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(clip.read_bytes()[:600])
    with pytest.raises(InputError):
        list(read_frames(cut))


def test_the_containers_rotation_is_applied(tmp_path: Path, clip: Path) -> None:
    """A phone held upright writes lying frames and a matrix that turns them clockwise."""
    data = bytearray(clip.read_bytes())
    matrix = data.index(b"tkhd") + 4 + 40  # after version, flags, times, id, duration, layer, volume
    one = 0x00010000
    assert struct.unpack_from(">i", data, matrix)[0] == one
    struct.pack_into(">9i", data, matrix, 0, one, 0, -one, 0, 0, 0, 0, 0x40000000)
    (tmp_path / "turned.mp4").write_bytes(data)
    plain, turned = next(read_frames(clip)), next(read_frames(tmp_path / "turned.mp4"))
    assert np.array_equal(turned, np.rot90(plain, -1))


def test_more_than_eight_bits(tmp_path: Path) -> None:
    frames = [np.full((32, 32, 3), 100, np.uint8)] * 2
    try:
        _write_video(tmp_path / "deep.mp4", frames, "libx264", "yuv444p10le")
    except av.FFmpegError:
        pytest.skip("this build's H.264 encoder has no 10-bit profile")
    frame = next(read_frames(tmp_path / "deep.mp4"))
    assert np.allclose(frame * 255, 100, atol=1.5)
