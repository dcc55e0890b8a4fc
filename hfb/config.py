"""Every option of a run, as frozen records; nothing else influences a result.

Light to import (pydantic only): the command line builds its flags from these records.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

_log = logging.getLogger(__name__)

RENAMED_FIT_OPTIONS: Mapping[str, str] = {
    "across": "xy_weight",
    "several": "multi_frame",
    "at_once": "batch_size",
    "size_moves_away": "keep_image_size",
    "root_kick": "initial_root_velocity",
}
"""Earlier names of options of `FitConfig`; files, flags and recorded runs may still use them."""


def current_option_name(name: str) -> str:
    """Return the current name of a dotted option such as ``fit.several.image``.

    Args:
        name: dotted, by an earlier or the present name.
    """
    first, *rest = name.split(".")
    if first == "fit" and rest:
        rest[0] = RENAMED_FIT_OPTIONS.get(rest[0], rest[0])
    return ".".join([first, *rest])


def _in_order(schema: dict[str, Any]) -> None:
    """Number a record's fields in the order of definition, in which forms show them."""
    for position, field in enumerate(schema.get("properties", {}).values()):
        field["position"] = position


class Record(BaseModel):
    """A frozen record that refuses unknown keys, so that a typo is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", json_schema_extra=_in_order)


HeightM = Annotated[float, Field(ge=1.4, le=2.4)]
"""A person's height [m]. Body models know grown people: at 1.2 m the embedded one is a caricature, no child."""


def within(least: float, most: float) -> AfterValidator:
    """Refuse values that no camera has, such as 1e300, since products of such numbers overflow.

    Args:
        least: smallest value.
        most: largest value.
    """

    def check(value: float) -> float:
        if not least <= value <= most:
            raise ValueError(f"must lie between {least:g} and {most:g}")
        return value

    return AfterValidator(check)


FramesPerS = Annotated[float, Field(gt=0), within(1e-4, 1e6)]
ExposureSeconds = Annotated[float, Field(gt=0), within(1e-8, 1e4)]
ReadoutSeconds = Annotated[float, within(0, 1)]
ReadoutTo = Literal["down", "up", "left", "right"]
FocalPx = Annotated[float, Field(gt=0), within(1, 1e7)]
TiltDeg = Annotated[float, within(-89, 89)]
RollDeg = Annotated[float, within(-180, 180)]
WorldUp = Literal["z", "-z", "y", "-y"]


def _plane(value: Any) -> Any:
    """Return the plane n . X = d of four numbers with n of length one; words other than `estimate` are such numbers."""
    if value is None or value == "estimate":
        return value
    try:
        numbers = [float(one) for one in (value.split(",") if isinstance(value, str) else value)]
        length = math.hypot(*numbers[:3])
        if len(numbers) == 4 and 1e-6 < length < 1e6 and abs(numbers[3]) <= _FARTHEST_FLOOR_M * length:
            return tuple(one / length for one in numbers)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError("must be estimate, or a plane's normal and height [m] as four numbers, such as 0,0,1,0")


_FARTHEST_FLOOR_M = 100
Plane = Annotated[tuple[float, float, float, float], BeforeValidator(_plane)]
"""The points X with n . X = d [m], as (n, d) with n of length one."""
Floor = Annotated[Literal["estimate"] | tuple[float, float, float, float], BeforeValidator(_plane)]


class BodyConfig(Record):
    """The body model."""

    model: Path | None = Field(None, description="a SMPL .npz or .pkl file; the embedded body when not given")


class CameraConfig(Record):
    """The pinhole camera; a calibration in clip.toml has priority over the guess."""

    focal_px: FocalPx | None = Field(
        None, description="focal length [px], such as 1180; the picture's diagonal when not given"
    )
    tilt_deg: TiltDeg | None = Field(
        None, description="for exports: degrees by which the camera looks down; wins over a calibration's pose"
    )
    roll_deg: RollDeg | None = Field(
        None, description="for exports: degrees by which what stands upright leans to the right in the picture"
    )
    world_up: WorldUp | None = Field(
        None, description="axis of the calibration's world that points up; z when not given"
    )
    floor: Floor | None = Field(
        None,
        description="height 0 of exports: from standing feet, or the plane n . X = d [m], below which no foot sinks, "
        "in the calibration's world where there is one, else in camera coordinates (x right, y down, z ahead)",
    )


