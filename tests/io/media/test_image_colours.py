"""Pictures whose files say that their colours are not sRGB's are converted, at every depth, and it is said."""

import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms

from hfb.config import CameraConfig, ExposureConfig
from hfb.errors import InputError
from hfb.io.clip import Clip
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_decoding import decode_picture
from hfb.io.media.images.image_io import read_matte, read_picture_srgb
from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.image.prepare import prepare

# Linear light of these primaries to sRGB's, by the published matrices (CSS Color 4).
P3 = np.array([[1.2249402, -0.2249402, 0], [-0.0420570, 1.0420570, 0], [-0.0196376, -0.0786361, 1.0982736]])
ADOBE = np.array([[1.3983557, -0.3983557, 0], [0, 1, 0], [0, -0.0429290, 1.0429290]])
SCENE = 0.25 + 0.5 * np.random.default_rng(0).random((16, 24, 3))
SCENE[:, :8] = SCENE[:, :8].mean(-1, keepdims=True)


def profile(to_srgb: np.ndarray, curve: bytes, space: bytes = b"RGB ") -> bytes:
    """An ICC profile of a matrix and one curve: what cameras and editors embed."""
    srgb = np.array(
        [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]]
    )
    columns = (srgb @ to_srgb).T
    tags = {b"rTRC": curve, b"gTRC": curve, b"bTRC": curve, b"wtpt": xyz(np.array([0.9642, 1, 0.8249]))}
    tags |= {name: xyz(column) for name, column in zip((b"rXYZ", b"gXYZ", b"bXYZ"), columns, strict=True)}
    text = b"a test's colours"
    tags[b"desc"] = b"desc" + bytes(4) + struct.pack(">I", len(text) + 1) + text + bytes(1 + 4 + 4 + 2 + 1 + 67)
    tags[b"cprt"] = b"text" + bytes(4) + b"none\0"
    if space == b"GRAY":
        tags[b"kTRC"] = curve
    at, table, content = 132 + 12 * len(tags), b"", b""
    for name, data in tags.items():
        table += struct.pack(">4sII", name, at + len(content), len(data))
        content += data.ljust(-(-len(data) // 4) * 4, b"\0")
    head = struct.pack(">I4sI4s4s4s", at + len(content), b"none", 0x02400000, b"mntr", space, b"XYZ ")
    head = head.ljust(36, b"\0") + b"acsp"
    head = head.ljust(68, b"\0") + struct.pack(">3i", 63190, 65536, 54061)
    return head.ljust(128, b"\0") + struct.pack(">I", len(tags)) + table + content


def xyz(column: np.ndarray) -> bytes:
    return b"XYZ " + bytes(4) + struct.pack(">3i", *np.round(column * 65536).astype(int))


def gamma(power: float) -> bytes:
    return b"curv" + bytes(4) + struct.pack(">IH", 1, round(power * 256)) + bytes(2)


SRGB_CURVE = (
    b"para"
    + bytes(4)
    + struct.pack(">HH5i", 3, 0, *(round(v * 65536) for v in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))
)
KINDS = {
    "Display P3": (P3, SRGB_CURVE, srgb_to_linear),
    "Adobe RGB": (ADOBE, gamma(563 / 256), lambda x: x ** (563 / 256)),
    "a gamma of 1.8": (np.eye(3), gamma(1.8), lambda x: x**1.8),
    "linear": (np.eye(3), b"curv" + bytes(8), lambda x: x),
}


def save(path: Path, levels: np.ndarray, icc: bytes) -> Path:
    """A file of this kind with a profile."""
    if levels.dtype == np.uint8:
        more = (
            {"quality": 100, "subsampling": 0}
            if path.suffix == ".jpg"
            else {"lossless": True}
            if path.suffix == ".webp"
            else {}
        )
        Image.fromarray(levels).save(path, icc_profile=icc, **more)
    elif path.suffix == ".tif":
        tifffile = pytest.importorskip("tifffile")
        tifffile.imwrite(path, levels, photometric="rgb", iccprofile=icc)
    else:
        with_chunks(path, levels, {b"iCCP": b"x\0\0" + zlib.compress(icc)})
    return path


def with_chunks(path: Path, levels: np.ndarray, chunks: dict[bytes, bytes]) -> Path:
    data = cv2.imencode(".png", levels[..., ::-1])[1].tobytes()
    more = b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks.items()
    )
    path.write_bytes(data[:33] + more + data[33:])
    return path


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.webp", "deep.png", "deep.tif"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_profile_is_applied(tmp_path: Path, kind: str, name: str) -> None:
    matrix, curve, decode = KINDS[kind]
    full, dtype = (65535, np.uint16) if name.startswith("deep") else (255, np.uint8)
    scene = (
        np.full_like(SCENE, 0.5) + 0.2 * np.linspace(-1, 1, 24)[:, None] * np.array([1, -0.5, 0.3])
        if name == "a.jpg"
        else SCENE
    )
    levels = np.round(scene * full).astype(dtype)
    path = save(tmp_path / name, levels, profile(matrix, curve))
    expected = linear_to_srgb((decode(levels / full) @ matrix.T).clip(0, 1))
    picture = decode_picture(path)
    assert np.abs(picture.pixels - expected).max() < (6 / 255 if name == "a.jpg" else 2e-3)
    (remark,) = picture.remarks
    assert remark == f"{name} has the colours of a test's colours: converted to sRGB"
    # What the user says of the light counts before the file's word.
    assert np.abs(read_picture_srgb(path, "linear") - levels / full).max() < (6 / 255 if name == "a.jpg" else 1e-6)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "deep.png"])
