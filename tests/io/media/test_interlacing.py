"""Interlaced video is refused with the way to mend it, whoever says that it is; what only looks so is told."""

from pathlib import Path

import av
import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.clip import Clip
from hfb.io.media.footage import open_footage
from tests.io.media.videos import write_video

HEIGHT, WIDTH = 96, 128
NOISE = np.kron(np.random.default_rng(1).integers(30, 220, (12, 16, 3)), np.ones((8, 8, 1))).astype(np.uint8)


def instant(at: float) -> np.ndarray:
    """A smooth scene with a bright bar that moves 5 px from field to field."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    frame = np.stack([60 + x / 2, 90 + y / 2, 80 + 0 * x], -1)
    left = 10 + 5 * at
    frame[16:80, int(left) : int(left) + 20] = 230
    return frame.astype(np.uint8)


def woven(count: int, top_first: bool = True) -> list[np.ndarray]:
    """Frames of two instants each, line by line."""
    frames = []
    for number in range(count):
        early, late = instant(2 * number % 18), instant(2 * number % 18 + 1)
        frame = early.copy()
        frame[1 if top_first else 0 :: 2] = late[1 if top_first else 0 :: 2]
        frames.append(frame)
    return frames


def telecined(count: int) -> list[np.ndarray]:
    """Film at 24 per second as 30 frames of two fields: of five frames two mix two of its pictures."""
    film = [instant(3 * number % 18) for number in range(count)]
    fields = [picture for number, picture in enumerate(film) for _ in range(2 + number % 2)]
    frames = []
    for top, bottom in zip(fields[::2], fields[1::2], strict=False):
        frame = top.copy()
        frame[1::2] = bottom[1::2]
        frames.append(frame)
    return frames


CODED = {
    "h264 tff": ("a.mp4", "libx264", {"x264-params": "tff=1"}),
    "h264 bff": ("a.mkv", "libx264", {"x264-params": "bff=1"}),
    "h264 in ts": ("a.ts", "libx264", {"x264-params": "tff=1"}),
    "mpeg2": ("a.mpg", "mpeg2video", {"flags": "+ildct+ilme", "b": "4000k"}),
    "mpeg2 in ts": ("a.ts", "mpeg2video", {"flags": "+ildct+ilme", "b": "4000k"}),
    "prores": ("a.mov", "prores_ks", {"flags": "+ildct"}),
}


@pytest.mark.parametrize("kind", CODED)
def test_flagged_frames_are_refused(tmp_path: Path, kind: str) -> None:
    name, codec, options = CODED[kind]
    pixels = "yuv422p10le" if codec == "prores_ks" else "yuv420p"
    path = write_video(tmp_path / name, woven(8, kind != "h264 bff"), codec, pixels, options)
    with pytest.raises(InputError, match="is interlaced") as refused:
        open_footage(path)
    words = str(refused.value)
    assert f"`ffmpeg -i {name} -vf bwdif=mode=send_field -crf 12 OUT.mp4`" in words
    assert "fieldmatch,decimate" in words
    assert 'scan = "progressive" in clip.toml' in words
    assert open_footage(path, scan="progressive").count == 8


def test_the_word_of_clip_toml() -> None:
    assert Clip.model_validate({"scan": "progressive"}).scan == "progressive"
    with pytest.raises(ValueError, match="scan"):
        Clip.model_validate({"scan": "interlaced"})


def test_a_container_speaks_for_decoders_that_do_not(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width, stream.pix_fmt = HEIGHT, WIDTH, "yuv420p"
        stream.codec_context.field_order = 2
        for content in woven(6):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(content, format="rgb24")))
        container.mux(stream.encode())
    with pytest.raises(InputError, match="is interlaced"):
        open_footage(path)


@pytest.mark.parametrize(("top_first", "order"), [(True, "tff"), (False, "bff")])
def test_combs_that_nobody_flags_are_told(tmp_path: Path, top_first: bool, order: str) -> None:
    footage = open_footage(write_video(tmp_path / "a.mp4", woven(10, top_first), options={"crf": "8"}))
    assert footage.count == 10
    (remark,) = footage.remarks
    assert "seems to be interlaced, although it does not say so" in remark
    assert f"-vf setfield={order},bwdif=mode=send_field" in remark
    assert open_footage(tmp_path / "a.mp4", scan="progressive").remarks == ()


def test_telecined_film_is_told(tmp_path: Path) -> None:
    footage = open_footage(write_video(tmp_path / "a.mp4", telecined(24), options={"crf": "8"}, rate=30))
    (remark,) = footage.remarks
    assert "seems to be telecined film" in remark
    assert "-vf setfield=tff,fieldmatch,decimate" in remark


@pytest.mark.parametrize("crf", ["8", "35"])
@pytest.mark.parametrize("kind", ["bar", "still", "noise", "falling stripes"])
def test_whole_pictures_are_left_alone(tmp_path: Path, kind: str, crf: str) -> None:
    rng = np.random.default_rng(0)
    stripes = np.repeat((40 + 160 * (np.arange(HEIGHT + 40) // 2 % 2))[:, None, None], WIDTH, 1).repeat(3, 2)
    frames = {
        "bar": [instant(2 * number) for number in range(9)],
        "still": [NOISE] * 9,
        "noise": [np.clip(NOISE + rng.normal(0, 6, NOISE.shape), 0, 255).astype(np.uint8) for _ in range(9)],
        "falling stripes": [stripes[number : number + HEIGHT].astype(np.uint8) for number in range(9)],
    }[kind]
    assert open_footage(write_video(tmp_path / "a.mp4", frames, options={"crf": crf})).remarks == ()