class ExposureConfig(Record):
    """The exposure's timing. Seconds scale the result's times; ratios matter to the fit of several frames."""

    seconds: ExposureSeconds | None = Field(
        None, description="exposure time [s], such as 0.02 for 1/50 s; the whole frame interval when not given"
    )
    fps: FramesPerS | None = Field(None, description="frames per second, such as 29.97; 30 where nothing says it")
    light: Literal["linear", "srgb"] = Field(
        "linear", description="the light in which blur is an average; real cameras average linear light"
    )
    readout_s: ReadoutSeconds | None = Field(
        None, description="rolling shutter: from the first row's exposure to the last row's [s]; 0 when not given"
    )
    readout_to: ReadoutTo | None = Field(
        None, description="where the last row lies in the picture as shown; down when not given"
    )


class MattingConfig(Record):
    """The matting method."""

    method: Literal["network", "known-background", "bgmv2", "rvm"] = Field(
        "network",
        description="network: our own, trained on drawn blur; known-background: colour and texture alone; bgmv2: "
        "BackgroundMattingV2; rvm: Robust Video Matting, which sees no plate",
    )
    weights: Path | None = Field(None, description="the released file of bgmv2 (TorchScript, weights, ONNX) or rvm")
    backbone_scale: float | None = Field(
        None, gt=0, le=0.5, description="bgmv2: size of its first pass; 480 px on the longer side when not given"
    )
    refine_mode: Literal["sampling", "thresholding", "full"] | None = Field(
        None, description="bgmv2: which pixels are refined; the file's own choice when not given"
    )
    refine_pixels: int | None = Field(
        None, ge=16, description="bgmv2: how many pixels sampling refines; 80000 at HD, 320000 at 4K when not given"
    )
    refine_threshold: float | None = Field(None, ge=0, le=1, description="bgmv2: error above which are refined")
    tile_px: int | None = Field(
        None, ge=256, description="bgmv2, rvm: look at tiles of this size; at most 4096 px at once when not given"
    )
    half: bool = Field(
        False, description="bgmv2, rvm: compute in 16 bits (bfloat16), in about 0.6 times the memory; not for ONNX"
    )

    @model_validator(mode="after")
    def _leaves_an_onnx_file_its_own(self) -> MattingConfig:
        if self.weights is None or self.weights.suffix.lower() != ".onnx":
            return self
        fixed = ("backbone_scale", "refine_mode", "refine_pixels", "refine_threshold")
        options = [name for name in fixed if getattr(self, name) is not None] + ["half"] * self.half
        if options:
            flags = ", ".join(f"--matting.{name.replace('_', '-')}" for name in options)
            raise ValueError(f"{flags}: an ONNX file has its own, fixed; leave them out, or give the TorchScript file")
        return self


OWN_NETWORKS = ("metro", "keypoints")
"""Ways to a first body by a network of the user's."""


class InitConfig(Record):
    """The initialisation."""

    method: Literal["auto", "mediapipe", "matte", "metro", "keypoints", "file"] = Field(
        "auto",
        description="auto: the pose networks where `hfb models` fetched them, else the matte alone; metro, "
        "keypoints (RTMPose, RTMW, ViTPose): a network of yours; file: another system's result",
    )
    landmarks: Literal["auto", "heavy", "full"] = Field(
        "auto", description="MediaPipe's landmark network; auto: the medians of all that were fetched"
    )
    weights: Path | None = Field(None, description="metro: its TorchScript or ONNX file; keypoints: its ONNX file")
    mesh_sampling: Path | None = Field(
        None, description="metro: its mesh_downsampling.npz, for a network that gives a coarse mesh alone"
    )
    file: Path | None = Field(
        None,
        description="file: a result of PyMAF, HybrIK, PHALP / 4D-Humans, WHAM, TRAM, GVHMR, SAM 3D Body, NLF, AMASS, "
        "hfb, 3D joints or 2D keypoints",
    )
    person: str | None = Field(None, description="file: whom of several, by the system's own name or number")
    frame: int | None = Field(None, ge=0, description="file: number of the first picture in the result, from 0 on")


