"""What is no finished picture is told by its content, in one sentence with the way out."""

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hfb.errors import InputError
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_io import picture_size, read_picture_srgb
from hfb.tasks.inputs.clip_places import resolve_source
from tests.shared import REPORTS


def thumbnail_first(path: Path, photometric: str | int = 32803) -> Path:
    """Like a camera's raw file: a small picture first, the sensor's values below it."""
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffWriter(path) as file:
        small = np.full((20, 30, 3), 90, np.uint8)
        file.write(small, photometric="rgb", subfiletype=1, subifds=1, metadata=None)
        file.write(np.full((80, 120), 900, np.uint16), photometric=photometric, metadata=None)
    return path


def dng(path: Path) -> Path:
    tifffile = pytest.importorskip("tifffile")
    extra = [(50706, "B", 4, (1, 4, 0, 0), True)]
    tifffile.imwrite(path, np.zeros((20, 30, 3), np.uint16), photometric="rgb", extratags=extra, metadata=None)
    return path


@pytest.mark.parametrize("name", ["frame.NEF", "frame.tif", "frame.dng", "frame.arw"])
def test_raw_files_of_cameras(tmp_path: Path, name: str) -> None:
    for make in (thumbnail_first, lambda path: thumbnail_first(path, "minisblack"), dng):
        path = make(tmp_path / name)
        for read in (read_picture_srgb, picture_size, open_footage):
            with pytest.raises(InputError, match=r"is a camera raw file.*16-bit TIFF or PNG"):
                read(path)


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("a.CR3", b"\0\0\0\x18ftypcrx \0\0\0\x01crx isom"),
        ("a.cr2", b"II*\0\x10\0\0\0CR\x02\0"),
        ("a.raf", b"FUJIFILMCCD-RAW 0201FF159503"),
        ("a.orf", b"IIRO\x08\0\0\0"),
        ("a.rw2", b"IIU\0\x18\0\0\0"),
        ("a.crw", b"II\x1a\0\0\0HEAPCCDR"),
        ("a.x3f", b"FOVb\0\0\0\0"),
        ("a.mrw", b"\0MRM\0\0\0\0"),
    ],
)
@pytest.mark.parametrize("ending", ["", ".png", ".mp4"])
def test_raw_files_by_their_heads(tmp_path: Path, name: str, head: bytes, ending: str) -> None:
    path = tmp_path / (name + ending)
    path.write_bytes(head.ljust(4096, b"\0"))
    for read in (read_picture_srgb, open_footage):
        with pytest.raises(InputError, match="is a camera raw file"):
            read(path)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "is a HEIC picture, which is not read; convert it to PNG"),
        (b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", "is a HEIC picture"),
        (b"\0\0\0\x18ftypavif\0\0\0\0avifmif1", "is an AVIF picture"),
        (b"8BPS\0\x01", "is a Photoshop document"),
        (b"\xff\x0a\0\0", "is a JPEG XL picture"),
        (b"\x76\x2f\x31\x01", "is an OpenEXR picture"),
    ],
)
@pytest.mark.parametrize("name", ["IMG_0001.HEIC", "IMG_0001.jpg", "IMG_0001.mov"])
def test_other_kinds_by_name(tmp_path: Path, head: bytes, words: str, name: str) -> None:
    (tmp_path / name).write_bytes(head.ljust(4096, b"\0"))
    for read in (read_picture_srgb, open_footage):
        with pytest.raises(InputError, match=words):
            read(tmp_path / name)


def test_a_folder_of_them(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"IMG_{number}.HEIC").write_bytes(b"\0\0\0\x18ftypheic".ljust(64, b"\0"))
    for read in (open_footage, lambda folder: resolve_source(folder, None)):
        with pytest.raises(InputError, match=r"IMG_0.HEIC: is a HEIC picture"):
            read(tmp_path)


def test_tiffs_with_more_than_one_picture_stay_pictures(tmp_path: Path) -> None:
    """Pages, and pyramids, whose smaller pictures come after the large one."""
    tifffile = pytest.importorskip("tifffile")
    picture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    with tifffile.TiffWriter(tmp_path / "pyramid.tif") as file:
        file.write(picture, photometric="rgb", subifds=1, metadata=None)
        file.write(picture[::2, ::2], photometric="rgb", subfiletype=1, metadata=None)
    tifffile.imwrite(tmp_path / "pages.tif", np.stack([picture, picture]), photometric="rgb", metadata=None)
    for name in ("pyramid.tif", "pages.tif"):
        assert np.array_equal(np.round(read_picture_srgb(tmp_path / name) * 255), picture)


def test_numbers_that_are_no_photograph(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    for number, kind in enumerate((np.float32, np.float16, np.uint32)):
        tifffile.imwrite(tmp_path / f"{number}.tif", np.zeros((8, 8, 3), kind), photometric="rgb")
        with pytest.raises(InputError, match="32-bit or floating-point numbers"):
            read_picture_srgb(tmp_path / f"{number}.tif")


@pytest.mark.skipif(not REPORTS.is_dir(), reason="the reported files are not here")
@pytest.mark.parametrize("name", ["frame.NEF", "plate.NEF"])
def test_the_reported_raw_files(name: str) -> None:
    with pytest.raises(InputError, match="camera raw"):
        read_picture_srgb(REPORTS / name)


def test_damaged_directories_end(tmp_path: Path) -> None:
    loops = b"II*\0\x08\0\0\0" + struct.pack("<HHHIII", 1, 330, 4, 1, 8, 8) + b"\0" * 40
    (tmp_path / "a.tif").write_bytes(loops)
    with pytest.raises(InputError):
        read_picture_srgb(tmp_path / "a.tif")
    Image.new("RGB", (8, 8)).save(tmp_path / "b.tif")
    (tmp_path / "b.tif").write_bytes((tmp_path / "b.tif").read_bytes()[:20])
    with pytest.raises(InputError):
        read_picture_srgb(tmp_path / "b.tif")
