"""Colours of video: what frames do not say the container says, and where nobody says it players' practice counts."""

from pathlib import Path

import av
import numpy as np
import pytest
from av.video.reformatter import Colorspace

from hfb.errors import InputError
from hfb.io.media.footage import open_footage
from hfb.io.media.video.video_reading import read_frames
from tests.io.media.mp4 import with_colours
from tests.io.media.videos import picture, write_video

SD, HD = (576, 720), (720, 1280)
COLOUR = (200, 60, 40)


def flat(size: tuple[int, int]) -> list[np.ndarray]:
    """Two frames of one colour, which BT.601 and BT.709 store differently."""
    return [np.full((*size, 3), COLOUR, np.uint8)] * 2


def written(path: Path, size: tuple[int, int], matrix: int, full: bool = False, codec: str = "libx264") -> Path:
    """The colour stored by a matrix, without a word about it in the stream."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options={"crf": "4", "preset": "ultrafast"})
        stream.height, stream.width = size
        stream.pix_fmt = "yuv420p"
        for content in flat(size):
            frame = av.VideoFrame.from_ndarray(content, format="rgb24")
            frame = frame.reformat(
                format="yuv420p", dst_colorspace=matrix, src_color_range="JPEG", dst_color_range=2 if full else 1
            )
            frame.colorspace, frame.color_range = 2, 0
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(("size", "matrix"), [(SD, Colorspace.ITU601), (HD, Colorspace.ITU709)])
def test_untagged_video_is_decoded_as_players_do(tmp_path: Path, size: tuple[int, int], matrix: Colorspace) -> None:
    path = written(tmp_path / "a.mp4", size, matrix)
    footage = open_footage(path)
    seen = next(footage.frames())
    assert np.abs(seen[10, 10] * 255 - COLOUR).max() <= 3
    assert np.array_equal(seen, next(read_frames(path)))
    if size == HD:
        (remark,) = footage.remarks
        assert "decoded as BT.709, as players do above 576 lines" in remark
    else:
        assert footage.remarks == ()


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize(("size", "matrix"), [(SD, Colorspace.ITU709), (HD, Colorspace.ITU601)])
def test_the_container_tells_what_frames_do_not(
    tmp_path: Path, size: tuple[int, int], matrix: Colorspace, full: bool
) -> None:
    plain = written(tmp_path / "plain.mp4", size, matrix, full)
    tagged = with_colours(tmp_path / "a.mp4", plain, b"avc1", (1, 1, int(matrix) if matrix != 5 else 6), full)
    footage = open_footage(tagged)
    assert np.abs(next(footage.frames())[10, 10] * 255 - COLOUR).max() <= 3
    assert footage.remarks == ()


@pytest.mark.parametrize(("transfer", "kind"), [(18, "HLG"), (16, "PQ")])
@pytest.mark.parametrize(("codec", "entry"), [("libx264", b"avc1"), ("libx265", b"hev1"), ("libsvtav1", b"av01")])
def test_hdr_that_only_the_container_tags(tmp_path: Path, codec: str, entry: bytes, transfer: int, kind: str) -> None:
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    frames = [np.kron(picture(number), np.ones((2, 2, 1), np.uint8)) for number in range(3)]
    plain = write_video(tmp_path / "plain.mp4", frames, codec, options=options)
    assert open_footage(plain).count == 3
    tagged = with_colours(tmp_path / "a.mp4", plain, entry, (9, transfer, 9))
    with pytest.raises(InputError, match=rf"high dynamic range video \({kind}\)"):
        open_footage(tagged)


@pytest.mark.parametrize(("codec", "name"), [("ffv1", "a.mkv"), ("libvpx-vp9", "a.webm")])
def test_hdr_of_matroskas_colour_element(tmp_path: Path, codec: str, name: str) -> None:
    try:
        with av.open(str(tmp_path / name), "w") as container:
            stream = container.add_stream(codec, rate=25)
            stream.height, stream.width, stream.pix_fmt = 48, 64, "yuv420p"
            tags = stream.codec_context
            tags.color_primaries, tags.color_trc, tags.colorspace = 9, 18, 9
            for number in range(3):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(number), format="rgb24")))
            container.mux(stream.encode())
    except (av.FFmpegError, ValueError) as error:
        pytest.skip(f"this build of PyAV cannot write {codec}: {error}")
    with pytest.raises(InputError, match=r"high dynamic range video \(HLG\)"):
        open_footage(tmp_path / name)


def test_wide_colours_are_told(tmp_path: Path) -> None:
    plain = write_video(tmp_path / "plain.mp4", [picture(0)] * 2)
    (remark,) = open_footage(with_colours(tmp_path / "a.mp4", plain, b"avc1", (12, 1, 1))).remarks
    assert "has the colours of Display P3" in remark
