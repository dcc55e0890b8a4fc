"""Check and read the user's images: whether they fit together, and how they were taken."""

import math
from pathlib import Path

from hfb.config import CameraConfig, ExposureConfig
from hfb.errors import InputError
from hfb.geometry.placement import with_floor
from hfb.io.clip import Clip
from hfb.io.media.images.image_decoding import doubt_depths
from hfb.io.media.lens.camera_pose import clip_world
from hfb.io.media.lens.clip_lens import check_pinhole
from hfb.matting.exposure_match import NO_GAIN, frame_gain, in_plate_exposure
from hfb.photometry import Transfer, as_srgb, linear_to_srgb, srgb_to_linear
from hfb.tasks.core.handles import ClipHandle, FileHandle, FrameHandle
from hfb.tasks.core.scene import Light, decode_once
from hfb.tasks.inputs.inputs import find_exposure_s, find_readout
from hfb.tasks.task import task
from hfb.typing import Array, Float

_DEFAULT_FPS = 30.0


@task("pictures")
def prepare(
    *,
    frames: tuple[FileHandle, ...],
    background: FileHandle,
    clip: Clip,
    camera: CameraConfig,
    exposure: ExposureConfig,
) -> ClipHandle:
    """Check frames and plate against each other, and determine camera and times.

    An option overrides clip.toml, which overrides a default.

    Args:
        frames: blurred images of one camera.
        background: the same view without the person.
        clip: content of clip.toml.
        camera: options of the camera.
        exposure: options of the exposure.

    Raises:
        InputError: a file is no image, or its size is not the plate's.
    """
    from hfb.io.media.plate import HOLDS_PERSON, seems_to_hold_person
    from hfb.matting.plate_check import find_plate_mismatch, plate_distance_px, tell_distances, tell_exposures

    images = _Images(clip.transfer, exposure.light)
    plate, plate_linear = images.read(background)
    with_person: list[bool] = []
    matched: list[FrameHandle] = []
    told: str | None = None
    apart_px: list[float] = []
    height, width = plate.shape[:2]
    for number, frame in enumerate(frames):
        image, image_linear = images.read(frame)
        if image.shape != plate.shape:
            other = " x ".join(map(str, image.shape[1::-1]))
            raise InputError(
                f"{frame.path} is {other} px and the background {background.path} {width} x {height} px: "
                "give a background of the same camera at the same size"
            )
        gain = frame_gain(image_linear, plate_linear)
        matched.append(FrameHandle(**frame.model_dump(include=set(FileHandle.model_fields)), gain=gain))
        if gain != NO_GAIN:
            image_linear = in_plate_exposure(image_linear, plate_linear, gain)
            image = image_linear if clip.transfer == "linear" else linear_to_srgb(image_linear)
        with_person.append(seems_to_hold_person(image, plate))
        if number == 0 or told is not None:  # what is wrong with the plate is seen in every frame
            told = find_plate_mismatch(image_linear, plate_linear)
        if number or told is not None:  # else the first frame was found to lie on the plate
            apart_px.append(plate_distance_px(image_linear, plate_linear))
    told = told or tell_distances(apart_px) or tell_exposures([one.gain for one in matched])
    doubts = (told,) if told else (f"it seems that {HOLDS_PERSON}",) if all(with_person) else ()
    interval_s = 1 / (exposure.fps or clip.exposure.fps or _DEFAULT_FPS)
    exposure_s = find_exposure_s(frames[0].path, clip.exposure, exposure, interval_s) or interval_s
    if len(frames) > 1 and exposure_s > interval_s * 1.001:
        raise InputError(
            f"an exposure of {exposure_s:g} s does not fit into the {interval_s:g} s between frames: "
            "give the true fps or exposure time"
        )
    K = calibration(camera, clip, height, width)
    return ClipHandle(
        frames=tuple(matched),
        background=background,
        height=height,
        width=width,
        K=K,
        exposure_s=exposure_s,
        interval_s=interval_s,
        transfer=clip.transfer,
        light=exposure.light,
        remarks=(*images.remarks(), *check_pinhole(K, height, width), *doubts),
        plate_remarks=doubts,
        world=with_floor(clip_world(camera, clip.camera, frames[0].path.name), camera.floor or clip.camera.floor),
        readout=find_readout(clip.exposure, exposure),
    )


class _Images:
    """Reads the user's images one after another and collects remarks on them."""

    def __init__(self, transfer: Transfer, light: Light) -> None:
        self._transfer: Transfer = transfer
        self._light: Light = light
        self._told: list[str] = []
        self._depths: list[tuple[Path, int | None]] = []

    def read(self, file: FileHandle) -> tuple[Float[Array, "H W 3"], Float[Array, "H W 3"]]:
        """Return an image encoded as sRGB (one of linear light as stored), and its linear light.

        Args:
            file: the image.
        """
        found, image = decode_once(file, self._transfer, self._light)
        self._told += found.remarks
        self._depths.append((file.path, found.seems_bits))
        stored = as_srgb(found.pixels, self._transfer)
        if self._light == "linear":
            return stored, image.numpy()
        return stored, stored if self._transfer == "linear" else srgb_to_linear(stored)

    def remarks(self) -> tuple[str, ...]:
        """Return the remarks, after a check of the images' bit depths."""
        told = (*self._told, *doubt_depths(self._depths, self._transfer))
        return tuple(dict.fromkeys(told))


def calibration(
    camera: CameraConfig, clip: Clip, height: int, width: int
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """Return K of the full image [px]: an option overrides clip.toml, which overrides a default.

    Args:
        camera: options of the camera.
        clip: content of clip.toml.
        height: of the image [px].
        width: of the image [px].
    """
    if camera.focal_px is None and clip.camera.K is not None:
        return clip.camera.K
    focal_px = camera.focal_px or clip.camera.focal_px or math.hypot(height, width)
    return (focal_px, 0.0, width / 2), (0.0, focal_px, height / 2), (0.0, 0.0, 1.0)
