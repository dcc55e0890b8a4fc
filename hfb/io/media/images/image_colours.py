"""Conversion of colours to sRGB by what an image file states.

Colours given by a curve per channel and a matrix (Display P3, Adobe RGB, ProPhoto, a PNG's gamma and primaries) are
converted exactly, also with 16 bits. Profiles that are tables (of printers and scanners) are converted by littleCMS,
with 8 bits.
"""

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageCms

from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.typing import Array, Float, Shaped

Curve = Callable[[Float[Array, "n"]], Float[Array, "n"]]

_PROFILE_LIMIT = 4 << 20
_SAME = 0.75 / 255
_BAND = 256
_D50, _D65 = (0.3457, 0.3585), (0.3127, 0.3290)
_SRGB = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
_ADOBE = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
_PRIMARIES = {  # ITU-T H.273
    1: (_SRGB, _D65),
    5: (((0.64, 0.33), (0.29, 0.60), (0.15, 0.06)), _D65),
    6: (((0.63, 0.34), (0.31, 0.595), (0.155, 0.07)), _D65),
    9: (((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)), _D65),
    11: (((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)), (0.314, 0.351)),
    12: (((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)), _D65),
}
_PRIMARY_NAMES = {9: "BT.2020", 11: "DCI-P3", 12: "Display P3"}
_HDR = {16: "PQ", 18: "HLG"}
_AS_SRGB = (1, 2, 6, 13, 14, 15)  # players show BT.709's and its kin with sRGB's curve, near enough
_USUAL_GAMMA, _GAMMA_TOLERANCE = 1 / 2.2, 0.005
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


@dataclass(frozen=True, eq=False)
class Colours:
    """A colour space by a curve per channel and a matrix.

    Attributes:
        name: for people.
        curves: stored values in [0, 1] to linear light, one for each channel.
        to_srgb: linear light to that of sRGB's primaries.
    """

    name: str
    curves: tuple[Curve, Curve, Curve]
    to_srgb: Float[Array, "3 3"]

    def is_srgb(self) -> bool:
        """Return whether converting changes no level of 8 bits."""
        steps = np.linspace(0, 1, 18)
        some = np.stack([*np.meshgrid(steps, steps, steps)], -1).reshape(-1, 3)
        rows = np.concatenate([np.repeat(steps[:, None], 3, 1), some[some.min(-1) > 0.2]])
        linear = np.stack([curve(rows[:, channel]) for channel, curve in enumerate(self.curves)], -1)
        return float(np.abs(linear_to_srgb((linear @ self.to_srgb.T).clip(0, 1)) - rows).max()) < _SAME

    def converted(self, levels: Shaped[Array, "H W 3"], full: int) -> Float[Array, "H W 3"]:
        """Convert levels to sRGB in [0, 1]; colours outside its gamut are clipped.

        Args:
            levels: as stored.
            full: highest level.
        """
        grid = np.arange(full + 1) / full
        tables = [curve(grid).astype(np.float32) for curve in self.curves]
        matrix = self.to_srgb.T.astype(np.float32)
        picture = np.empty(levels.shape, np.float32)
        for top in range(0, len(levels), _BAND):
            band = levels[top : top + _BAND]
            linear = np.stack([table[np.minimum(band[..., c], full)] for c, table in enumerate(tables)], -1)
            picture[top : top + _BAND] = linear_to_srgb((linear @ matrix).clip(0, 1))
        return picture


class UnreadableProfile(ValueError):
    """A colour profile that is damaged, or no matrix and curves."""


