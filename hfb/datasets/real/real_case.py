"""Cases of b-aist and real: K consecutive frames of a real video become one blurred frame of a longer exposure."""

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.config import InitConfig
from hfb.datasets.case import Case, load_case
from hfb.datasets.real.case_windows import RealWindow, choose, real_windows
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.real.sharp_frames import Exposure, expose
from hfb.datasets.real.shutter import Shutter
from hfb.datasets.real.source_videos import Footage
from hfb.datasets.real.true_joints import (
    SeenJoints,
    SharpEstimates,
    all_points,
    measured_joints,
    pixels_of,
    share_inside,
)
from hfb.datasets.real.truth_source import TRUTH_SOURCES, truth_kind, truth_offsets_mm
from hfb.datasets.real.view import Box, View, box_of_change, box_of_joints, make_view
from hfb.datasets.set_spec import listing_of
from hfb.datasets.synthetic.sharp import save_sharp
from hfb.datasets.truth import JointTruth, save_joint_truth
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.initializer import make_initializer
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_io import write_matte, write_png
from hfb.io.media.lens.camera_files import CalibratedCamera
from hfb.io.media.lens.camera_pose import FARTHEST_M
from hfb.photometry import linear_to_srgb
from hfb.rendering.backends import make_rasterizer
from hfb.typing import Array, Float


def make_numbered_real_case(spec: RealSpec, number: int, folder: Path) -> Case:
    """Make case `number` (from 1) of the set: the windows in the order of `choose` with the set's own seed.

    Args:
        spec: specification of the set.
        number: number of the case, from 1.
        folder: written to.

    Raises:
        InputError: there are fewer windows, or no case can be made from this one.
    """
    order = _order(spec, listing_of(*spec.videos))
    if not 1 <= number <= len(order):
        folders = ", ".join(str(folder) for folder in spec.videos)
        raise InputError(f"{folders}: {len(order)} windows in all, there is no case {number}; ask for fewer.")
    return make_real_case(spec, number, order[number - 1], folder)


def make_real_case(spec: RealSpec, number: int, window: RealWindow, folder: Path) -> Case:
    """Write all files of one case but the starts: these come from the real estimators, from the blurred frames.

    The truth holds the joints at the middle of every sharp frame's exposure; shutter.py says how these instants lie
    on the clock of a fit. Mattes and cut-outs come from the default matting of the sharp frames: pseudo truths.

    Args:
        spec: specification of the set.
        number: number of the case, from 1.
        window: a window of a video.
        folder: written to.

    Raises:
        InputError: nobody moves in the window, or the files have changed since it was found.
    """
    recording, footage = window.recording, window.recording.footage()
    shutter = Shutter(window.average, spec.frames, footage.fps)
    plate = recording.stored_plate()
    calibrated = recording.camera()
    full = _full_camera(footage, calibrated, plate.shape[0], plate.shape[1])
    seen, view, boxes = _look(spec, window, footage, calibrated, full)
    small_plate = view.see(plate)
    estimates, on_frame = None, None
    if seen is None:
        initializer = make_initializer(InitConfig(method=spec.estimator), make_rasterizer("coverage", threads=1))
        estimates = SharpEstimates(initializer, load_default_body(), small_plate, view.camera)
        on_frame = estimates.add
    exposures = expose(view, small_plate, window.first, shutter, boxes, on_frame)
    joints = estimates.joints() if estimates else seen
    assert joints is not None
    sharp = _write_pictures(folder, exposures, small_plate)
    _write_truth(folder / "truth.npz", joints, shutter)
    write_bytes_atomic(folder / "clip.toml", _clip_toml(view.camera, calibrated, shutter).encode())
    facts = _facts(spec, number, window, view, shutter, exposures, joints) | {"sharp": sharp}
    write_bytes_atomic(folder / "case.json", json.dumps(facts, indent=2, allow_nan=False).encode())
    return load_case(folder)


def _look(
    spec: RealSpec, window: RealWindow, footage: Footage, calibrated: CalibratedCamera | None, full: PinholeCamera
) -> tuple[SeenJoints | None, View, list[Box] | None]:
    """Return the measured joints (if any), the view of the person, and the person's possible region in each frame."""
    count = window.average * spec.frames
    markers = window.recording.markers()
    if markers is None or calibrated is None:
        box, body = box_of_change(window.recording, footage, window.first, count)
        return None, make_view(footage, box, full, calibrated, spec.size_px, body), None
    row = window.recording.row_of(window.first)
    every = all_points(markers, calibrated, row, count)
    view = make_view(footage, box_of_joints(pixels_of(every, full)), full, calibrated, spec.size_px)
    pixels = pixels_of(every, view.camera)
    whole = box_of_joints(pixels)
    boxes = [box_of_joints(one) if np.isfinite(one).all() else whole for one in pixels]
    kind = truth_kind(markers, window.recording.camera_count())
    return measured_joints(markers, calibrated, row, count, kind), view, boxes


