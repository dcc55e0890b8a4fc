"""Slow motion and time lapse: the rate of the capture counts where a file says it, and what the user says before it."""

import struct
from pathlib import Path

import av
import numpy as np
import pytest

from hfb.config import ExposureConfig
from hfb.io.clip import ClipExposure
from hfb.io.media.capture_rate import is_time_mapped
from hfb.io.media.footage import open_footage
from hfb.io.media.timing import settle_timing
from tests.io.media.mp4 import with_box, with_edits
from tests.io.media.videos import numbers_in, picture, write_video

FRAMES = [picture(number) for number in range(16)]
ANDROID, APPLE = "com.android.capture.fps", "com.apple.quicktime.full-frame-rate-playback-intent"
SONY = (
    b'<?xml version="1.0"?><NonRealTimeMeta><VideoFormat><VideoFrame videoCodec="AVC" captureFps="119.88p" '
    b'formatFps="29.97p"/></VideoFormat></NonRealTimeMeta>'
)


def tagged(path: Path, name: str, value: str, rate: int = 30) -> Path:
    """A video whose container has an entry, as telephones write it."""
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata[name] = value
        stream = container.add_stream("libx264", rate=rate)
        stream.height, stream.width, stream.pix_fmt = 48, 64, "yuv420p"
        for content in FRAMES:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(content, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(("value", "fps"), [("240.0", 240), ("120", 120), ("240000/1001", 240000 / 1001), ("2.0", 2)])
def test_androids_entry(tmp_path: Path, value: str, fps: float) -> None:
    footage = open_footage(tagged(tmp_path / "slow.mp4", ANDROID, value))
    assert footage.interval_s == pytest.approx(1 / fps)
    assert np.allclose(np.diff(footage.times_s), 1 / fps)
    (remark,) = footage.remarks
    assert f"captured at {fps:.6g} frames per second, by its entry com.android.capture.fps, and plays at 30" in remark
    part = open_footage(tmp_path / "slow.mp4", start_s=0.2, stop_s=0.4)  # on the file's own clock
    assert np.array_equal(numbers_in(np.stack(list(part.frames()))), np.array([6, 7, 0, 1, 2, 3]))
    timing = settle_timing(footage, ClipExposure(), ExposureConfig())
    assert timing.exposure_s == pytest.approx(1 / fps)


@pytest.mark.parametrize("value", ["30.0", "29.97", "0", "nan", "1e99", "-240", "fast", "240/0"])
def test_what_is_no_other_rate_changes_nothing(tmp_path: Path, value: str) -> None:
    footage = open_footage(tagged(tmp_path / "plain.mp4", ANDROID, value))
    assert footage.interval_s == pytest.approx(1 / 30)
    assert footage.remarks == ()


def test_the_user_wins(tmp_path: Path) -> None:
    footage = open_footage(tagged(tmp_path / "slow.mp4", ANDROID, "240.0"), fps=60)
    assert footage.interval_s == 1 / 60
    assert np.allclose(np.diff(footage.times_s), 1 / 60)
    assert footage.remarks == ()


@pytest.mark.parametrize("versioned", [True, False])
def test_sonys_xml(tmp_path: Path, versioned: bool) -> None:
    plain = write_video(tmp_path / "plain.mp4", FRAMES, rate=30)
    xml = struct.pack(">I4s", 12 + len(SONY), b"xml ") + bytes(4) + SONY
    slow = with_box(tmp_path / "slow.mp4", plain, [], b"meta", bytes(4) * versioned + xml)
    footage = open_footage(slow)
    assert footage.interval_s == pytest.approx(1 / 119.88)
    assert "by its entry captureFps" in footage.remarks[0]


@pytest.mark.parametrize(
    "record", [b"VFPSL\x08\0\x01" + struct.pack(">2I", 240000, 1001), b"VFPSS\x02\0\x02" + struct.pack(">2H", 240, 1)]
)
def test_gopros_settings(tmp_path: Path, record: bytes) -> None:
    plain = write_video(tmp_path / "plain.mp4", FRAMES, rate=30)
    settings = b"DEVC\0\x01\0\x20" + b"DVID\x4c\x04\0\x01\0\0\0\x01" + record
    inside = struct.pack(">I4s", 8 + len(settings), b"GPMF") + settings
    # A udta of one's own before PyAV's: the first of the two is no GoPro's.
    slow = with_box(tmp_path / "slow.mp4", plain, [b"moov"], b"udta", inside)
    footage = open_footage(slow)
    assert footage.interval_s == pytest.approx(1 / 240, rel=2e-3)
    assert "GoPro's settings" in footage.remarks[0]


def test_apples_entry_leaves_the_cameras_own_stamps(tmp_path: Path) -> None:
    footage = open_footage(tagged(tmp_path / "slow.mov", APPLE, "0", rate=240))
    assert footage.interval_s == pytest.approx(1 / 240)
    assert "a telephone's slow motion" in footage.remarks[0]
    footage = open_footage(tagged(tmp_path / "fast.mov", APPLE, "1", rate=240))
    assert footage.interval_s == pytest.approx(1 / 240)
    assert footage.remarks == ()


def test_a_time_mapped_list_of_edits(tmp_path: Path) -> None:
    """A telephone's slow motion: full speed, an eighth of it, full speed again."""
    plain = write_video(tmp_path / "plain.mp4", FRAMES, rate=240, options={"bf": "0"})
    with av.open(str(plain)) as container:
        tick = round(1 / 240 / container.streams.video[0].time_base)
    one = 1000 / 240
    edits = [(round(4 * one), 0, 1.0), (round(64 * one), 4 * tick, 0.125), (round(4 * one), 12 * tick, 1.0)]
    slow = with_edits(tmp_path / "slow.mp4", plain, edits)
    assert is_time_mapped(slow)
    assert not is_time_mapped(plain)
    footage = open_footage(slow)
    assert footage.count == 16
    assert np.allclose(np.diff(footage.times_s), 1 / 240)
    assert np.array_equal(list(footage.frames()), list(open_footage(plain).frames()))
    assert "a telephone's slow motion" in footage.remarks[0]


@pytest.mark.parametrize("content", [b"", b"\0\0\0\x08ftyp", b"\0\0\0\x10ftypisom", b"\0\0\0\x01moov" + b"\xff" * 8])
def test_damaged_boxes_say_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    assert not is_time_mapped(tmp_path / "a.mp4")


def test_a_clock_of_milliseconds(tmp_path: Path) -> None:
    """60 frames per second are 17, 17, 16 ms apart in Matroska: the stated rate counts."""
    stamps = [round(1000 * number / 60) for number in range(16)]
    path = write_video(tmp_path / "short.mkv", FRAMES[:6], "ffv1", stamps=stamps[:6], rate=60)
    footage = open_footage(path)
    assert footage.interval_s == pytest.approx(1 / 60, rel=1e-9)
    assert np.allclose(footage.times_s - footage.times_s[0], np.arange(6) / 60, atol=1e-9)
    timing = settle_timing(footage, ClipExposure(seconds=1 / 60), ExposureConfig())
    assert timing.exposure_s == pytest.approx(1 / 60)


def test_a_varying_rate_is_not_made_even(tmp_path: Path) -> None:
    stamps = [0, 40, 80, 118, 163, 200, 240]
    footage = open_footage(write_video(tmp_path / "v.mkv", FRAMES[:7], "ffv1", stamps=stamps))
    assert np.allclose(footage.times_s * 1000, stamps)


@pytest.mark.parametrize("name", ["soft.mkv", "soft.mp4"])
def test_film_that_is_shown_for_two_and_three_fields(tmp_path: Path, name: str) -> None:
    """Soft telecine, as MPEG-2 from film discs has it: whole pictures, uneven stamps."""
    fields = np.cumsum([0, *(2 + number % 2 for number in range(15))])
    stamps = [round(one * 1001 / 60) for one in fields]
    codec = "ffv1" if name.endswith("mkv") else "libx264"
    footage = open_footage(write_video(tmp_path / name, FRAMES, codec, stamps=stamps, rate=24))
    assert footage.interval_s == pytest.approx(2.5 * 1.001 / 60, rel=0.02)
    assert np.allclose(np.diff(footage.times_s), footage.interval_s)
    (remark,) = footage.remarks
    assert "two and three fields in turn" in remark