class Weights(Record):
    """Weights of eq. (11), in the paper's order. The paper does not publish its own."""

    image: float = Field(1.0, ge=0, description="w_I, image formation")
    matte: float = Field(1.0, ge=0, description="w_alpha, matting")
    texture: float = Field(0.0, ge=0, description="w_S, surface texture smoothness")
    pose: float = Field(0.0, ge=0, description="w_P, pose prior")
    shape: float = Field(0.0, ge=0, description="w_beta, shape")
    motion: float = Field(0.0, ge=0, description="w_C, polynomial coefficients")
    background: float = Field(0.0, ge=0, description="w_B, background")
    adversarial: float = Field(0.0, ge=0, description="w_A, adversarial motion prior; in single frames only")
    boundary: float = Field(1.0, ge=0, description="continuity between neighbouring frames")
    start: float = Field(0.0, ge=0, description="distance of the middle pose from the first body's, not in the paper")
    joints: float = Field(0.0, ge=0, description="distance from where our joint network sees the joints at u = 1/2")
    path: float = Field(0.0, ge=0, description="distance from the path our joint network sees; in single frames only")
    height: float = Field(0.0, ge=0, description="distance from the height our joint network sees in proportions")


class Stage(Record):
    """A stretch of iterations at one image size."""

    size_px: int = Field(ge=16, description="longer side of the region of interest [px]")
    iterations: int = Field(ge=0)
    learning_rate: float = Field(0.01, gt=0)
    cosine: bool = Field(False, description="let the learning rate fall to a twentieth along a half cosine")


class MultiFrame(Record):
    """Factors where several frames share one texture; that of a single frame can explain anything."""

    iterations: float = Field(1.0, gt=0, le=100, description="factor of the iterations of every stage")
    learning_rate: float = Field(1.0, gt=0, description="factor of the learning rate of every stage")
    image: float = Field(1.0, ge=0, description="factor of w_I in the stages of full size, when the texture is known")
    height: float = Field(1.0, ge=0, description="factor of the height's weight")


class DirectionsConfig(Record):
    """The search for the directions in which the body and its limbs moved, after the fit."""

    search: bool = Field(False, description="weigh reversed motions, keep the likeliest, say how sure it is")
    limbs: bool = Field(True, description="each limb by itself too, not the whole body alone")
    size_px: int = Field(64, ge=16, description="longer side of the region of interest while weighing [px]")
    refits: int = Field(4, ge=0, description="how many of the likeliest reversed motions are refitted")
    iterations: int = Field(8, ge=0, description="of each refit")
    polish: int = Field(15, ge=0, description="at the last stage's picture size, of a winner that was refitted")


