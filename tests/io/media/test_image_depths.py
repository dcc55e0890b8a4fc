"""Pictures of 10 to 16 bits as machine vision and scanners store them: right, or a sentence on how deep they seem."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.config import CameraConfig, ExposureConfig
from hfb.errors import InputError
from hfb.io.clip import Clip
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_decoding import decode_picture, picture_size
from hfb.io.media.images.image_io import read_matte, write_matte
from hfb.io.media.plate import find_plate
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.image.prepare import prepare
from tests.shared import REPORTS

LIGHT = np.random.default_rng(0).random((21, 37, 3))
LIGHT[0, 0] = 1


def packed_tiff(path: Path, light: np.ndarray, bits: int, order: str = "<", inverted: bool = False) -> Path:
    """Uncompressed, the samples of a row packed without gaps, two strips; what TIFF 6 means by BitsPerSample 12."""
    height, width, samples = light.shape
    levels = np.round(light * ((1 << bits) - 1)).astype(np.uint32)
    levels = (1 << bits) - 1 - levels if inverted else levels
    ones = (levels.reshape(height, -1, 1) >> np.arange(bits - 1, -1, -1) & 1).astype(np.uint8).reshape(height, -1)
    rows = np.packbits(ones, axis=1)
    cut = height // 2 + 1
    strips = [rows[:cut].tobytes(), rows[cut:].tobytes()]
    tags = {
        256: ("I", [width]),
        257: ("I", [height]),
        258: ("H", [bits] * samples),
        259: ("H", [1]),
        262: ("H", [2 if samples == 3 else 0 if inverted else 1]),
        273: ("I", [0, 0]),
        277: ("H", [samples]),
        278: ("I", [cut]),
        279: ("I", [len(strip) for strip in strips]),
    }
    at = 8 + 2 + 12 * len(tags) + 4
    starts = [at + 100, at + 100 + len(strips[0])]
    tags[273] = ("I", starts)
    entries, more = b"", b""
    for tag, (kind, values) in sorted(tags.items()):
        content = struct.pack(f"{order}{len(values)}{kind}", *values)
        place = content.ljust(4, b"\0") if len(content) <= 4 else struct.pack(f"{order}I", at + len(more))
        more += content if len(content) > 4 else b""
        entries += struct.pack(f"{order}HHI", tag, 3 if kind == "H" else 4, len(values)) + place
    head = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HIH", 42, 8, len(tags)) + entries + bytes(4)
    path.write_bytes((head + more).ljust(at + 100, b"\0") + b"".join(strips))
    return path


def png16(path: Path, levels: np.ndarray, chunk: bytes = b"", content: bytes = b"") -> Path:
    """A PNG of 16 bits with a chunk more."""
    data = cv2.imencode(".png", levels[..., ::-1].astype(np.uint16))[1].tobytes()
    more = struct.pack(">I", len(content)) + chunk + content + struct.pack(">I", zlib.crc32(chunk + content))
    path.write_bytes(data[:33] + (more if chunk else b"") + data[33:])
    return path


@pytest.mark.parametrize("bits", [10, 12, 14])
@pytest.mark.parametrize(("samples", "order", "inverted"), [(1, "<", False), (1, ">", True), (3, "<", False)])
def test_packed_samples(tmp_path: Path, bits: int, samples: int, order: str, inverted: bool) -> None:
    light = LIGHT[..., :samples]
    path = packed_tiff(tmp_path / "a.tif", light, bits, order, inverted)
    picture = decode_picture(path)
    assert np.abs(picture.pixels - np.broadcast_to(light, LIGHT.shape)).max() <= 0.51 / ((1 << bits) - 1)
    assert picture.seems_bits is None
    assert picture_size(path) == (21, 37, 16)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - 300])
    with pytest.raises(InputError, match="truncated or damaged"):
        decode_picture(path)


@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
@pytest.mark.parametrize("samples", [3, 4])
@pytest.mark.parametrize("order", ["<", ">"])
def test_planes_of_sixteen_bits(tmp_path: Path, compression: str | None, samples: int, order: str) -> None:
    tifffile = pytest.importorskip("tifffile")
    if compression == "lzw":
        pytest.importorskip("imagecodecs")
    levels = np.round(np.dstack([LIGHT, LIGHT[..., :1]])[..., :samples] * 65535).astype(np.uint16)
    tifffile.imwrite(
        tmp_path / "a.tif",
        levels.transpose(2, 0, 1),
        photometric="rgb",
        planarconfig="separate",
        rowsperstrip=5,
        compression=compression,
        byteorder=order,
        extrasamples=["unassalpha"] if samples == 4 else None,
    )
    assert np.array_equal(np.round(decode_picture(tmp_path / "a.tif").pixels * 65535), levels[..., :3])


@pytest.mark.skipif(not REPORTS.is_dir(), reason="the reported files are not here")
@pytest.mark.parametrize("name", ["planar16", "gray12packed"])
def test_the_reported_pictures_are_like_their_plates(name: str) -> None:
    frame, plate = (decode_picture(REPORTS / f"{kind}_{name}.tif").pixels for kind in ("frame", "plate"))
    assert 0.3 < plate.mean() < 0.5
    assert np.median(np.abs(frame - plate)) < 0.02
    assert np.abs(np.diff(plate, axis=0)).mean() < 0.05  # a picture, no torn rows


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_sbit_of_samples_that_were_not_stretched(tmp_path: Path, bits: int) -> None:
    full = (1 << bits) - 1
    levels = np.round(LIGHT * full).astype(np.uint16)
    told = bytes([bits] * 3)
    assert np.abs(decode_picture(png16(tmp_path / "a.png", levels, b"sBIT", told)).pixels - LIGHT).max() < 0.51 / full
    stretched = levels << (16 - bits)
    for stored in (stretched, stretched | levels >> (2 * bits - 16)):  # as the standard has it
        read = decode_picture(png16(tmp_path / "b.png", stored, b"sBIT", told))
        assert np.abs(read.pixels - LIGHT).max() < 2 / full
        dark = decode_picture(png16(tmp_path / "c.png", stored >> 15 << 8, b"sBIT", told))
        assert dark.pixels.max() < 0.01  # stretched, of a dark scene


def test_maxsamplevalue_of_tiff(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    levels = np.round(LIGHT * 4095).astype(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", levels, photometric="rgb", extratags=[(281, "H", 3, (4095,) * 3, True)])
    assert np.abs(decode_picture(tmp_path / "a.tif").pixels - LIGHT).max() < 0.51 / 4095


@pytest.mark.parametrize("bits", [10, 12])
def test_what_only_the_values_say_is_told(tmp_path: Path, bits: int) -> None:
    dark = np.round(LIGHT * ((1 << bits) - 1))
    files = [png16(tmp_path / f"{number}.png", dark) for number in range(3)]
    assert decode_picture(files[0]).seems_bits == bits
    sentence = f"seems to hold {bits} bits per channel in its 16, so that it is read {1 << 16 - bits} times too dark"
    handles = tuple(FileHandle.of(file) for file in files)

    def prepared(frames: tuple[FileHandle, ...], clip: Clip) -> ClipHandle:
        return prepare.fn(
            frames=frames, background=handles[1], clip=clip, camera=CameraConfig(), exposure=ExposureConfig()
        )

    with pytest.raises(InputError, match=sentence):
        prepared(handles[:1], Clip())
    with pytest.raises(InputError, match=sentence):
        open_footage(tmp_path)
    (tmp_path / "bright").mkdir()
    bright = png16(tmp_path / "bright" / "0.png", np.round(LIGHT * 65535))
    with pytest.raises(InputError, match=sentence):
        find_plate(open_footage([bright]), files[0])
    # Linear light may be as dark: a word, no more.
    linear = Clip.model_validate({"transfer": "linear"})
    assert any(sentence in remark for remark in prepared(handles[:1], linear).remarks)
    assert any(sentence in remark for remark in open_footage(files, transfer="linear").remarks)
    # One picture that is as bright as its bits allow: the others are dark, no more.
    told = prepared((FileHandle.of(bright),), Clip()).remarks
    assert not any("seems to hold" in remark for remark in told)


def test_black_and_mattes_are_no_doubt(tmp_path: Path) -> None:
    assert decode_picture(png16(tmp_path / "a.png", np.zeros((8, 8, 3)))).seems_bits is None
    write_matte(tmp_path / "m.png", np.full((8, 8), 0.01, np.float32))
    assert read_matte(tmp_path / "m.png").max() == pytest.approx(0.01, abs=1e-4)


def test_gray_palette_and_alpha_at_sixteen_bits(tmp_path: Path) -> None:
    levels = np.round(LIGHT * 65535).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "gray.png"), levels[..., 0])
    cv2.imwrite(str(tmp_path / "alpha.png"), np.dstack([levels[..., ::-1], np.full(levels.shape[:2], 9, np.uint16)]))
    gray = decode_picture(tmp_path / "gray.png").pixels
    assert np.abs(gray - LIGHT[..., :1]).max() < 1e-5
    assert np.abs(decode_picture(tmp_path / "alpha.png").pixels - LIGHT).max() < 1e-5
