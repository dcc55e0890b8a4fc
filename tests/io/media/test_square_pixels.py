"""Video whose pixels are not square is read as players show it: a ball stays round, however the camera was held."""

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_io import write_png
from hfb.io.media.plate import find_plate
from hfb.io.media.video.video_pixels import square_size, stretched
from hfb.io.media.video.video_reading import read_frames
from tests.io.media.videos import write_video

HEIGHT, WIDTH, RADIUS = 96, 120, 30


def ball(aspect: Fraction | int) -> np.ndarray:
    """A white ball of `RADIUS` rows, stored with pixels of this width / height; uint8 RGB on gray, smooth edge."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    distance = np.hypot((x - WIDTH / 2) * float(aspect), y - HEIGHT / 2)
    gray = 40 + 200 * np.clip(RADIUS + 0.5 - distance, 0, 1)
    return np.repeat(gray[..., None], 3, -1).astype(np.uint8)


def extent(frame: np.ndarray) -> tuple[float, float]:
    """How high and wide the ball is, to a part of a pixel."""
    share = (frame.mean(-1) - 40 / 255) / (200 / 255)
    return share.sum(0).max(), share.sum(1).max()


def turned(path: Path, source: Path) -> Path:
    """As a telephone held upright writes it: the container's matrix turns the frames clockwise."""
    data, one = bytearray(source.read_bytes()), 0x00010000
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, 0, one, 0, -one, 0, 0, 0, 0, 0x40000000)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("aspect", [Fraction(4, 3), Fraction(16, 15), Fraction(8, 9), Fraction(2)])
def test_a_ball_is_round(tmp_path: Path, aspect: Fraction) -> None:
    path = write_video(tmp_path / "wide.mp4", [ball(aspect)] * 5, options={"crf": "4"}, aspect=aspect)
    footage = open_footage(path)
    size = square_size(HEIGHT, WIDTH, float(aspect))
    assert (footage.height, footage.width) == size
    assert size[1] / size[0] == pytest.approx(WIDTH / HEIGHT * aspect, rel=0.01)
    assert size[0] >= HEIGHT
    assert size[1] >= WIDTH
    frame = next(footage.frames())
    high, wide = extent(frame)
    assert high == pytest.approx(wide, rel=0.02)
    assert high == pytest.approx(2 * RADIUS * size[0] / HEIGHT, rel=0.03)
    assert np.array_equal(frame, next(read_frames(path)))
    (remark,) = footage.remarks
    assert f"frames are stretched to {size[1]} x {size[0]}" in remark

    upright = open_footage(turned(tmp_path / "upright.mp4", path))
    assert (upright.height, upright.width) == (footage.width, footage.height)
    assert np.array_equal(next(upright.frames()), np.rot90(frame, -1))


@pytest.mark.parametrize("aspect", [Fraction(1), Fraction(405, 404), Fraction(2000), Fraction(1, 2000)])
def test_what_is_square_or_not_believed_stays(tmp_path: Path, aspect: Fraction) -> None:
    frames = [ball(1)] * 3
    path = write_video(tmp_path / "a.mp4", frames, aspect=aspect)
    footage = open_footage(path)
    plain = open_footage(write_video(tmp_path / "plain.mp4", frames))
    assert footage.remarks == ()
    assert np.array_equal(next(footage.frames()), next(plain.frames()))


def test_a_stream_without_a_size_is_refused(tmp_path: Path) -> None:
    data = bytearray(write_video(tmp_path / "whole.mp4", [ball(1)] * 3).read_bytes())
    entry, pixels = data.index(b"avc1", data.index(b"stsd")), data.index(b"mdat")
    data[entry + 28 : entry + 32] = bytes(4)  # its width and height
    for start in (data.index(b"avcC"), pixels):  # what else tells them
        size = struct.unpack_from(">I", data, start - 4)[0]
        data[start + 4 : start - 4 + size] = bytes(size - 8)
    path = tmp_path / "a.mp4"
    path.write_bytes(data)
    with pytest.raises(InputError, match="convert it to"):
        open_footage(path)


def test_a_background_out_of_the_same_video_fits(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene = np.kron(rng.integers(40, 200, (4, 5, 3)), np.ones((24, 24, 1))).astype(np.uint8)
    path = write_video(tmp_path / "wide.mp4", [scene] * 8, options={"crf": "4"}, aspect=Fraction(4, 3))
    stored = scene.astype(np.float32) / 255
    for source, plate in ((path, stored), (turned(tmp_path / "upright.mp4", path), np.rot90(stored, -1))):
        footage = open_footage(source)
        write_png(tmp_path / "plate.png", np.ascontiguousarray(plate))
        found, _ = find_plate(footage, tmp_path / "plate.png")
        assert np.abs(found - next(footage.frames())).mean() < 0.02
        write_png(tmp_path / "other.png", np.ascontiguousarray(plate[:-1]))
        with pytest.raises(InputError, match="background plate"):
            find_plate(footage, tmp_path / "other.png")


def test_a_stretched_frame_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_video(tmp_path / "wide.mp4", [ball(3)] * 2, aspect=Fraction(3))
    monkeypatch.setattr("hfb.io.media.video.video_file.PIXEL_LIMIT", 2 * HEIGHT * WIDTH)
    with pytest.raises(InputError, match=f"{3 * WIDTH} x {HEIGHT} pixels are over the limit"):
        open_footage(path)


@pytest.mark.parametrize("width", [160, 137, 91])
def test_what_is_stretched_stays_in_place(width: int) -> None:
    """A ramp shows where each pixel's light is from."""
    ramp = np.tile(np.arange(64, dtype=np.float32), (8, 1))[..., None].repeat(3, -1)
    wanted = (np.arange(width) + 0.5) * 64 / width - 0.5
    inside = slice(width // 8, -width // 8)
    np.testing.assert_allclose(stretched(ramp, 8, width)[4, inside, 0], wanted[inside], atol=0.02)
