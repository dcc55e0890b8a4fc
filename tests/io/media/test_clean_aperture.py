"""Video with a clean aperture (`clap`) is read as players show it: cropped, then stretched and turned."""

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.clip import ClipCamera
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_io import write_png
from hfb.io.media.lens.clip_lens import clip_lens
from hfb.io.media.plate import find_plate
from hfb.io.media.video.video_pixels import stretched
from hfb.io.media.video.video_reading import read_frames
from tests.io.media.mp4 import with_box, with_matrix
from tests.io.media.videos import picture, write_video

HEIGHT, WIDTH = 48, 64
FRAMES = [picture(number) for number in range(12)]
ENTRY = [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd"]
Aperture = tuple[int, int, int, int, int, int, int, int]


def with_aperture(path: Path, source: Path, aperture: bytes | Aperture, entry: bytes = b"avc1") -> Path:
    """The aperture's width, height, and its centre's distance to the frame's: numerators and denominators."""
    content = aperture if isinstance(aperture, bytes) else struct.pack(">4IiIiI", *aperture)
    return with_box(path, source, [*ENTRY, entry], b"clap", content)


def rows(path: Path) -> np.ndarray:
    return np.stack(list(open_footage(path).frames()))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("clap") / "plain.mp4", FRAMES, options={"bf": "2", "g": "4"})


@pytest.mark.parametrize(
    ("aperture", "shown"),
    [
        ((48, 1, 40, 1, 0, 1, 0, 1), (slice(4, 44), slice(8, 56))),
        ((48, 1, 40, 1, -4, 1, 6, 2), (slice(7, 47), slice(4, 52))),
        ((49, 1, 41, 1, 1, 2, -1, 2), (slice(3, 44), slice(8, 57))),
        ((64, 1, 46, 1, 0, 1, -1, 1), (slice(0, 46), slice(0, 64))),
        ((480, 9, 48, 1, 0, 1, 0, 1), (slice(0, 48), slice(5, 58))),  # PAL's 702.9 of 720 columns: FFmpeg shows 703
    ],
)
def test_frames_are_cropped(tmp_path: Path, plain: Path, aperture: Aperture, shown: tuple[slice, slice]) -> None:
    path = with_aperture(tmp_path / "a.mp4", plain, aperture)
    wanted, footage = rows(plain)[:, shown[0], shown[1]], open_footage(path)
    assert (footage.height, footage.width) == wanted.shape[1:3]
    assert np.array_equal(rows(path), wanted)
    assert np.array_equal(list(footage.frames(6, 9)), wanted[6:9])
    assert np.array_equal(list(read_frames(path)), wanted)
    (remark,) = footage.remarks
    edges = shown[0].start, HEIGHT - shown[0].stop, shown[1].start, WIDTH - shown[1].stop
    assert "a.mp4 has a clean aperture: frames are cropped to it by {}, {}, {}, {} px (top, ".format(*edges) in remark


def test_a_cropped_frame_is_turned_and_stretched(tmp_path: Path) -> None:
    aspect = Fraction(4, 3)
    stored = write_video(tmp_path / "plain.mp4", FRAMES, aspect=aspect)
    cropped = rows(write_video(tmp_path / "square.mp4", FRAMES))[0, 3:43, 8:56]
    path = with_aperture(tmp_path / "a.mp4", stored, (48, 1, 40, 1, 0, 1, -1, 1))
    frame = rows(path)[0]
    np.testing.assert_allclose(frame, stretched(cropped, 40, 64).clip(0, 1), atol=0.01)
    upright = with_matrix(tmp_path / "upright.mp4", path, (0, 1, -1, 0))
    assert np.array_equal(rows(upright)[0], np.rot90(frame, -1))


def test_a_track_as_large_as_its_aperture_has_square_pixels(tmp_path: Path, plain: Path) -> None:
    """As QuickTime writes it; FFmpeg takes the shape of the pixels from the track's size and the stored one."""
    path = with_aperture(tmp_path / "a.mp4", plain, (48, 1, 40, 1, 0, 1, 0, 1))
    data = bytearray(path.read_bytes())
    struct.pack_into(">2I", data, data.index(b"tkhd") + 80, 48 << 16, 40 << 16)
    path.write_bytes(data)
    assert np.array_equal(rows(path), rows(plain)[:, 4:44, 8:56])


@pytest.mark.parametrize(
    "aperture",
    [
        (64, 1, 48, 1, 0, 1, 0, 1),
        (48, 0, 40, 1, 0, 1, 0, 1),
        (48, 1, 40, 1, 0, 0, 0, 1),
        (65, 1, 40, 1, 0, 1, 0, 1),
        (48, 1, 40, 1, 9, 1, 0, 1),
        (48, 1, 40, 1, 0, 1, -5, 1),
        (0, 1, 40, 1, 0, 1, 0, 1),
        (1, 2**32 - 1, 40, 1, 0, 1, 0, 1),
        b"\0" * 31,
        b"",
    ],
)
def test_one_without_effect_or_sense_is_ignored(tmp_path: Path, plain: Path, aperture: bytes | Aperture) -> None:
    path = with_aperture(tmp_path / "a.mp4", plain, aperture)
    assert open_footage(path).remarks == ()
    assert np.array_equal(rows(path), rows(plain))


def test_frames_that_the_decoder_has_cropped_stay(tmp_path: Path, plain: Path) -> None:
    """Of 1088 lines H.264's own crop leaves 1080; an aperture that says so once more is for the entry's size."""
    path = with_aperture(tmp_path / "a.mp4", plain, (64, 1, 48, 1, 0, 1, -4, 1))
    data = bytearray(path.read_bytes())
    struct.pack_into(">H", data, data.index(b"stsd") + 46, 56)
    struct.pack_into(">I", data, data.index(b"tkhd") + 84, 56 << 16)
    path.write_bytes(data)
    assert np.array_equal(rows(path), rows(plain))


def test_plates_and_calibrations_are_of_what_is_shown(tmp_path: Path) -> None:
    scene = np.kron(np.random.default_rng(0).integers(40, 200, (3, 4, 3)), np.ones((16, 16, 1))).astype(np.uint8)
    source = write_video(tmp_path / "plain.mp4", [scene] * 8, options={"crf": "4"})
    footage = open_footage(with_aperture(tmp_path / "a.mp4", source, (48, 1, 40, 1, 0, 1, 0, 1)))
    stored = scene.astype(np.float32) / 255
    write_png(tmp_path / "plate.png", stored[4:44, 8:56])
    found, _ = find_plate(footage, tmp_path / "plate.png")
    assert np.abs(found - next(footage.frames())).mean() < 0.02
    write_png(tmp_path / "whole.png", stored)
    with pytest.raises(InputError, match="background plate"):
        find_plate(footage, tmp_path / "whole.png")
    entries = "camera_matrix = [[90, 0, 32], [0, 90, 24], [0, 0, 1]]\nimage_size = "
    (tmp_path / "whole.toml").write_text(f"{entries}[{WIDTH}, {HEIGHT}]\n")
    with pytest.raises(InputError, match="of 64 x 48 pixels and the footage has 48 x 40"):
        clip_lens(ClipCamera(calibration=tmp_path / "whole.toml"), "a.mp4", footage.height, footage.width)