def _full_camera(footage: Footage, calibrated: CalibratedCamera | None, height: int, width: int) -> PinholeCamera:
    """Return the undistorted full image's camera: calibrated, else clip.toml's, else the guess of a user's run."""
    if calibrated is not None:
        return calibrated.pinhole()
    given = footage.clip.camera
    if given.K is not None:
        return PinholeCamera.from_matrix(torch.tensor(given.K, dtype=torch.float64), height, width)
    return PinholeCamera.from_focal(given.focal_px or math.hypot(height, width), height, width)


def _camera_source(footage: Footage, calibrated: CalibratedCamera | None) -> str:
    if calibrated is not None:
        return "calibration"
    return "clip.toml" if footage.clip.camera.has_lens else "assumed"


def _write_pictures(folder: Path, exposures: list[Exposure], plate: Float[Array, "H W 3"]) -> list[list[int]]:
    """Write frames, their sharp middles, mattes, cut-outs and the plate; return the boxes of the cut-outs."""
    folder.mkdir(parents=True, exist_ok=True)
    boxes = []
    for index, exposure in enumerate(exposures):
        write_png(folder / f"frame_{index}.png", linear_to_srgb(exposure.mean))
        write_png(folder / f"middle_{index}.png", linear_to_srgb(exposure.middle))
        write_matte(folder / f"matte_{index}.png", exposure.matte)
        boxes.append(save_sharp(folder / f"sharp_{index}.png", exposure.cutouts))
    write_png(folder / "background.png", linear_to_srgb(plate))
    return boxes


def _write_truth(path: Path, joints: SeenJoints, shutter: Shutter) -> None:
    times_s, frame_index = shutter.instants()
    save_joint_truth(
        path,
        JointTruth(
            joints=joints.joints,
            smpl_joints=np.array(joints.smpl_joints),
            times_s=times_s,
            frame_index=frame_index,
            names=joints.names,
        ),
    )


def _clip_toml(camera: PinholeCamera, calibrated: CalibratedCamera | None, shutter: Shutter) -> str:
    pose = ""
    if calibrated is not None and 0 < np.linalg.norm(calibrated.t_m) <= FARTHEST_M:
        pose = f"rotation = {calibrated.R_camera_world.tolist()}\ntranslation = {calibrated.t_m.tolist()}\n"
    return (
        f"# The mean of {shutter.average} frames of a video in linear light.\n"
        f"[camera]\nK = {camera.matrix().tolist()}\n{pose}\n"
        f"[exposure]\nfps = {1 / shutter.interval_s!r}\nseconds = {shutter.exposure_s!r}\n"
    )


def _facts(
    spec: RealSpec,
    number: int,
    window: RealWindow,
    view: View,
    shutter: Shutter,
    exposures: list[Exposure],
    joints: SeenJoints,
) -> dict[str, Any]:
    """Return the content of case.json: the origin of the case and the reliability of its truth."""
    recording, footage = window.recording, view.footage
    rates = [exposure.blur_rate() for exposure in exposures]
    calibrated = recording.camera()
    inside = share_inside(
        pixels_of(joints.joints, view.camera), np.concatenate([exposure.masks for exposure in exposures])
    )
    remarks = list(window.remarks)
    measured = joints.source in TRUTH_SOURCES
    if measured:
        remarks.append(
            f"the truth is {TRUTH_SOURCES[joints.source]}: hips and shoulders lie 20 to 50 mm from SMPL's own; "
            f"compared are {', '.join(joints.names)}"
        )
    else:
        remarks.append(f"pseudo truth: {joints.source} on the sharp frames, with errors of its own")
    if not footage.fps_known:
        remarks.append(f"no frame rate is given: {footage.fps:g} frames per second assumed")
    return {
        "number": number,
        "set": spec.set,
        "frames": shutter.frames,
        "blur_rate": sum(rates) / len(rates),
        "blur_rates": rates,
        "source": f"{footage.stem}@{window.first}",
        "recording": window.place,
        "video": window.video,
        "first_frame": window.first,
        "average": shutter.average,
        "fps": footage.fps,
        "exposure_s": shutter.exposure_s,
        "interval_s": shutter.interval_s,
        "light": "linear",
        "spec": spec.model_dump(mode="json", exclude={"videos", "average"}),
        "truth": joints.source if measured else "estimator",
        "truth_source": TRUTH_SOURCES[joints.source] if measured else joints.source,
        "truth_joints": list(joints.names),
        "truth_offset_mm": truth_offsets_mm(joints.smpl_joints) if measured else {},
        "matte": "mean of the sharp frames' own mattes",
        "plate": "given" if recording.plate else "median",
        "joints_inside_matte": inside,
        "joint_shift_frames": recording.shift,
        "joints_known": float(np.isfinite(joints.joints).all(-1).mean()),
        "camera": {
            "height": view.camera.height,
            "width": view.camera.width,
            "K": view.camera.matrix().tolist(),
            "source": _camera_source(footage, calibrated),
        },
        "crop": [view.left, view.top, view.width, view.height],
        "remarks": remarks,
    }


@lru_cache(maxsize=2)
def _order(spec: RealSpec, listing: str) -> tuple[RealWindow, ...]:
    """Return the set's windows in their order; cached per process while the files are unchanged."""
    windows, _ = real_windows(spec)
    return tuple(choose(windows, len(windows), spec.seed))
