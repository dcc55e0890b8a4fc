"""Companion files of a video: plate, camera and measured joints; found by name, checked against the frames."""

import re
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from hfb.datasets.real.markers import Markers, body_columns, read_joints_npz, read_trc
from hfb.datasets.real.source_videos import Footage, open_footage
from hfb.errors import InputError
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.lens.camera_files import CalibratedCamera, camera_of, read_calibration
from hfb.io.media.plate_colours import COMPARED_FRAMES, in_colours_of
from hfb.io.media.video.video_reading import median_plate
from hfb.typing import Array, Bool, Float

_PLATE = re.compile(r"(.+)_plate\.(png|jpg|jpeg|tif|tiff)", re.IGNORECASE)
_PLATE_FRAMES = 41
_PICTURE_BYTES = 1 << 29


@dataclass(frozen=True)
class Recording:
    """A video and its companion files. Paths only, so that it can be sent between processes.

    Attributes:
        video: the video file, or the first of its numbered images.
        plate: the image of the empty scene; None for the temporal median.
        calibration: Calib*.toml or cameras.json that has the video's camera; None without one.
        joints: .trc or joints3d.npz; None without measured joints.
        y_up: whether the .trc has y up where the calibration's world has z up.
        shift: number of rows by which the joints lag behind the calibration's frames (see inspection.py).
    """

    video: Path
    plate: Path | None = None
    calibration: Path | None = None
    joints: Path | None = None
    y_up: bool = False
    shift: int = 0

    def footage(self) -> Footage:
        """Open the video."""
        return _footage(self.video)

    def camera(self) -> CalibratedCamera | None:
        """Read the calibrated camera; None where there is none."""
        return camera_of(read_calibration(self.calibration), self.video.name) if self.calibration else None

    def markers(self) -> Markers | None:
        """Read the measured joints in the calibration's world."""
        if self.joints is None:
            return None
        read = read_trc(self.joints) if self.joints.suffix.lower() == ".trc" else read_joints_npz(self.joints)
        return read.turned() if self.y_up else read

    def camera_count(self) -> int:
        """Return the number of cameras in the calibration."""
        return len(read_calibration(self.calibration)) if self.calibration else 0

    def row_of(self, frame: int) -> int:
        """Return the number of a frame of the video on the joints' clock.

        Args:
            frame: number in the video.
        """
        camera = self.camera()
        return frame + self.shift + (camera.first_frame if camera else 0)

    def stored_plate(self) -> Float[Array, "H W 3"]:
        """Read the clean background as the video stores images, in [0, 1], as distorted as its frames."""
        return _in_video_colours(self.plate, self.video) if self.plate else _median(self.video)


def find_recording(footage: Footage) -> tuple[Recording, list[str]]:
    """Find the files that belong to a video by their names; return them and a sentence per problem.

    The search covers the video's folder, and beside it the folders `calibration` and `pose-3d` of a Pose2Sim project.
    Of several .trc files the filtered one is used; its vertical axis is determined later.

    Args:
        footage: the video.

    Raises:
        InputError: a calibration or a joint file that cannot be read, or an image size that is not the video's.
    """
    folder, remarks = footage.path.parent, list(footage.remarks)
    recording = Recording(footage.path, find_plate(footage))
    places = [folder, folder.parent / "calibration"]
    for path in [path for place in places for path in _matching(place, ("cameras.json", "Calib*.toml"))]:
        if camera_of(read_calibration(path), footage.path.name) is not None:
            recording = replace(recording, calibration=path)
            break
    joints = _matching(folder, (f"{footage.stem}_joints3d.npz", "joints3d.npz"))
    joints += sorted(
        [path for place in (folder, folder.parent / "pose-3d") for path in _matching(place, ("*.trc",))],
        key=lambda path: "filt" not in path.name.lower(),
    )
    if joints and recording.calibration is None:
        remarks.append(f"{joints[0].name} is not used: no calibration names the camera of {footage.path.name}")
    elif joints:
        recording = replace(recording, joints=joints[0])
    else:
        remarks += [f"{path.name} is not read: export it as .trc" for path in _matching(folder, ("*.c3d",))]
    _check_sizes(recording, footage)
    _check_markers(recording, footage)
    return recording, remarks