def test_srgbs_own_profiles_change_nothing(tmp_path: Path, name: str) -> None:
    full, dtype = (65535, np.uint16) if name == "deep.png" else (255, np.uint8)
    levels = np.round(np.random.default_rng(1).random((16, 16, 3)) * full).astype(dtype)
    for icc in (profile(np.eye(3), SRGB_CURVE), ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()):
        picture = decode_picture(save(tmp_path / name, levels, icc))
        assert np.array_equal(np.round(picture.pixels * full), levels)
        assert picture.remarks == ()


def test_it_agrees_with_littlecms(tmp_path: Path) -> None:
    levels = np.round(SCENE * 255).astype(np.uint8)
    icc = profile(P3, SRGB_CURVE)
    theirs = ImageCms.profileToProfile(
        Image.fromarray(levels),
        ImageCms.ImageCmsProfile(io.BytesIO(icc)),
        ImageCms.createProfile("sRGB"),
        outputMode="RGB",
    )
    ours = read_picture_srgb(save(tmp_path / "a.png", levels, icc))
    assert np.abs(ours * 255 - np.asarray(theirs, np.float32)).max() < 1.1


def test_gray_with_a_gamma(tmp_path: Path) -> None:
    levels = np.round(SCENE[..., 0] * 255).astype(np.uint8)
    Image.fromarray(levels).save(tmp_path / "a.png", icc_profile=profile(np.eye(3), gamma(1.8), b"GRAY"))
    expected = linear_to_srgb((levels / 255) ** 1.8)
    assert np.abs(read_picture_srgb(tmp_path / "a.png")[..., 1] - expected).max() < 1e-3


