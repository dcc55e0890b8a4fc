"""Time stamps as files have them: repeated, missing, another frame's, cut off, or those of sound."""

import struct
import time
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from hfb.io.media.footage import Footage, open_footage
from tests.io.media.videos import numbers_in, picture, write_video

FRAMES = [picture(number) for number in range(60)]
B_FRAMES = {"bf": "3", "g": "12", "crf": "10"}


def check_all_readable(footage: Footage, numbers: range = range(60)) -> None:
    """Every frame is there, from anywhere, and is the one that its number says."""
    whole = np.stack(list(footage.frames()))
    assert len(whole) == footage.count == len(numbers)
    assert footage.loss is None
    assert np.array_equal(numbers_in(whole), np.array(numbers) % 8)
    last = footage.count - 1
    for start, stop in [(1, 4), (last // 2, last // 2 + 3), (last, last + 1)]:
        assert np.array_equal(np.stack(list(footage.frames(start, stop))), whole[start:stop]), (start, stop)
    chosen = sorted({0, 1, last // 2, last})
    assert np.array_equal(np.stack(list(footage.chosen(chosen))), whole[chosen])


def repeated(path: Path) -> Path:
    stamps = [round(1000 * number / 30) for number in range(60)]
    stamps[31] = stamps[30]
    return write_video(path, FRAMES, "ffv1", stamps=stamps, rate=30)


def made(folder: Path, kind: str) -> Path:
    """A video of `FRAMES` at 30 per second that has no time stamps, or wrong ones."""
    if kind == "repeated":
        return repeated(folder / "repeated.mkv")
    name, codec = {"raw": ("raw.h264", "libx264"), "bare": ("bare.hevc", "libx265"), "avi": ("b.avi", "libx264")}[kind]
    silent = {"x265-params": "log-level=none:bframes=3"}
    return write_video(folder / name, FRAMES, codec, options=silent if codec == "libx265" else B_FRAMES, rate=30)


@pytest.mark.parametrize(
    ("kind", "why"),
    [("repeated", "repeats or lacks"), ("raw", "has no"), ("bare", "has no"), ("avi", "has time stamps that do not")],
)
def test_frames_are_counted_where_stamps_are_of_no_use(tmp_path: Path, kind: str, why: str) -> None:
    path = made(tmp_path, kind)
    footage = open_footage(path)
    check_all_readable(footage)
    assert np.allclose(footage.times_s, np.arange(60) / 30)
    assert footage.interval_s == pytest.approx(1 / 30)
    (remark,) = footage.remarks
    assert f"{path.name} {why}" in remark
    assert "30 per second, as the file states (fps in clip.toml or --exposure.fps" in remark
    for part in (open_footage(path, start=40, stop=45), open_footage(path, start_s=4 / 3, stop_s=1.5)):
        check_all_readable(part, range(40, 45))
        assert np.allclose(part.times_s, np.arange(40, 45) / 30)
    check_all_readable(open_footage(path, start=40), range(40, 60))
    for number in range(1, 25):
        alone = open_footage(path, start=number, stop=number + 1)
        assert numbers_in(np.stack(list(alone.frames()))) == number % 8


def test_stamps_in_the_order_of_decoding(tmp_path: Path) -> None:
    """As careless programs copy a stream: what a frame is decoded at is taken for when it is shown."""
    whole = write_video(tmp_path / "whole.mkv", FRAMES, options=B_FRAMES)
    with av.open(str(whole)) as source, av.open(str(tmp_path / "wrong.mkv"), "w") as target:
        copy = target.add_stream_from_template(source.streams.video[0])
        for number, packet in enumerate(one for one in source.demux(video=0) if one.size):
            packet.pts = packet.dts = 40 * number
            packet.stream = copy
            target.mux(packet)
    footage = open_footage(tmp_path / "wrong.mkv")
    check_all_readable(footage)
    assert np.allclose(footage.times_s, np.arange(60) / 25)
    assert "has time stamps that do not fit its frames: frames are counted, 25 per second" in footage.remarks[0]


def processor_s(read: Callable[[], object]) -> float:
    """How long something takes this process."""
    began = time.process_time()
    read()
    return time.process_time() - began


def test_counted_frames_are_decoded_once_by_who_reads_on(tmp_path: Path) -> None:
    """Part after part takes far less time than each part from the beginning, as it is backwards."""
    long = write_video(tmp_path / "long.h264", FRAMES * 5, options=B_FRAMES, rate=30)
    footage, means = open_footage(long), open_footage(long, average=3)
    starts = range(0, 300, 4)
    backwards_s = processor_s(lambda: [list(footage.frames(at, at + 4)) for at in reversed(starts)])
    assert processor_s(lambda: [list(footage.frames(at, at + 4)) for at in starts]) < backwards_s / 2
    assert processor_s(lambda: [list(footage.frames(at, at + 2)) for at in starts]) < backwards_s / 2, "over some"
    assert processor_s(lambda: list(means.chosen(range(100)))) < backwards_s / 2


def test_counted_frames_are_the_same_in_any_order(tmp_path: Path) -> None:
    path = made(tmp_path, "raw")
    footage = open_footage(path)
    whole = np.stack(list(footage.frames()))
    parts = [list(footage.frames(at, at + 4)) for at in range(0, 60, 4)]
    assert np.array_equal(np.concatenate(parts), whole)
    for start in (8, 20, 20, 24):  # on, over some, and back
        assert np.array_equal(list(footage.frames(start, start + 4)), whole[start : start + 4])
    for one, other in zip(footage.frames(28, 36), footage.frames(28, 36), strict=True):  # each its own decoder
        assert np.array_equal(one, other)
    assert len(list(open_footage(path, average=3).chosen(range(20)))) == 20

    list(footage.frames(0, 4))
    write_video(path, FRAMES[::-1], options=B_FRAMES, rate=30)
    assert numbers_in(np.stack(list(footage.frames(4, 8)))).tolist() == [7, 6, 5, 4]  # of the file that is there now


def test_a_told_rate_settles_a_count(tmp_path: Path) -> None:
    told = open_footage(made(tmp_path, "raw"), fps=120)
    assert np.allclose(told.times_s, np.arange(60) / 120)
    assert told.interval_s == 1 / 120
    assert told.remarks == ()


def test_a_bare_stream_without_a_rate_is_assumed_to_have_one(tmp_path: Path) -> None:
    options = {"x265-params": "log-level=none:vui-timing-info=0"}
    footage = open_footage(write_video(tmp_path / "bare.hevc", FRAMES, "libx265", options=options, rate=50))
    assert footage.interval_s == pytest.approx(1 / 30)
    assert "30 per second, which is assumed (fps in clip.toml" in footage.remarks[0]


def test_faster_than_the_clock_of_its_container(tmp_path: Path) -> None:
    stamps = [number // 2 for number in range(60)]  # two frames per millisecond
    footage = open_footage(write_video(tmp_path / "fast.mkv", FRAMES, "ffv1", stamps=stamps, rate=2000))
    check_all_readable(footage)
    assert footage.interval_s == pytest.approx(1 / 2000, rel=0.03)


def test_good_stamps_are_believed(tmp_path: Path) -> None:
    footage = open_footage(write_video(tmp_path / "plain.avi", FRAMES, "mpeg4", options={"q": "2", "bf": "2"}))
    assert footage.index is not None
    assert footage.index.counted is None
    assert footage.remarks == ()


def test_a_count_does_not_hide_damage(tmp_path: Path) -> None:
    data = made(tmp_path, "avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) * 6 // 10])
    footage = open_footage(tmp_path / "cut.avi")
    assert footage.count < 55
    assert footage.loss in footage.remarks


def trimmed(whole: Path, cut: Path, first: int) -> Path:
    """Cut without re-encoding, as `ffmpeg -ss -c copy` does.

    Packets from the key frame before `first` on are copied, and an edit list hides those before it.
    """
    with av.open(str(whole)) as source, av.open(str(cut), "w", options={"movflags": "faststart"}) as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        tick = round(1 / 25 / stream.time_base)
        packets = [packet for packet in source.demux(stream) if packet.size]
        key = max(number for number, one in enumerate(packets) if one.is_keyframe and one.pts <= first * tick)
        for packet in packets[key:]:
            packet.pts, packet.dts, packet.stream = packet.pts - first * tick, packet.dts - first * tick, copy
            target.mux(packet)
    return cut


def test_a_trimmed_video_is_whole(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "whole.mp4", FRAMES, options={"x264-params": "bframes=0:keyint=12:scenecut=0"})
    trim = trimmed(whole, tmp_path / "trim.mp4", 16)
    with av.open(str(trim)) as container:
        assert sum(packet.is_discard for packet in container.demux(video=0)) == 4
    footage = open_footage(trim)
    assert footage.remarks == ()
    check_all_readable(footage, range(16, 60))
    data = trim.read_bytes()
    (tmp_path / "cut.mp4").write_bytes(data[: len(data) * 8 // 10])
    cut = open_footage(tmp_path / "cut.mp4")
    assert 20 < cut.count < 44
    assert cut.loss is not None


def test_a_video_that_is_trimmed_at_its_end_is_whole(tmp_path: Path) -> None:
    """As telephones do: the list of edits ends early, all packets stay."""
    data = bytearray(write_video(tmp_path / "whole.mp4", FRAMES, options=B_FRAMES).read_bytes())
    edits = data.index(b"elst") + 12  # after version, flags and their number; durations are in milliseconds
    assert struct.unpack_from(">I", data, edits)[0] == 2400
    struct.pack_into(">I", data, edits, 1000)
    (tmp_path / "trim.mp4").write_bytes(data)
    footage = open_footage(tmp_path / "trim.mp4")
    assert footage.remarks == ()
    check_all_readable(footage, range(25))


@pytest.mark.parametrize("name", ["sound.mp4", "sound.mkv", "sound.ts", "sound.wmv"])
def test_sound_may_last_longer(tmp_path: Path, name: str) -> None:
    with av.open(str(tmp_path / name), "w") as container:
        codecs = ("wmv2", "wmav2") if name.endswith("wmv") else ("libx264", "aac")
        video = container.add_stream(codecs[0], rate=25, options={"b": "4000k"})
        sound = container.add_stream(codecs[1], rate=48000, layout="mono")
        sound.bit_rate = 64000
        video.height, video.width, video.pix_fmt = 48, 64, "yuv420p"
        for content in FRAMES:
            container.mux(video.encode(av.VideoFrame.from_ndarray(content, format="rgb24")))
        container.mux(video.encode())
        for number in range(60 * 48000 // 25 // 1024 + 40):  # nearly a second more
            silence = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            silence.sample_rate, silence.pts = 48000, 1024 * number
            container.mux(sound.encode(silence))
        container.mux(sound.encode())
    footage = open_footage(tmp_path / name)
    assert footage.remarks == ()
    check_all_readable(footage)