class FitConfig(Record):
    """The optimisation."""

    subframes: int = Field(8, ge=2, le=64, description="N, sub-frames per exposure; fewer in stages of small images")
    degree: int = Field(2, ge=1, le=6, description="d, degree of the motion polynomials")
    rotation: Literal["quaternion", "axis-angle"] = Field("quaternion", description="the 4 dof of a rotation")
    silhouette: Literal["coverage", "dibr"] = Field("coverage", description="exact pixel share, or DIB-R's soft mask")
    dibr_sharpness: float = Field(
        1.0, gt=0, le=100, description="how many times narrower DIB-R's halo is than with its public constants"
    )
    rasterizer: Literal["cpu", "reference", "cuda", "warp"] = Field(
        "cpu",
        description="cpu: numba; reference: readable torch; cuda: the fit on a GPU; warp: the same on the processor",
    )
    batch_size: int = Field(
        32, ge=1, le=1024, description="cuda: windows of a clip that are fitted together; fewer take less of its memory"
    )
    texture_px: int = Field(128, ge=8, le=4096, description="side of the texture [px]")
    weights: Weights = Weights()
    multi_frame: MultiFrame = MultiFrame()
    motion_shared: bool = Field(
        False, description="divide w_C by the number of frames: where neighbours meet they bound the motion, too"
    )
    patience: int = Field(
        0, ge=0, description="a stage ends after so many iterations that gain less than a thousandth; 0: never"
    )
    stages: tuple[Stage, ...] = (Stage(size_px=256, iterations=200),)
    directions: DirectionsConfig = DirectionsConfig()
    both_fronts: bool = Field(
        False, description="where it is doubtful which way the person faces, fit both and keep the likelier"
    )
    matte_scales: int = Field(1, ge=1, le=8, description="scales at which mattes are compared, each half the last")
    image_scales: int = Field(1, ge=1, le=8, description="scales at which pictures are compared, each half the last")
    settle: int = Field(0, ge=0, description="iterations of the warm-up: the skeleton alone, towards predicted joints")
    lifting: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the lifting network in the joint network's depth, after every stage but the last; 0 from "
        "a pose network's start",
    )
    xy_weight: float = Field(
        1.0,
        ge=0,
        le=1,
        description="factor of the joint evidence across the view in the image stages: outlines show that, but not "
        "depth",
    )
    compare: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of what the joint network sees to differ between the picture and the fit's own, before "
        "every stage of the last one's size but a first; 0 from a pose network's start",
    )
    fuse_depth: bool = Field(
        False,
        description="wherever that difference is looked at, depth is what the fusion network makes of it, of both "
        "networks' words and of the fit",
    )
    matte_again: bool = Field(
        False, description="find the mattes again, the fit's own picture in sight, before every such stage"
    )
    height_m: HeightM | None = Field(
        None,
        description="how tall the person is, soles to crown [m], such as 1.78; no picture shows it, and every length "
        "hangs on it",
    )
    keep_height: bool = Field(
        False,
        description="where no height is told, keep that of a first body that a pose network saw: clothed people look "
        "stout, which a fit takes for short",
    )
    keep_image_size: bool = Field(False, description="a change of shape keeps the size in the image; quaternions only")
    origin: float = Field(0.0, ge=0, le=1, description="time u at which the motion's constants hold the first body")
    shape_rate: float = Field(3.0, gt=0, description="learning rate of the betas, times the stage's")
    texture_rate: float = Field(1.0, gt=0, description="learning rate of the texture, times the stage's")
    adam_epsilon: float = Field(1e-8, gt=0, description="Adam's epsilon; larger holds what the picture does not show")
    initial_root_velocity: float = Field(
        0.0, ge=0, description="start velocity of the root [m per exposure]: at rest is a saddle point"
    )
    threads: int = Field(1, ge=1, description="threads of one fit; the result does not depend on it")

    @model_validator(mode="before")
    @classmethod
    def _read_old_names(cls, content: Any) -> Any:
        if not isinstance(content, Mapping):
            return content
        options = dict(content)
        for old in RENAMED_FIT_OPTIONS.keys() & options.keys():
            new = RENAMED_FIT_OPTIONS[old]
            if new in options:
                raise ValueError(f"{old} and {new} are the same option; leave out {old}, its old name")
            options[new] = options.pop(old)
            _log.warning("the option fit.%s is now called fit.%s; use the new name", old, new)
        return options


class PriorConfig(Record):
    """The pose prior."""

    pose: Path | None = Field(
        None, description="SMPLify's GMM, a VPoser checkpoint or one of hfb train-prior; built in when not given"
    )
    kind: Literal["anatomy", "mixture"] = Field(
        "anatomy", description="the built-in pose prior: joint limits with one natural pose, or with a mixture"
    )
    motion: Path | None = Field(None, description="a motion prior of hfb train-prior; built in when not given")


class VideoConfig(Record):
    """The fit of a whole clip in windows that are joined."""

    window: int = Field(4, ge=2, le=5, description="frames fitted jointly; neighbouring windows share one")
    average: int = Field(1, ge=1, description="of footage that is sharp, average this many frames in linear light")
    person_windows: int = Field(3, ge=1, description="pairs of frames, over the clip, that settle shape and texture")
    key_every: int = Field(4, ge=1, description="frames from one full search of a first body to the next")
    longest_fill: int = Field(8, ge=0, description="frames in a row without a first body that neighbours stand in for")
    settle: int = Field(20, ge=0, description="iterations of the skeleton alone, in every window")
    stages: tuple[Stage, ...] = (Stage(size_px=64, iterations=15), Stage(size_px=128, iterations=20, cosine=True))


MotionFormat = Literal["amass", "glb", "bvh", "csv", "trc", "c3d", "usd", "fbx", "abc"]
MeshFormat = Literal["obj", "ply"]
Film = Literal["slowmotion", "exact", "overlay"]


