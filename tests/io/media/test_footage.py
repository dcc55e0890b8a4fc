"""Footage: exact frames from anywhere, true times, ranges, averages, and what damage costs."""

import pickle
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hfb.errors import InputError
from hfb.io.media.footage import Footage, open_footage
from hfb.io.media.images.image_io import write_png
from hfb.io.media.lens.lens import Lens
from hfb.photometry import as_srgb, linear_to_srgb, srgb_to_linear
from tests.io.media.videos import numbers_in, picture, write_video

FRAMES = [picture(number) for number in range(60)]
B_FRAMES = {"bf": "3", "g": "12", "crf": "10"}


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("footage") / "walk.mp4", FRAMES, options=B_FRAMES)


def all_of(footage: Footage) -> np.ndarray:
    return np.stack(list(footage.frames()))


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "options"),
    [
        ("h264.mp4", "libx264", "yuv420p", B_FRAMES),
        ("open_gop.mkv", "libx264", "yuv420p", {"x264-params": "open-gop=1:keyint=12:bframes=3:scenecut=0"}),
        ("hevc.mp4", "libx265", "yuv420p", {"x265-params": "open-gop=1:keyint=12:bframes=3:log-level=none"}),
        ("ten.mp4", "libx265", "yuv420p10le", {"x265-params": "keyint=10:log-level=none"}),
        ("av1.mp4", "libsvtav1", "yuv420p", {"g": "12", "preset": "6", "crf": "8"}),
        ("av1.mkv", "libaom-av1", "yuv420p", {"g": "12", "cpu-used": "8"}),
        ("stream.ts", "mpeg2video", "yuv420p", {"g": "12", "bf": "2"}),
    ],
)
def test_a_late_start_gives_the_same_frames(
    tmp_path: Path, name: str, codec: str, pixels: str, options: dict[str, str]
) -> None:
    footage = open_footage(write_video(tmp_path / name, FRAMES, codec, pixels, options))
    whole = all_of(footage)
    assert len(whole) == footage.count == len(FRAMES)
    assert footage.bits == (16 if "10" in pixels else 8)
    assert footage.loss is None
    for start, stop in [(1, 4), (11, 14), (12, 13), (25, 40), (47, 50), (59, 60)]:
        assert np.array_equal(np.stack(list(footage.frames(start, stop))), whole[start:stop]), (start, stop)
    assert np.array_equal(np.stack(list(footage.chosen([3, 4, 40, 59]))), whole[[3, 4, 40, 59]])
    assert np.array_equal(numbers_in(whole), np.arange(len(whole)) % 8)


def test_ranges_by_frames_and_seconds(video: Path) -> None:
    whole = all_of(open_footage(video))
    for footage in (open_footage(video, start=25, stop=30), open_footage(video, start_s=1.0, stop_s=1.2)):
        assert footage.count == 5
        assert np.allclose(footage.times_s, 1 + np.arange(5) / 25)
        assert np.array_equal(all_of(footage), whole[25:30])
    assert open_footage(video, start=55, stop=400).count == 5
    with pytest.raises(InputError, match="no frame lies in the chosen range"):
        open_footage(video, start=60)
    with pytest.raises(InputError, match="has frames 0 to 4"):
        list(open_footage(video, start=25, stop=30).frames(3, 6))


def test_it_travels_between_processes(video: Path) -> None:
    footage = open_footage(video, start=20, stop=24)
    again = pickle.loads(pickle.dumps(footage))  # our own bytes
    assert np.array_equal(all_of(again), all_of(footage))
    assert len(pickle.dumps(footage)) < 10_000


def test_average_is_of_light(video: Path) -> None:
    sharp, mean = open_footage(video), open_footage(video, start=2, average=4)
    assert mean.count == 14
    assert mean.bits == 16
    assert mean.interval_s == pytest.approx(4 / 25)
    assert np.allclose(mean.times_s, 2 / 25 + np.arange(14) * 4 / 25)
    assert any("the last 2 frames are left out" in remark for remark in mean.remarks)
    expected = linear_to_srgb(srgb_to_linear(all_of(sharp)[6:10].astype(np.float64)).mean(0))
    assert np.allclose(next(mean.frames(1, 2)), expected, atol=1e-6)
    with pytest.raises(InputError, match="too few to average 100"):
        open_footage(video, average=100)