@pytest.mark.parametrize(("power", "told"), [(100000, True), (55556, True), (45455, False), (0, False)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_pngs_gamma(tmp_path: Path, power: int, told: bool, dtype: type) -> None:
    full = np.iinfo(dtype).max
    levels = np.round(SCENE * full).astype(dtype)
    picture = decode_picture(with_chunks(tmp_path / "a.png", levels, {b"gAMA": struct.pack(">I", power)}))
    expected = linear_to_srgb((levels / full) ** (1e5 / power)) if told else levels / full
    assert np.abs(picture.pixels - expected).max() < 1e-3
    assert bool(picture.remarks) == told
    srgb = decode_picture(with_chunks(tmp_path / "b.png", levels, {b"sRGB": b"\0", b"gAMA": struct.pack(">I", power)}))
    assert np.abs(srgb.pixels - levels / full).max() < 1e-6
    assert srgb.remarks == ()


def test_a_pngs_primaries(tmp_path: Path) -> None:
    levels = np.round(SCENE * 255).astype(np.uint8)
    places = struct.pack(">8I", 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000)
    picture = decode_picture(
        with_chunks(tmp_path / "a.png", levels, {b"gAMA": struct.pack(">I", 45455), b"cHRM": places})
    )
    assert np.abs(picture.pixels - linear_to_srgb((srgb_to_linear(levels / 255) @ P3.T).clip(0, 1))).max() < 1e-3
    assert picture.remarks == ("a.png has the colours of cHRM: converted to sRGB",)
    usual = struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)
    assert decode_picture(with_chunks(tmp_path / "b.png", levels, {b"cHRM": usual})).remarks == ()


def test_a_pngs_code_points(tmp_path: Path) -> None:
    levels = np.round(SCENE * 255).astype(np.uint8)
    picture = decode_picture(with_chunks(tmp_path / "a.png", levels, {b"cICP": bytes([12, 13, 0, 1])}))
    assert np.abs(picture.pixels - linear_to_srgb((srgb_to_linear(levels / 255) @ P3.T).clip(0, 1))).max() < 1e-3
    assert "Display P3" in picture.remarks[0]
    assert decode_picture(with_chunks(tmp_path / "b.png", levels, {b"cICP": bytes([1, 13, 0, 1])})).remarks == ()
    for transfer, kind in ((16, "PQ"), (18, "HLG")):
        with pytest.raises(InputError, match=rf"high dynamic range picture \({kind}\)"):
            decode_picture(with_chunks(tmp_path / "c.png", levels, {b"cICP": bytes([9, transfer, 0, 1])}))


def test_adobe_rgb_of_cameras_that_embed_no_profile(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = 65535
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    level = np.full((16, 16, 3), (120, 140, 90), np.uint8)
    Image.fromarray(level).save(tmp_path / "_DSC1.jpg", exif=exif, quality=100)
    picture = decode_picture(tmp_path / "_DSC1.jpg")
    expected = linear_to_srgb((level[0, 0] / 255) ** (563 / 256) @ ADOBE.T)
    assert np.abs(picture.pixels - expected).max() < 0.02
    assert "Adobe RGB" in picture.remarks[0]


@pytest.mark.parametrize("icc", [b"", b"no profile", profile(P3, SRGB_CURVE)[:200], profile(P3, b"none" + bytes(20))])
def test_damaged_profiles_are_told(tmp_path: Path, icc: bytes) -> None:
    levels = np.round(SCENE * 255).astype(np.uint8)
    picture = decode_picture(save(tmp_path / "a.png", levels, icc))
    assert np.array_equal(np.round(picture.pixels * 255), levels)
    assert bool(icc) == any("colour profile that cannot be used" in remark for remark in picture.remarks)


def test_the_user_is_told_of_frames_and_plate(tmp_path: Path) -> None:
    levels = np.round(SCENE * 255).astype(np.uint8)
    p3 = FileHandle.of(save(tmp_path / "p3.png", levels, profile(P3, SRGB_CURVE)))
    told = prepare.fn(
        frames=(p3,), background=p3, clip=Clip(), camera=CameraConfig(), exposure=ExposureConfig()
    ).remarks
    assert told.count("p3.png has the colours of a test's colours: converted to sRGB") == 1
    assert any("converted to sRGB" in remark for remark in open_footage([p3.path]).remarks)


def test_transparency_and_further_pictures_are_told(tmp_path: Path) -> None:
    levels = np.dstack([np.round(SCENE * 255), np.full(SCENE.shape[:2], 255)]).astype(np.uint8)
    Image.fromarray(levels).save(tmp_path / "full.png")
    assert decode_picture(tmp_path / "full.png").remarks == ()
    levels[:8, :, 3] = 0
    Image.fromarray(levels).save(tmp_path / "half.png")
    assert "half.png is transparent in 50 % of its area" in decode_picture(tmp_path / "half.png").remarks[0]
    Image.fromarray(levels[..., :3]).save(
        tmp_path / "a.webp", save_all=True, append_images=[Image.fromarray(levels[::-1, :, :3])], lossless=True
    )
    picture = decode_picture(tmp_path / "a.webp")
    assert picture.remarks == ("a.webp holds 2 pictures: the first one is taken",)
    assert np.array_equal(np.round(picture.pixels * 255), levels[..., :3])


def test_mattes_are_numbers(tmp_path: Path) -> None:
    levels = np.round(SCENE * 255).astype(np.uint8)
    path = with_chunks(tmp_path / "m.png", levels, {b"gAMA": struct.pack(">I", 100000)})
    assert np.abs(read_matte(path) - (levels / 255).mean(-1)).max() < 1e-6
