"""Pictures: every kind a camera or editor writes comes out upright RGB; what is no picture gives one sentence."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from hfb.errors import InputError
from hfb.io.media.images.image_io import picture_size, read_matte, read_picture_srgb, write_matte, write_png


@pytest.fixture
def levels() -> np.ndarray:
    """A small picture without any symmetry."""
    return np.random.default_rng(0).integers(0, 256, (12, 17, 3), dtype=np.uint8)


def test_png_round_trip_is_exact(tmp_path: Path, levels: np.ndarray) -> None:
    write_png(tmp_path / "a.png", levels.astype(np.float32) / 255)
    read = read_picture_srgb(tmp_path / "a.png")
    assert read.dtype == np.float32
    assert np.array_equal(np.round(read * 255), levels)


def test_sixteen_bits_survive(tmp_path: Path) -> None:
    fine = np.random.default_rng(1).random((9, 7, 3)).astype(np.float32)
    for name in ("a.png", "a.tiff"):
        deep = np.round(fine * 65535).astype(np.uint16)
        cv2.imwrite(str(tmp_path / name), deep[..., ::-1])
        assert np.abs(read_picture_srgb(tmp_path / name) - fine).max() < 1e-5
    write_png(tmp_path / "b.png", fine, bits=16)
    assert np.abs(read_picture_srgb(tmp_path / "b.png") - fine).max() < 1e-5


@pytest.mark.parametrize("name", ["a.bmp", "a.tiff", "a.webp", "a.jpg", "a.png"])
def test_every_format(tmp_path: Path, name: str) -> None:
    smooth = np.stack([*np.meshgrid(np.linspace(0, 255, 32), np.linspace(0, 255, 24)), np.full((24, 32), 90.0)], -1)
    Image.fromarray(smooth.astype(np.uint8)).save(tmp_path / name)
    assert np.abs(read_picture_srgb(tmp_path / name) * 255 - smooth).mean() < 4


@pytest.mark.parametrize("mode", ["L", "1", "P", "LA", "RGBA", "CMYK"])
def test_every_mode_becomes_rgb(tmp_path: Path, levels: np.ndarray, mode: str) -> None:
    image = Image.fromarray(levels).convert(mode)
    name = "a.tiff" if mode == "CMYK" else "a.png"
    image.save(tmp_path / name)
    expected = np.asarray(image.convert("RGB"), np.float32) / 255
    assert np.array_equal(read_picture_srgb(tmp_path / name), expected)


def test_alpha_is_dropped_not_multiplied(tmp_path: Path, levels: np.ndarray) -> None:
    rgba = np.dstack([levels, np.zeros(levels.shape[:2], np.uint8)])
    Image.fromarray(rgba).save(tmp_path / "a.png")
    assert np.array_equal(np.round(read_picture_srgb(tmp_path / "a.png") * 255), levels)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.webp", "a.tiff", "deep.png", "deep.tiff"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_cameras_rotation_is_applied_once(tmp_path: Path, levels: np.ndarray, name: str, orientation: int) -> None:
    """Also by who only measures: a TIFF that is turned must have the size of the plate beside it."""
    path, smooth = tmp_path / name, cv2.GaussianBlur(levels, (0, 0), 3)
    exif = Image.Exif()
    exif[0x0112] = orientation
    if name == "deep.png":
        plain = _png16(smooth)
        block = exif.tobytes().removeprefix(b"Exif\0\0")
        chunk = struct.pack(">I", len(block)) + b"eXIf" + block + struct.pack(">I", zlib.crc32(b"eXIf" + block))
        path.write_bytes(plain[:33] + chunk + plain[33:])
    elif name == "deep.tiff":
        tifffile = pytest.importorskip("tifffile")
        extra = [(274, "H", 1, orientation, True)]
        tifffile.imwrite(path, smooth.astype(np.uint16) * 257, photometric="rgb", extratags=extra, metadata=None)
    else:
        Image.fromarray(smooth).save(path, exif=exif, **({"lossless": True} if name == "a.webp" else {}))
    upright = {
        1: smooth, 2: smooth[:, ::-1], 3: smooth[::-1, ::-1], 4: smooth[::-1], 5: smooth.swapaxes(0, 1),
        6: np.rot90(smooth, -1), 7: smooth[::-1, ::-1].swapaxes(0, 1), 8: np.rot90(smooth),
    }[orientation]  # fmt: skip
    read = read_picture_srgb(path)
    assert picture_size(path) == (*read.shape[:2], 16 if "deep" in name else 8)
    assert read.shape == upright.shape
    assert np.abs(read * 255 - upright).mean() < (3 if name == "a.jpg" else 0.01)


def _png16(levels: np.ndarray) -> bytes:
    done, data = cv2.imencode(".png", levels[..., ::-1].astype(np.uint16) * 257)
    assert done
    return data.tobytes()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (b"hello, I am a text", "not a picture"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 40, "picture"),
        (b"GIF89a" + b"\0" * 40, "not a picture"),
    ],
)
def test_what_is_no_picture_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(InputError, match=says):
        read_picture_srgb(tmp_path / "a.png")


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tiff", "a.webp", "a.bmp", "deep.png"])
def test_truncated_is_refused(tmp_path: Path, name: str) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    if name == "deep.png":
        data = _png16(noise)
    else:
        Image.fromarray(noise).save(tmp_path / name)
        data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(InputError, match=r"truncated|not a picture"):
        read_picture_srgb(tmp_path / name)


def test_missing_folder_and_text_have_their_own_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_picture_srgb(tmp_path / "none.png")
    with pytest.raises(InputError, match="folder"):
        read_picture_srgb(tmp_path)


def test_a_bomb_is_refused_before_decoding(tmp_path: Path) -> None:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    (tmp_path / "bomb.png").write_bytes(data)
    with pytest.raises(InputError, match="megapixels"):
        read_picture_srgb(tmp_path / "bomb.png")


def test_matte_keeps_sixteen_bits(tmp_path: Path) -> None:
    matte = np.random.default_rng(0).random((20, 30)).astype(np.float32)
    write_matte(tmp_path / "m.png", matte)
    assert np.abs(read_matte(tmp_path / "m.png") - matte).max() <= 0.5 / 65535 + 1e-6


def test_a_failed_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "a.png"
    target.write_bytes(b"before")
    monkeypatch.setattr("pathlib.Path.replace", _fail)
    with pytest.raises(OSError, match="no space"):
        write_png(target, np.zeros((4, 4, 3), np.float32))
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
    assert target.read_bytes() == b"before"


def _fail(*_: object) -> None:
    raise OSError("no space")
