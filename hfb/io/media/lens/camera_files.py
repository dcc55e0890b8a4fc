"""Calibrated cameras: Pose2Sim's Calib*.toml and cameras.json.

Both follow OpenCV: x = K (R X + t) after the lens distortion k1 k2 p1 p2 (k3), or a fisheye's k1 k2 k3 k4, the centre
of the first pixel at (0, 0). Here it lies at (0.5, 0.5), so half a pixel is added to the principal point on the way out
(`pinhole`).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.placement import rows_of
from hfb.geometry.world import rotation_fault
from hfb.io.media.lens.lens import undistortion_maps
from hfb.io.media.lens.lens_documents import read_document
from hfb.io.media.lens.lens_models import checked_coefficients, is_fisheye
from hfb.typing import Array, Float


@dataclass(frozen=True)
class CalibratedCamera:
    """One camera of a calibration, in OpenCV's own pixel convention.

    Attributes:
        K: camera matrix [px].
        distortion: OpenCV's coefficients; all zero for a pinhole.
        fisheye: whether they are of OpenCV's fisheye model, which is no pinhole with zeros either.
        R_camera_world: world to camera, x = R X + t.
        t_m: world to camera, x = R X + t.
        video: the file's name, where the calibration says it.
        first_frame: the recording's number of its frame 0.
    """

    name: str
    width: int
    height: int
    K: Float[Array, "3 3"]
    distortion: Float[Array, "n"]
    R_camera_world: Float[Array, "3 3"]
    t_m: Float[Array, "3"]
    video: str | None = None
    first_frame: int = 0
    fisheye: bool = False

    @property
    def bends(self) -> bool:
        """Whether the lens distorts at all."""
        return self.fisheye or bool(self.distortion.any())

    def to_camera(self, points_m: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Transform world points to camera coordinates [m]; NaN stays NaN.

        Args:
            points_m: world [m].
        """
        return points_m @ self.R_camera_world.T + self.t_m

    def undistortion(self, left: int, top: int, width: int, height: int) -> Float[Array, "2 h w"]:
        """Return, for each pixel of a window of the pinhole's image, its position (x, y) in the stored image [px].

        Args:
            left: left edge of the window [px].
            top: top edge of the window [px].
            width: width of the window [px].
            height: height of the window [px].
        """
        shifted = self.K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
        return np.stack(undistortion_maps(self.K, self.distortion, self.fisheye, shifted, (width, height)))

    def to_stored_pixels(self, points_m: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
        """Project world points to pixels (OpenCV's convention) of the stored image, distortion included.

        NaN for unknown points and for those that are not in front of the lens.

        Args:
            points_m: world [m].
        """
        pixels = np.full((len(points_m), 2), np.nan)
        seen = self.to_camera(points_m)[:, 2] > 0.05  # False for NaN too
        if seen.any():
            R, _ = cv2.Rodrigues(self.R_camera_world)
            project = cv2.fisheye.projectPoints if self.fisheye else cv2.projectPoints
            found, _ = project(points_m[seen][:, None], R, self.t_m, self.K, self.distortion)
            pixels[seen] = found.reshape(-1, 2)
        return pixels

    def pinhole(self) -> PinholeCamera:
        """Return the camera of the undistorted image, in this project's pixel convention."""
        K = self.K
        fx, fy, cx, cy = (float(value) for value in (K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5))
        return PinholeCamera(fx, fy, cx, cy, self.height, self.width)


def read_calibration(path: Path) -> tuple[CalibratedCamera, ...]:
    """Read a Calib*.toml of Pose2Sim or a cameras.json; cameras in the file's order.

    Args:
        path: the file.

    Raises:
        InputError: missing, damaged, a distortion model that is not read, or a camera without one of its entries.
    """
    sections, read = read_document(path), _from_toml
    if path.suffix.lower() != ".toml":
        sections, read = sections.get("cameras", {}), _from_json
        if not isinstance(sections, dict):
            raise InputError(f'{path}: has no "cameras"; it must be {{"cameras": {{NAME: {{"K": ...}}}}}}.')
    sections = {name: part for name, part in sections.items() if name != "metadata"}
    if not sections:
        raise InputError(f"{path}: names no camera; give a calibration of Pose2Sim or a cameras.json.")
    return tuple(read(name, part, f"{path}: camera {name}") for name, part in sections.items())


def camera_of(cameras: tuple[CalibratedCamera, ...], video: str) -> CalibratedCamera | None:
    """Return the camera that took a video; see `number_of_camera`.

    Args:
        cameras: cameras of one calibration.
        video: file name of the video.
    """
    number = number_of_camera([(camera.name, camera.video) for camera in cameras], video)
    return None if number is None else cameras[number]


def number_of_camera(cameras: Sequence[tuple[str, str | None]], video: str) -> int | None:
    """Return the number of the camera that took a video.

    It is the one that names the video, else the one whose name the video's name starts with or contains. Names are
    compared without signs: ``cam_01`` took ``cam01_f000-059.mp4``. None where no camera or several match.

    Args:
        cameras: their names, and the videos that they name.
        video: file name of the video.
    """
    named = [number for number, (_, taken) in enumerate(cameras) if taken == video]
    if named:
        return named[0] if len(named) == 1 else None
    names = [name for name, _ in cameras]
    stem = _plain(Path(video).stem)
    fits = [number for number, name in enumerate(names) if _plain(name) and stem.startswith(_plain(name))]
    if not fits:
        words = [word for word in re.split(r"[^a-z0-9]+", Path(video).stem.lower()) if word]
        parts = [re.split(r"[^a-z0-9]+", name.lower()) for name in names]
        fits = [number for number, part in enumerate(parts) if words and words[0] in part]
    longest = max((len(_plain(names[number])) for number in fits), default=0)
    fits = [number for number in fits if len(_plain(names[number])) == longest]
    return fits[0] if len(fits) == 1 else None


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _from_toml(name: str, part: Any, where: str) -> CalibratedCamera:
    part = _table(part, where)
    width, height = _size(_numbers(part, "size", (2,), where), where)
    distortion, fisheye = _distortion(part, "distortions", where)
    return CalibratedCamera(
        str(part.get("name", name)),
        width,
        height,
        _matrix(part, "matrix", where),
        distortion,
        _rotation(part, "rotation", where),
        _vector(part, "translation", where),
        fisheye=fisheye,
    )


def _from_json(name: str, part: Any, where: str) -> CalibratedCamera:
    part = _table(part, where)
    width, height = _size(np.array([_number(part, "width", where), _number(part, "height", where)]), where)
    distortion, fisheye = _distortion(part, "dist_k1k2p1p2", where)
    first, video = part.get("first_frame", 0), part.get("video")
    if not isinstance(first, int) or isinstance(first, bool) or first < 0 or not isinstance(video, str | None):
        raise InputError(f"{where}: first_frame must be a number of 0 or more and video a file's name.")
    return CalibratedCamera(
        name,
        width,
        height,
        _matrix(part, "K", where),
        distortion,
        _rotation(part, "R_world_to_cam", where),
        _vector(part, "t_world_to_cam", where),
        video,
        first,
        fisheye,
    )


def _table(part: Any, where: str) -> dict[str, Any]:
    if not isinstance(part, dict):
        raise InputError(f"{where} is no table of entries; give matrix, distortions, rotation, translation and size.")
    return part


def _numbers(part: dict[str, Any], key: str, shape: tuple[int, ...], where: str) -> Float[Array, "..."]:
    try:
        values = np.array(part[key], dtype=np.float64)
    except (KeyError, ValueError, TypeError, OverflowError):
        raise InputError(f"{where}: {key} is missing or not numbers.") from None
    if values.shape != shape or not np.isfinite(values).all():
        raise InputError(f"{where}: {key} must be {' x '.join(map(str, shape))} finite numbers.")
    return values


def _number(part: dict[str, Any], key: str, where: str) -> float:
    return float(_numbers(part, key, (), where))


def _size(size: Float[Array, "2"], where: str) -> tuple[int, int]:
    width, height = (int(value) for value in size)
    if (width, height) != tuple(size) or not 0 < min(width, height) <= max(width, height) < 1 << 16:
        raise InputError(f"{where}: {size[0]:g} x {size[1]:g} is no picture's size.")
    return width, height


def _matrix(part: dict[str, Any], key: str, where: str) -> Float[Array, "3 3"]:
    K = _numbers(part, key, (3, 3), where)
    if K[0, 0] <= 0 or K[1, 1] <= 0 or K[0, 1] != 0 or K[1, 0] != 0 or K[2].tolist() != [0, 0, 1]:
        raise InputError(f"{where}: {key} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0.")
    return K


def _rotation(part: dict[str, Any], key: str, where: str) -> Float[Array, "3 3"]:
    """Read a matrix, as of Caliscope, or Rodrigues' vector, also as the column of older Pose2Sim."""
    value = part.get(key)
    if not isinstance(value, list) or not any(isinstance(row, list) and len(row) == 3 for row in value):
        return np.asarray(cv2.Rodrigues(_vector(part, key, where))[0], np.float64)
    R = _numbers(part, key, (3, 3), where)
    if fault := rotation_fault(rows_of(R)):
        raise InputError(f"{where}: {key} {fault}.")
    return R


def _vector(part: dict[str, Any], key: str, where: str) -> Float[Array, "3"]:
    """Read three numbers in a row, or in a column."""
    value = part.get(key)
    if isinstance(value, list) and len(value) == 3 and all(isinstance(row, list) and len(row) == 1 for row in value):
        part = {key: [row[0] for row in value]}
    return _numbers(part, key, (3,), where)


def _distortion(part: dict[str, Any], key: str, where: str) -> tuple[Float[Array, "n"], bool]:
    """Return (coefficients, whether they are a fisheye's)."""
    values = part.get(key, [0.0] * 4)
    if not isinstance(values, list):
        raise InputError(f"{where}: {key} must be 4, 5, 8, 12 or 14 numbers, as OpenCV has them.")
    if all(isinstance(one, list) and len(one) == 1 for one in values):  # a column
        values = [one[0] for one in values]
    numbers = _numbers({key: values}, key, (len(values),), where)
    fisheye = is_fisheye(part, numbers, where)
    return checked_coefficients(numbers, fisheye, f"{where}: {key}"), fisheye
