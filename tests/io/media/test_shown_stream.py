"""Of a file with several video streams the one that players show, laid on its sides as they lay it."""

from pathlib import Path

import av
import numpy as np
import pytest
from av.stream import Disposition

from hfb.errors import InputError
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_io import read_picture_srgb, write_png
from hfb.io.media.plate import find_plate
from hfb.io.media.video.video_reading import read_frames
from tests.io.media.mp4 import with_matrix
from tests.io.media.videos import picture, write_video
from tests.shared import REPORTS

MATRICES = [
    (1, 0, 0, 1), (-1, 0, 0, 1), (1, 0, 0, -1), (-1, 0, 0, -1), (0, 1, 1, 0), (0, 1, -1, 0), (0, -1, 1, 0),
    (0, -1, -1, 0),
]  # fmt: skip


def shown(frame: np.ndarray, matrix: tuple[int, int, int, int]) -> np.ndarray:
    """Every pixel where the matrix takes it, by the words of ISO 14496-12."""
    a, b, c, d = matrix
    y, x = np.mgrid[: frame.shape[0], : frame.shape[1]]
    right, down = a * x + c * y, b * x + d * y
    right, down = right - right.min(), down - down.min()
    laid = np.empty((down.max() + 1, right.max() + 1, 3), frame.dtype)
    laid[down, right] = frame
    return laid


@pytest.mark.parametrize("matrix", MATRICES)
def test_the_eight_matrices(tmp_path: Path, matrix: tuple[int, int, int, int]) -> None:
    plain = write_video(tmp_path / "plain.mp4", [picture(number) for number in range(3)], options={"crf": "4"})
    laid = with_matrix(tmp_path / "laid.mp4", plain, matrix)
    footage = open_footage(laid)
    expected = [shown(frame, matrix) for frame in open_footage(plain).frames()]
    assert (footage.height, footage.width) == expected[0].shape[:2]
    assert np.array_equal(list(footage.frames()), expected)
    assert np.array_equal(list(read_frames(laid)), expected)


def test_a_plate_as_players_show_it_fits(tmp_path: Path) -> None:
    scene = np.kron(np.random.default_rng(0).integers(40, 200, (3, 4, 3)), np.ones((16, 16, 1))).astype(np.uint8)
    plain = write_video(tmp_path / "plain.mp4", [scene] * 5, options={"crf": "4"})
    for matrix in MATRICES:
        footage = open_footage(with_matrix(tmp_path / "laid.mp4", plain, matrix))
        write_png(tmp_path / "plate.png", shown(scene / np.float32(255), matrix))
        plate, _ = find_plate(footage, tmp_path / "plate.png")
        assert np.abs(plate - next(footage.frames())).mean() < 0.02


@pytest.mark.skipif(not REPORTS.is_dir(), reason="the reported files are not here")
def test_the_reported_mirror_fits_its_plate() -> None:
    footage = open_footage(REPORTS / "clip_mirrored_matrix.mp4")
    plate = read_picture_srgb(REPORTS / "clip_mirrored_plate_as_players_show.png")
    apart = np.median([np.abs(frame - plate).mean() for frame in footage.frames()])
    mirrored = np.median([np.abs(frame[:, ::-1] - plate).mean() for frame in footage.frames()])
    assert apart < 0.5 * mirrored


def two_streams(path: Path, first: int = 0, second: int = 0, sizes: tuple[int, int] = (32, 64)) -> Path:
    """Two videos of squares in one file: dark and bright, with these dispositions."""
    with av.open(str(path), "w") as container:
        streams = []
        for size, disposition in zip(sizes, (first, second), strict=True):
            stream = container.add_stream("libx264", rate=25)
            stream.height = stream.width = size
            stream.pix_fmt = "yuv420p"
            stream.disposition = Disposition(disposition)
            streams.append(stream)
        for _ in range(6):
            for stream, level in zip(streams, (40, 200), strict=True):
                frame = np.full((stream.height, stream.width, 3), level, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        for stream in streams:
            container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("dispositions", "sizes", "brightness"),
    [
        ((0, 0), (32, 64), 200),
        ((0, 0), (64, 32), 40),
        ((1, 0), (32, 64), 40),
        ((0, 1), (64, 32), 200),
        ((0, 0), (64, 64), 40),
    ],
)
def test_the_default_then_the_largest(
    tmp_path: Path, dispositions: tuple[int, int], sizes: tuple[int, int], brightness: int
) -> None:
    footage = open_footage(two_streams(tmp_path / "two.mkv", *dispositions, sizes))
    assert footage.count == 6
    assert next(footage.frames()).mean() * 255 == pytest.approx(brightness, abs=3)


@pytest.mark.parametrize("kind", ["attached", "single"])
def test_a_thumbnail_first(tmp_path: Path, kind: str) -> None:
    whole = write_video(tmp_path / "whole.mp4", [picture(number) for number in range(6)])
    with av.open(str(whole)) as source, av.open(str(tmp_path / "two.mp4"), "w") as target:
        cover = target.add_stream("mjpeg", rate=25)
        cover.height, cover.width, cover.pix_fmt = 96, 128, "yuvj420p"
        if kind == "attached":
            cover.disposition = Disposition.attached_pic
        copy = target.add_stream_from_template(source.streams.video[0])
        target.mux(cover.encode(av.VideoFrame.from_ndarray(np.zeros((96, 128, 3), np.uint8), format="rgb24")))
        target.mux(cover.encode())
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = copy
                target.mux(packet)
    footage = open_footage(tmp_path / "two.mp4")
    assert (footage.count, footage.height, footage.width) == (6, 48, 64)
    assert footage.remarks == ()
    assert np.array_equal(list(footage.frames()), list(open_footage(whole).frames()))
    assert len(list(read_frames(tmp_path / "two.mp4"))) == 6


def test_a_cover_alone_is_no_video(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "song.mp4"), "w") as target:
        cover = target.add_stream("mjpeg", rate=25)
        cover.height, cover.width, cover.pix_fmt = 32, 32, "yuvj420p"
        cover.disposition = Disposition.attached_pic
        target.mux(cover.encode(av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), format="rgb24")))
        target.mux(cover.encode())
    with pytest.raises(InputError, match="holds only a cover"):
        open_footage(tmp_path / "song.mp4")
