"""The user's pictures: are they pictures, do they fit together, and how were they taken."""

import math
from pathlib import Path

from hfb.config import CameraConfig, ExposureConfig
from hfb.errors import InputError
from hfb.io.clip import Clip
from hfb.io.media.picture_decoding import decode_picture, doubt_depths
from hfb.photometry import Transfer, as_srgb
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.core.task import task
from hfb.tasks.inputs.inputs import told_exposure_s
from hfb.typing import Array, Float

_DEFAULT_FPS = 30.0


@task("pictures")
def prepare(
    frames: tuple[FileHandle, ...], background: FileHandle, clip: Clip, camera: CameraConfig, exposure: ExposureConfig
) -> ClipHandle:
    """Check frames and plate against each other, and settle camera and clock.

    What an option says wins over clip.toml, which wins over a guess.

    Raises:
        InputError: a file is no picture, or its size is not the plate's.
    """
    from hfb.io.media.plate import HOLDS_PERSON, seems_to_hold_person
    from hfb.matting.plate_doubts import doubt_plate
    from hfb.photometry import srgb_to_linear

    pictures = _Pictures(clip.transfer)
    plate, doubts = pictures.read(background), []
    told: str | None = None
    height, width = plate.shape[:2]
    for number, frame in enumerate(frames):
        picture = pictures.read(frame)
        if picture.shape != plate.shape:
            other = " x ".join(map(str, picture.shape[1::-1]))
            raise InputError(
                f"{frame.path} is {other} px and the background {background.path} {width} x {height} px: "
                "give a background of the same camera at the same size"
            )
        doubts.append(seems_to_hold_person(picture, plate))
        if number == 0 or told is not None:  # what is wrong with the plate is seen in every frame
            told = doubt_plate(*(one if clip.transfer == "linear" else srgb_to_linear(one) for one in (picture, plate)))
    remarks = pictures.remarks()
    interval_s = 1 / (exposure.fps or clip.exposure.fps or _DEFAULT_FPS)
    exposure_s = told_exposure_s(frames[0].path, clip.exposure, exposure, interval_s) or interval_s
    if len(frames) > 1 and exposure_s > interval_s * 1.001:
        raise InputError(
            f"an exposure of {exposure_s:g} s does not fit into the {interval_s:g} s between frames: "
            "give the true fps or exposure time"
        )
    return ClipHandle(
        frames=frames,
        background=background,
        height=height,
        width=width,
        K=calibration(camera, clip, height, width),
        exposure_s=exposure_s,
        interval_s=interval_s,
        transfer=clip.transfer,
        light=exposure.light,
        remarks=(*remarks, *((told,) if told else (f"it seems that {HOLDS_PERSON}",) if all(doubts) else ())),
    )


class _Pictures:
    """Reads the user's pictures one after another and keeps what is to be said of them."""

    def __init__(self, transfer: Transfer) -> None:
        self._transfer: Transfer = transfer
        self._told: list[str] = []
        self._depths: list[tuple[Path, int | None]] = []

    def read(self, file: FileHandle) -> Float[Array, "H W 3"]:
        """The picture as it is stored in light, encoded as sRGB."""
        found = decode_picture(file.path, self._transfer)
        self._told += found.remarks
        self._depths.append((file.path, found.seems_bits))
        return as_srgb(found.pixels, self._transfer)

    def remarks(self) -> tuple[str, ...]:
        """Raises InputError where all of them seem to be of fewer bits than their files are."""
        told = (*self._told, *doubt_depths(self._depths, self._transfer))
        return tuple(dict.fromkeys(told))


def calibration(
    camera: CameraConfig, clip: Clip, height: int, width: int
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """K of the full picture [px]: an option wins over clip.toml, which wins over a guess."""
    if camera.focal_px is None and clip.camera.K is not None:
        return clip.camera.K
    focal_px = camera.focal_px or clip.camera.focal_px or math.hypot(height, width)
    return (focal_px, 0.0, width / 2), (0.0, focal_px, height / 2), (0.0, 0.0, 1.0)
