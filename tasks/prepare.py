"""The user's pictures: are they pictures, do they fit together, and how were they taken."""

import math

from hfb.clip import Clip
from hfb.config import CameraConfig, ExposureConfig
from hfb.errors import InputError
from hfb.media.pictures import read_picture_srgb
from tasks.handles import ClipHandle, FileHandle
from tasks.inputs import told_exposure_s
from tasks.task import task

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
    from hfb.matting.plate_doubts import doubt_plate
    from hfb.media.plate import HOLDS_PERSON, seems_to_hold_person
    from hfb.photometry import as_srgb, srgb_to_linear

    plate, doubts = as_srgb(read_picture_srgb(background.path), clip.transfer), []
    told: str | None = None
    height, width = plate.shape[:2]
    for number, frame in enumerate(frames):
        picture = as_srgb(read_picture_srgb(frame.path), clip.transfer)
        if picture.shape != plate.shape:
            other = " x ".join(map(str, picture.shape[1::-1]))
            raise InputError(
                f"{frame.path} is {other} px and the background {background.path} {width} x {height} px: "
                "give a background of the same camera at the same size"
            )
        doubts.append(seems_to_hold_person(picture, plate))
        if number == 0 or told is not None:  # what is wrong with the plate is seen in every frame
            told = doubt_plate(*(one if clip.transfer == "linear" else srgb_to_linear(one) for one in (picture, plate)))
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
        remarks=(told,) if told else (f"it seems that {HOLDS_PERSON}",) if all(doubts) else (),
    )


def calibration(
    camera: CameraConfig, clip: Clip, height: int, width: int
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """K of the full picture [px]: an option wins over clip.toml, which wins over a guess."""
    if camera.focal_px is None and clip.camera.K is not None:
        return clip.camera.K
    focal_px = camera.focal_px or clip.camera.focal_px or math.hypot(height, width)
    return (focal_px, 0.0, width / 2), (0.0, focal_px, height / 2), (0.0, 0.0, 1.0)