def test_variable_rate_keeps_its_times(tmp_path: Path) -> None:
    stamps = [0, 40, 80, 120, 200, 240, 280, 323, 360, 400]
    footage = open_footage(write_video(tmp_path / "vfr.mkv", FRAMES[:10], stamps=stamps))
    assert np.allclose(footage.times_s, np.array(stamps) / 1000, atol=1e-6)
    assert footage.interval_s == pytest.approx(0.04, rel=0.02)
    assert any("1 of 9 intervals" in remark for remark in footage.remarks)
    assert np.array_equal(np.stack(list(footage.frames(4, 6))), all_of(footage)[4:6])


def test_a_told_rate_wins(video: Path) -> None:
    slow = open_footage(video, start_s=0.4, stop_s=0.6, fps=100)
    assert slow.interval_s == 0.01
    assert np.allclose(slow.times_s, 0.1 + np.arange(5) / 100)
    assert slow.remarks == ()


def test_folders_in_natural_order_and_lists(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        write_png(tmp_path / f"f{number}.png", np.full((4, 6, 3), number / 20, np.float32))
    (tmp_path / "notes.txt").write_text("not a picture")
    write_png(tmp_path / "plate.png", np.zeros((4, 6, 3), np.float32))
    footage = open_footage(tmp_path, fps=50)
    assert [path.name for path in footage.files] == ["f1.png", "f2.png", "f10.png"]
    assert np.allclose(footage.times_s, [0, 0.02, 0.04])
    assert np.allclose(all_of(footage)[:, 0, 0, 0] * 20, [1, 2, 10], atol=0.1)
    listed = open_footage([tmp_path / "f10.png", tmp_path / "f1.png"])
    assert np.allclose(all_of(listed)[:, 0, 0, 0] * 20, [10, 1], atol=0.1)
    assert any("assuming 30" in remark for remark in listed.remarks)
    write_png(tmp_path / "f11.png", np.zeros((5, 6, 3), np.float32))
    with pytest.raises(InputError, match=r"f11.png.*6 x 5.*6 x 4"):
        open_footage(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no picture"):
        open_footage(tmp_path / "empty")


@pytest.mark.parametrize("name", ["cut.mkv", "cut.ts", "cut.mp4"])
def test_frames_before_damage_are_used_and_the_loss_is_said(tmp_path: Path, name: str) -> None:
    codec, options = ("mpeg2video", {"g": "6"}) if name.endswith("ts") else ("libx264", B_FRAMES)
    first = {"movflags": "faststart"} if name.endswith("mp4") else {}  # the table of frames before the frames
    whole = write_video(tmp_path / f"whole{Path(name).suffix}", FRAMES, codec, options=options, container_options=first)
    frames = all_of(open_footage(whole))
    data = whole.read_bytes()
    (tmp_path / name).write_bytes(data[: len(data) * 6 // 10])
    footage = open_footage(tmp_path / name)
    assert 10 <= footage.count < 55
    kept = all_of(footage)
    good = sum(np.array_equal(one, other) for one, other in zip(kept, frames, strict=False))
    assert good >= footage.count - 2  # the last ones may be cut off within the frame
    if not name.endswith("ts"):  # a transport stream does not say how long it should be
        assert footage.loss is not None
        assert footage.loss in footage.remarks
        assert "damaged" in footage.loss


def test_a_file_without_its_table(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "whole.mp4", FRAMES, options=B_FRAMES)
    (tmp_path / "cut.mp4").write_bytes(whole.read_bytes()[:-2000])
    with pytest.raises(InputError, match=r"cut.mp4: can't be read as a video"):
        open_footage(tmp_path / "cut.mp4")


def test_bytes_changed_in_the_middle(tmp_path: Path, video: Path) -> None:
    data = bytearray(video.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 400] = bytes(400)
    (tmp_path / "scratched.mp4").write_bytes(data)
    footage = open_footage(tmp_path / "scratched.mp4")
    assert 1 <= footage.count == len(all_of(footage))


def test_what_is_no_footage(tmp_path: Path, video: Path) -> None:
    for name, content, says in [("a.mp4", b"", "video"), ("b.mkv", b"text" * 99, "video"), ("c.mp4", None, "no such")]:
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=says) as caught:
            open_footage(tmp_path / name)
        assert "\n" not in str(caught.value)
    head = video.read_bytes()
    (tmp_path / "head.mp4").write_bytes(head[: head.index(b"mdat") + 8] if head.index(b"mdat") < 200 else head[:200])
    with pytest.raises(InputError):
        open_footage(tmp_path / "head.mp4")
    with pytest.raises(InputError, match="list of pictures is empty"):
        open_footage([])


def test_a_picture_of_absurd_size_is_refused(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    content = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")
    (tmp_path / "bomb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + content)
    with pytest.raises(InputError, match=r"bomb.png"):
        open_footage(tmp_path)


@pytest.mark.parametrize("transfer", ["bt709", "gamma22", "linear", "srgb"])
def test_the_files_light(tmp_path: Path, transfer: str) -> None:
    stored = np.linspace(0, 1, 24, dtype=np.float32).reshape(2, 4, 3)
    write_png(tmp_path / "f0.png", stored, bits=16)
    footage = open_footage(tmp_path, transfer=transfer)
    assert footage.transfer == ("linear" if transfer == "linear" else "srgb")
    frame = next(footage.frames())
    linear = {
        "bt709": np.where(stored < 0.081, stored / 4.5, ((stored + 0.099) / 1.099) ** (1 / 0.45)),
        "gamma22": stored**2.2,
        "linear": stored,
        "srgb": srgb_to_linear(stored),
    }[transfer]
    found = frame if transfer == "linear" else srgb_to_linear(frame)
    assert np.allclose(found, linear, atol=2e-4)
    assert np.allclose(as_srgb(stored, transfer), frame, atol=1e-4)


def test_distortion_is_taken_out(tmp_path: Path) -> None:
    write_png(tmp_path / "f0.png", np.random.default_rng(0).random((40, 60, 3)).astype(np.float32))
    footage = open_footage(tmp_path)
    plain = next(footage.frames())
    harmless = footage.through(Lens((50.0, 50.0, 29.5, 19.5), (0.0, 0.0, 0.0, 0.0)))
    assert np.array_equal(next(harmless.frames()), plain)
    assert not harmless.lens.bends(40, 60)
    bent = footage.through(Lens((50.0, 50.0, 29.5, 19.5), (-0.3, 0.05, 0.0, 0.0)))
    turned = next(bent.frames())
    assert not np.allclose(turned, plain)
    assert np.array_equal(turned, bent.developed(plain))
    assert np.allclose(turned[20, 30], plain[20, 30], atol=0.02)  # the principal point stays


def test_frames_that_are_missing_or_double_by_their_names(tmp_path: Path) -> None:
    def remarks(*names: str) -> tuple[str, ...]:
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        for name in names:
            Image.new("RGB", (8, 6)).save(folder / name)
        return open_footage(folder, fps=25).remarks

    assert remarks("a_1.png", "a_2.png", "a_9.png", "a_10.png")[0].startswith(
        "no frame lies between a_2.png and a_9.png"
    )
    assert remarks("cam1_002.png", "cam1_004.png", "cam1_006.png") == ()  # every other frame, in one row
    assert remarks("171.png", "204.png", "238.png", "271.png") == ()  # times
    assert remarks("first.png", "second.png") == ()
    (told,) = remarks("01.png", "02 (1).png", "02.png", "03.png", "04.png")
    assert told.startswith("02 (1).png is named unlike the other frames")
    with pytest.raises(InputError, match=r"1\.jpg and 1\.png are one frame twice"):
        remarks("1.png", "1.jpg", "2.png", "2.jpg")
