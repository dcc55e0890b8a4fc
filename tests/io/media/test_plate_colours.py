"""A plate that was decoded by another matrix than its video's frames."""

import av
import numpy as np
import pytest

from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.plate_colours import in_colours_of
from hfb.io.media.video.video_index import index_video
from tests.shared import SHARED_DATA

MATRICES = {"BT.601": 5, "BT.709": 1}


def decoded(frame: av.VideoFrame, matrix: str) -> np.ndarray:
    """Levels by the library that players use."""
    rgb = frame.reformat(format="rgb24", src_colorspace=MATRICES[matrix], interpolation=4 | 0x40000 | 0x2000)
    return rgb.to_ndarray().astype(np.float32) / 255


@pytest.fixture
def stored() -> av.VideoFrame:
    """A room with saturated walls as a video stores it; the extremes are clipped by either matrix."""
    picture = np.full((96, 160, 3), (120, 130, 125), np.uint8)
    for column, colour in enumerate([(190, 25, 35), (30, 60, 160), (40, 140, 60), (200, 180, 40)]):
        picture[16:80, 8 + 36 * column : 36 + 36 * column] = colour
    frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
    return frame.reformat(format="yuv444p", dst_colorspace=1)


@pytest.mark.parametrize(("of_plate", "of_video"), [("BT.601", "BT.709"), ("BT.709", "BT.601")])
def test_a_plate_of_the_other_matrix_is_converted(stored: av.VideoFrame, of_plate: str, of_video: str) -> None:
    plate, video = decoded(stored, of_plate), decoded(stored, of_video)
    frames = [video.copy() for _ in range(3)]
    for number, frame in enumerate(frames):  # somebody walks through
        frame[20:90, 10 + 40 * number : 50 + 40 * number] = 0.1
    converted, remark = in_colours_of(plate, frames)
    assert remark is not None
    assert f"decoded by {of_plate}'s matrix and the video's by {of_video}'s" in remark
    before, after = (np.abs(one - video) for one in (plate, converted))
    assert before.max() > 15 / 255
    assert after.mean() < 0.2 * before.mean()


def test_a_plate_of_the_same_matrix_stays(stored: av.VideoFrame) -> None:
    plate = decoded(stored, "BT.709")
    noise = np.random.default_rng(0).normal(0, 2 / 255, (3, *plate.shape)).astype(np.float32)
    for frames in ([plate] * 3, list((plate + noise).clip(0, 1)), list((0.9 * plate + noise).clip(0, 1))):
        same, remark = in_colours_of(plate, frames)
        assert remark is None
        assert same is plate


def test_a_grey_scene_says_nothing_of_matrices() -> None:
    plate = np.full((40, 60, 3), 0.5, np.float32)
    assert in_colours_of(plate, [plate + 0.1])[1] is None


@pytest.mark.parametrize(
    ("recording", "video", "plate", "wrong"),
    [
        ("opencap_walk_a", "cam0_f001-074.mp4", "cam0_plate.png", True),
        ("opencap_squat", "cam0_f060-299.mp4", "cam0_plate.png", True),
        ("pose2sim_balancing", "cam01_f000-059.mp4", "cam01_plate.png", True),
        ("sports2d_park", "demo.mp4", "plate.png", False),
    ],
)
def test_real_plates(recording: str, video: str, plate: str, wrong: bool) -> None:
    """Plates that OpenCV cut out of HD videos whose colours nothing states."""
    folder = SHARED_DATA / recording
    if not folder.is_dir():
        pytest.skip("needs ../shared/data")
    index = index_video(folder / video)
    frames = list(index.chosen(np.linspace(0, len(index.stamps) - 1, 5).round().astype(int)[1:-1].tolist()))
    stored = read_picture_srgb(folder / plate)
    converted, remark = in_colours_of(stored, frames)
    assert (remark is not None) == wrong
    scene = np.median(np.stack(frames), axis=0)
    before, after = (np.minimum(np.abs(scene - one), 0.1).mean() for one in (stored, converted))
    assert after < before if wrong else after == before