def of_profile(profile: bytes) -> Colours:
    """Read an ICC profile of RGB or gray that consists of curves and a matrix.

    Args:
        profile: ICC profile.

    Raises:
        UnreadableProfile: it is something else, or damaged.
    """
    try:
        tags = _profile_tags(profile)
        space = profile[16:20]
        if space == b"GRAY":
            curve = _icc_curve(tags[b"kTRC"])
            return Colours(_profile_name(profile), (curve, curve, curve), np.eye(3))
        if space != b"RGB " or profile[20:24] != b"XYZ ":
            raise UnreadableProfile("no matrix and curves")
        red, green, blue = (_icc_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC"))
        columns = [struct.unpack_from(">3i", tags[name], 8) for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
        to_xyz = np.array(columns).T / 65536
        # The profile's white is D50, adapted from whatever the device's is.
        matrix = np.linalg.inv(_to_xyz_d50(_SRGB, _D65)) @ to_xyz
        if not np.isfinite(matrix).all() or np.abs(matrix).max() > 100:
            raise UnreadableProfile("a senseless matrix")
        return Colours(_profile_name(profile), (red, green, blue), matrix)
    except (struct.error, KeyError, IndexError, np.linalg.LinAlgError, OverflowError) as error:
        raise UnreadableProfile("damaged") from error


def of_png(chunks: dict[bytes, bytes]) -> Colours | str | None:
    """Read a PNG's cICP, or gAMA and cHRM.

    Args:
        chunks: by `png_chunks`.

    Returns:
        the colours; the name of a high dynamic range; None where the chunks say nothing, or sRGB.
    """
    told = chunks.get(b"cICP", b"")
    if len(told) == 4:
        primaries, transfer = told[0], told[1]
        if transfer in _HDR:
            return _HDR[transfer]
        curve = _curve_of(transfer)
        if curve is None or primaries not in _PRIMARIES:
            return None
        name = _PRIMARY_NAMES.get(primaries, f"cICP {primaries}-{transfer}")
        return Colours(name, (curve, curve, curve), _to_srgb(*_PRIMARIES[primaries]))
    if b"sRGB" in chunks:
        return None
    gamma, places = chunks.get(b"gAMA", b""), chunks.get(b"cHRM", b"")
    curve, matrix, names = srgb_to_linear, np.eye(3), list[str]()
    power = struct.unpack(">I", gamma)[0] / 1e5 if len(gamma) == 4 else _USUAL_GAMMA
    if abs(power - _USUAL_GAMMA) > _GAMMA_TOLERANCE and 0.1 < power < 10:
        curve, names = _power(1 / power), [f"gAMA {power:.5g}"]
    if len(places) == 32:
        x = np.array(struct.unpack(">8I", places)).reshape(4, 2) / 1e5
        try:
            matrix = _to_srgb(tuple(map(tuple, x[1:])), tuple(x[0]))
        except np.linalg.LinAlgError:
            matrix = np.eye(3)
        if np.isfinite(matrix).all() and np.abs(matrix - np.eye(3)).max() > 0.01:
            names.append("cHRM")
        else:
            matrix = np.eye(3)
    return Colours(" and ".join(names), (curve, curve, curve), matrix) if names else None


def adobe_rgb() -> Colours:
    """Return the colours of photographs that name them by DCF's interoperability index alone."""
    curve = _power(563 / 256)
    return Colours("Adobe RGB", (curve, curve, curve), _to_srgb(_ADOBE, _D65))


def converted_by_tables(image: Image.Image, profile: bytes) -> Image.Image:
    """Convert an image of 8 bits, also CMYK, to sRGB.

    Args:
        image: as stored.
        profile: ICC profile.

    Raises:
        UnreadableProfile: it is damaged, or another image's.
    """
    try:
        source, target = ImageCms.ImageCmsProfile(io.BytesIO(profile)), ImageCms.createProfile("sRGB")
        intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
        found = ImageCms.profileToProfile(image, source, target, renderingIntent=intent, outputMode="RGB")
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as error:
        raise UnreadableProfile("not for these pixels") from error
    assert found is not None
    return found


def png_chunks(data: bytes) -> dict[bytes, bytes]:
    """Return the small chunks of a PNG before its pixels.

    Args:
        data: content of the file.
    """
    chunks: dict[bytes, bytes] = {}
    at = 8
    while at + 12 <= len(data) and len(chunks) < 100:
        size, kind = struct.unpack_from(">I4s", data, at)
        if kind == b"IDAT" or at + 12 + size > len(data):
            break
        if size <= 64:
            chunks[kind] = data[at + 8 : at + 8 + size]
        at += 12 + size
    return chunks


def _profile_tags(profile: bytes) -> dict[bytes, bytes]:
    if len(profile) > _PROFILE_LIMIT or profile[36:40] != b"acsp":
        raise UnreadableProfile("damaged")
    (count,) = struct.unpack_from(">I", profile, 128)
    entries = (struct.unpack_from(">4sII", profile, 132 + 12 * number) for number in range(min(count, 100)))
    return {name: profile[start : start + size] for name, start, size in entries}


def _profile_name(profile: bytes) -> str:
    try:
        text: Any = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return "its colour profile"
    return " ".join(str(text).split())[:60] or "its colour profile"


def _icc_curve(tag: bytes) -> Curve:
    """Parse a `curv` or `para` tag."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return _power(1.0)
        if count == 1:
            return _power(struct.unpack_from(">H", tag, 12)[0] / 256)
        table = np.frombuffer(tag, ">u2", count, 12) / 65535
        return lambda x: np.interp(x, np.linspace(0, 1, count), table)
    if tag[:4] != b"para":
        raise UnreadableProfile("an unknown curve")
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind > 4:
        raise UnreadableProfile("an unknown curve")
    values = [one / 65536 for one in struct.unpack_from(f">{(1, 3, 4, 5, 7)[kind]}i", tag, 12)]
    g, a, b = (values + [1.0, 0.0])[:3] if kind == 0 else values[:3]
    c, d, e, f = 0.0, -np.inf, 0.0, 0.0
    if kind in (1, 2):
        d = -b / a
        c, e, f = (0.0, 0.0, 0.0) if kind == 1 else (0.0, values[3], values[3])
    elif kind == 3:
        c, d = values[3:5]
    elif kind == 4:
        c, d, e, f = values[3:7]
    return lambda x: np.where(x >= d, np.maximum(a * x + b, 0) ** g + e, c * x + f)


def _curve_of(transfer: int) -> Curve | None:
    """Return the curve of an ITU-T H.273 number; None where it is sRGB's, or unknown."""
    powers = {4: 2.2, 5: 2.8, 8: 1.0}
    return srgb_to_linear if transfer in _AS_SRGB else _power(powers[transfer]) if transfer in powers else None


def _power(exponent: float) -> Curve:
    return lambda x: np.asarray(x) ** exponent


_Place = tuple[float, float]


def _to_srgb(primaries: tuple[_Place, ...], white: _Place) -> Float[Array, "3 3"]:
    return np.linalg.inv(_to_xyz_d50(_SRGB, _D65)) @ _to_xyz_d50(primaries, white)


def _to_xyz_d50(primaries: tuple[_Place, ...], white: _Place) -> Float[Array, "3 3"]:
    """Return the matrix from linear RGB to XYZ, its white adapted to D50 by Bradford's method."""
    columns = np.stack([_xyz(place) for place in primaries], -1)
    own = columns * np.linalg.solve(columns, _xyz(white))
    seen, wanted = _BRADFORD @ _xyz(white), _BRADFORD @ _xyz(_D50)
    return np.linalg.inv(_BRADFORD) @ np.diag(wanted / seen) @ _BRADFORD @ own


def _xyz(place: _Place) -> Float[Array, "3"]:
    x, y = place
    if y <= 0:
        raise np.linalg.LinAlgError("a colour without light")
    return np.array([x / y, 1.0, (1 - x - y) / y])
