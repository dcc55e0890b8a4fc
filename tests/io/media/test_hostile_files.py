"""Files that promise more than they hold, or are something else than they are called."""

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.errors import InputError
from hfb.io.array_files import names_in, parse_array, read_arrays, weights_file
from hfb.io.clip import ClipCamera
from hfb.io.media.footage import open_footage
from hfb.io.media.lens.camera_files import read_calibration
from hfb.io.media.lens.clip_lens import clip_lens
from hfb.io.media.video import video_file
from hfb.io.toml_file import read_toml
from tests.datasets.real.videos import cameras_json
from tests.io.media.videos import picture, write_video


def npy(header: str, body: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body


def test_arrays_come_back(tmp_path: Path) -> None:
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.array(["x", "long"]),
        "c": np.asfortranarray(np.eye(3, dtype=">f4")),
        "d": np.array(True),
        "e": np.zeros((0, 3), np.uint8),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    found = read_arrays(tmp_path / "a.npz")
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
    assert found["c"].dtype == np.dtype("=f4")
    assert set(read_arrays((tmp_path / "a.npz").read_bytes(), ("a", "none"))) == {"a"}
    assert names_in(tmp_path / "a.npz") == tuple(arrays)
    with pytest.raises(ValueError, match="larger than 0 MB"):
        read_arrays(tmp_path / "a.npz", limit=10)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}", bytes(8)), "do not fit"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, -1)}", bytes(8)), "do not fit"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 99999999999999999999)}"), "impossible shape"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"cos\nsystem\n"), "no plain numbers"),
        (npy("{'descr': '<U0', 'fortran_order': False, 'shape': (1,)}"), "no plain numbers"),
        (npy("[" * 5000), "readable header"),
        (npy("__import__('os')"), "readable header"),
        (b"", "readable header"),
    ],
)
def test_headers_that_lie(data: bytes, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        parse_array(data)


def test_archives_that_are_bombs() -> None:
    def archive(name: str, count: int) -> bytes:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as packed:
            for number in range(count):
                packed.writestr(f"{name}{number}", b"")
        return stream.getvalue()

    with pytest.raises(ValueError, match="more than 10000 members"):
        read_arrays(archive("a", 10_001))
    with pytest.raises(ValueError, match="readable header"):
        read_arrays(archive("../../a", 1))
    assert not Path("../../a0").exists()


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXT-X-TARGETDURATION:5\n#EXTINF:5,\nsecret.ts\n#EXT-X-ENDLIST\n",
        "ffconcat version 1.0\nfile secret.ts\n",
        "ffconcat version 1.0\nfile secret.ts\n" * 30,
    ],
)
@pytest.mark.parametrize("name", ["walk.mp4", "walk.m3u8", "walk.ts"])
def test_a_playlist_opens_nothing(tmp_path: Path, text: str, name: str) -> None:
    write_video(tmp_path / "secret.ts", [picture(number) for number in range(12)], "mpeg2video")
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="can't be read as a video"):
        open_footage(tmp_path / name)


def test_names_are_no_protocols(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, frames in (("concat:a.ts", 12), ("a.ts", 20)):
        write_video(tmp_path / "video.ts", [picture(number) for number in range(frames)], "mpeg2video")
        Path("video.ts").rename(name)
    assert open_footage(Path("concat:a.ts")).count == 12


def test_frames_are_counted_and_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_video(tmp_path / "a.mp4", [picture(number) for number in range(9)])
    monkeypatch.setattr("hfb.io.media.video.video_index.FRAME_LIMIT", 8)
    with pytest.raises(InputError, match="over 8 frames"):
        open_footage(tmp_path / "a.mp4")
    monkeypatch.setattr(video_file, "PIXEL_LIMIT", 1000)
    with pytest.raises(InputError, match="64 x 48 pixels are over the limit"):
        open_footage(tmp_path / "a.mp4")


def test_toml_that_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "device.toml").symlink_to("/dev/zero")
    for name, kind in (("pipe", "named pipe"), ("device", "device")):
        with pytest.raises(InputError, match=f"is a {kind} and no file"):
            read_toml(tmp_path / f"{name}.toml")


def test_toml_and_json_with_the_mark_of_editors_under_windows(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbf[exposure]\r\nfps = 30\r\n")
    assert read_toml(tmp_path / "a.toml") == {"exposure": {"fps": 30}}
    (tmp_path / "cameras.json").write_text(cameras_json(), encoding="utf-8-sig")
    assert read_calibration(tmp_path / "cameras.json")


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 100_000, "a." * 5000 + "b = 1", "a = " + "9" * 5000, "a = 1\n" * 200_000]
)
def test_toml_without_end(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_toml(tmp_path / "a.toml")
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.xml", "<a>" * 100_000, "nests without end"),
        ("a.yaml", "%YAML:1.0\n---\na: " + "[" * 100_000, "nests"),
        ("a.yaml", "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 100000\n   cols: 100000\n   dt: d\n", "size"),
    ],
)
def test_a_calibration_that_ends_opencv(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=says):
        clip_lens(ClipCamera(calibration=tmp_path / name), "a.mp4", 48, 64)


def archive_of(members: dict[str, bytes], packing: int = zipfile.ZIP_STORED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", packing) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


@pytest.mark.parametrize("zipped", [True, False])
def test_weights_come_back(tmp_path: Path, zipped: bool) -> None:
    state = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.ones(4, dtype=torch.float16)}
    torch.save(state, tmp_path / "größe.pth", _use_new_zipfile_serialization=zipped)
    found = torch.load(weights_file(tmp_path / "größe.pth"), weights_only=True)
    assert found.keys() == state.keys()
    assert all(torch.equal(found[name], state[name]) for name in state)


def test_weights_that_are_bombs(tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    members = {"archive/data.pkl": b"N.", "archive/data/0": bytes(1 << 20)}
    path.write_bytes(archive_of(members, zipfile.ZIP_DEFLATED))
    with pytest.raises(ValueError, match="compressed, as torch never does: save it again"):
        weights_file(path)
    whole = archive_of({"archive/data.pkl": b"N."})
    path.write_bytes(whole + b"PK\x05\x06")
    with pytest.raises(ValueError, match="not a readable archive"):
        weights_file(path)
    lying = bytearray(whole)
    at = whole.index(b"PK\x01\x02")
    lying[at + 20 : at + 28] = (0x70000000).to_bytes(4, "little") * 2
    path.write_bytes(lying)
    with pytest.raises(ValueError, match="announces more than it has"):
        weights_file(path)


def test_one_file_is_one_archive(tmp_path: Path) -> None:
    """Python finds the directory before the end, others where the end says that it is: torch sees Python's."""
    packed = archive_of({"archive/data.pkl": b"N." * 1000}, zipfile.ZIP_DEFLATED)
    stored = archive_of({"archive/data.pkl": b"N."})
    path = tmp_path / "two.pth"
    path.write_bytes(packed + stored)
    with zipfile.ZipFile(weights_file(path)) as archive:
        assert [info.compress_type for info in archive.infolist()] == [zipfile.ZIP_STORED]
        assert archive.start_dir < len(stored)