def find_plate(footage: Footage) -> Path | None:
    """Return ``<name>_plate.png`` with the longest name that the video's begins with, else ``plate.png``, else None.

    Args:
        footage: the video.
    """
    found: list[tuple[int, Path]] = []
    for path in _matching(footage.path.parent, ("*",)):
        named = _PLATE.fullmatch(path.name)
        if named and footage.stem.startswith(named[1]):
            found.append((len(named[1]), path))
    if found:
        return max(found)[1]
    plain = footage.path.parent / "plate.png"
    return plain if plain.is_file() else None


def _matching(folder: Path, patterns: tuple[str, ...]) -> list[Path]:
    """Return files of one folder in the order of the patterns, then of their names."""
    if not folder.is_dir():
        return []
    return [path for pattern in patterns for path in sorted(folder.glob(pattern)) if path.is_file()]


def _check_sizes(recording: Recording, footage: Footage) -> None:
    height, width = next(footage.stored_frames(0, 1)).shape[:2]
    if recording.plate is not None:
        found = read_picture_srgb(recording.plate).shape[:2]
        if found != (height, width):
            raise InputError(
                f"{recording.plate}: has {found[1]} x {found[0]} px and the video {width} x {height} px; "
                "give a plate of the same camera at the same size."
            )
    camera = recording.camera()
    if camera is not None and (camera.height, camera.width) != (height, width):
        raise InputError(
            f"{recording.calibration}: camera {camera.name} has {camera.width} x {camera.height} px and "
            f"{footage.path.name} {width} x {height} px; give the calibration of this video."
        )


def _check_markers(recording: Recording, footage: Footage) -> None:
    markers = recording.markers()
    if markers is None:
        return
    if len(body_columns(markers.names)[1]) < 6:
        raise InputError(
            f"{recording.joints}: names fewer than 6 joints that SMPL has ({', '.join(markers.names[:8])}); "
            "name them RHip, LKnee, RAnkle, LShoulder, RElbow, LWrist and so on."
        )
    if markers.rate_hz is not None and abs(markers.rate_hz / footage.fps - 1) > 0.01:
        raise InputError(
            f"{recording.joints}: has {markers.rate_hz:g} rows per second and {footage.path.name} {footage.fps:g} "
            "frames; export the joints at the video's rate."
        )


def changed(picture: Float[Array, "H W 3"], plate: Float[Array, "H W 3"]) -> Bool[Array, "H W"]:
    """Return where a stored image clearly differs from the stored plate: coarse, for checks only.

    Args:
        picture: as stored in [0, 1].
        plate: as stored in [0, 1].
    """
    difference = np.abs(picture - plate).max(-1)
    usual = float(np.median(difference))
    return np.asarray(cv2.blur(difference, (3, 3)) > max(0.06, 3 * usual))


@lru_cache(maxsize=32)
def _footage(video: Path) -> Footage:
    return open_footage(video)


@lru_cache(maxsize=1)
def _in_video_colours(plate: Path, video: Path) -> Float[Array, "H W 3"]:
    """Return a plate from an image, in the colours of the video's frames."""
    stored, footage = read_picture_srgb(plate), _footage(video)
    if footage.pictures or footage.clip.transfer != "srgb":
        return stored
    chosen = np.linspace(0, footage.count - 1, COMPARED_FRAMES + 2).round().astype(int)[1:-1].tolist()
    return in_colours_of(stored, [next(footage.stored_frames(number, number + 1)) for number in chosen])[0]


@lru_cache(maxsize=1)
def _median(video: Path) -> Float[Array, "H W 3"]:
    """Return the median over frames spread over the video, of the stored values, which is that of the light, too."""
    footage = _footage(video)
    count = min(_PLATE_FRAMES, footage.count - 1 + footage.count % 2)  # odd: the median is one of the values
    chosen = sorted({int(index) for index in np.linspace(0, footage.count - 1, count).round()})
    if not footage.pictures:
        return median_plate(video, chosen)
    size = next(footage.stored_frames(0, 1)).nbytes
    chosen = chosen[:: -(-len(chosen) * size // _PICTURE_BYTES) or 1]
    stack = [next(footage.stored_frames(index, index + 1)) for index in chosen]
    return np.asarray(np.median(np.stack(stack), axis=0), np.float32)