def _words(value: Any) -> Any:
    """Split ``glb,bvh`` into a list of words; ``none`` is an empty one."""
    if not isinstance(value, str):
        return value
    return [] if value.strip() in ("", "none") else [word.strip() for word in value.split(",")]


CsvFrame = Literal["camera", "world"]
AmassRate = Annotated[Literal[30, 60, 120], BeforeValidator(lambda it: int(it) if str(it).isdecimal() else it)]


class ExportConfig(Record):
    """Exported files for other programs, beside motion.npz."""

    formats: Annotated[tuple[MotionFormat, ...], BeforeValidator(_words)] = Field(
        ("amass", "glb", "bvh", "csv", "trc"),
        description="motion files, such as glb,bvh: amass, glb, bvh, csv, trc, c3d and usd (with the extras c3d and "
        "usd), fbx and abc (both need Blender), or none",
    )
    amass_rate: AmassRate = Field(120, description="poses per second in amass.npz")
    csv_frame: CsvFrame = Field("camera", description="coordinates in joints.csv; the other files are in the world")
    fps: float = Field(24.0, ge=1, le=1000, description="of the program that opens motion.glb: keys lie on its frames")
    films: Annotated[tuple[Film, ...], BeforeValidator(_words)] = Field(
        ("slowmotion", "overlay"),
        description="videos: slowmotion, exact (one picture per sub-frame, at its true time), overlay, or none",
    )
    report: bool = Field(True, description="report.html: the result on one page that opens anywhere")


class RunConfig(Record):
    """All options of one command besides its files."""

    preset: Literal["paper", "best"] = Field("best", description="paper: the faithful method; best: what measured best")
    seed: int = Field(0, ge=0)
    body: BodyConfig = BodyConfig()
    camera: CameraConfig = CameraConfig()
    exposure: ExposureConfig = ExposureConfig()
    matting: MattingConfig = MattingConfig()
    init: InitConfig = InitConfig()
    prior: PriorConfig = PriorConfig()
    fit: FitConfig = FitConfig()
    video: VideoConfig = VideoConfig()
    export: ExportConfig = ExportConfig()


_PAPER = FitConfig(
    degree=2,
    rotation="axis-angle",
    silhouette="dibr",
    dibr_sharpness=10.0,  # the halo of 1 makes limbs two pixels wider at 256 px
    origin=0.0,
    stages=(Stage(size_px=256, iterations=200, learning_rate=0.01),),
    shape_rate=1.0,
    weights=Weights(
        image=1, matte=1, texture=0.1, pose=0.003, shape=0.001, motion=0.01, background=0.01, adversarial=2, boundary=1
    ),
)
_BEST = FitConfig(
    degree=3,  # as many coefficients as a frame's two ends have values and velocities
    origin=0.5,  # a static estimate of a blurred person is nearest to the middle of the motion
    initial_root_velocity=0.1,
    adam_epsilon=1e-4,
    stages=(
        Stage(size_px=64, iterations=30, learning_rate=0.03),
        Stage(size_px=128, iterations=20, learning_rate=0.02),
        Stage(size_px=256, iterations=10, learning_rate=0.012),  # before each of these two the evidence is refined
        Stage(size_px=256, iterations=25, cosine=True),
    ),
    matte_scales=5,  # a displaced limb shares no edge with its image: coarse pixels reach further
    image_scales=3,
    directions=DirectionsConfig(search=True, refits=2, iterations=5),
    both_fronts=True,
    settle=80,
    lifting=0.75,
    xy_weight=0.2,
    compare=0.75,
    fuse_depth=True,
    keep_height=True,
    keep_image_size=True,
    motion_shared=True,
    multi_frame=MultiFrame(image=33, height=3, iterations=1.5, learning_rate=0.6),
    matte_again=True,
    weights=Weights(
        image=30, matte=14, pose=0.014, shape=0.002, motion=0.1, boundary=5, start=0.2, joints=3, path=0.4, height=0.04
    ),
)


def preset(name: Literal["paper", "best"]) -> RunConfig:
    """Return all options of a preset: ``paper`` is the faithful method, ``best`` the one with the best results.

    Args:
        name: name of the preset.
    """
    return RunConfig(preset=name, fit=_PAPER if name == "paper" else _BEST)
