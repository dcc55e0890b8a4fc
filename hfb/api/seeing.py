"""`hfb.load_body`, `hfb.render`, `hfb.compose` and `hfb.evaluate`: a motion as images and as figures."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from hfb.api.given_images import path_of
from hfb.api.result import Result
from hfb.body.assets import load_body as load_any_body
from hfb.body.model import Body
from hfb.errors import InputError
from hfb.evaluation.metrics import motion_errors
from hfb.evaluation.protocol import pose_rows
from hfb.geometry.camera import PinholeCamera
from hfb.motion.motion_file import load_motion
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose as compose_tensors
from hfb.typing import Array, Float, Int


def load_body(model: str | Path | None = None) -> Body:
    """Load a body model.

    Args:
        model: a SMPL .npz or .pkl file, whose code is not run; None for the embedded body.

    Raises:
        InputError: the file is missing, damaged, or not SMPL.
    """
    return load_any_body(path_of(model) if model is not None else None)


def render(
    result: Result, rows: Int[Array, "n"] | slice | None = None, size: tuple[int, int] | None = None
) -> Float[Array, "n H W 4"]:
    """Draw the body at some rows of a motion, as the camera saw it.

    The mean over the rows of a frame is what an exposure averages; `compose` lays it over the plate.

    Args:
        result: the motion with its body and texture.
        rows: numbers of rows; all when not given.
        size: height and width [px] of an image that the result's K belongs to; that of its mattes when not given.

    Returns:
        premultiplied colour in linear light, and the silhouette in [0, 1].

    Raises:
        InputError: the result has no mattes and no size is given.
    """
    height, width = size or result.mattes.shape[1:]
    if height * width == 0:
        raise InputError("this result has no mattes that tell the images' size: give size=(height, width)")
    camera = PinholeCamera.from_matrix(torch.from_numpy(result.motion.K), height, width)
    chosen = np.arange(len(result.poses))[slice(None) if rows is None else rows]
    texture = torch.from_numpy(np.asarray(result.texture_linear, np.float32))
    with torch.no_grad():
        vertices = pose_rows(result.motion, chosen, result.body).vertices
        return make_rasterizer().render(vertices, texture, camera, result.body.mesh).numpy()


def compose(foreground: Float[Array, "*t H W c"], plate_linear: Float[Array, "h w 3"]) -> Float[Array, "*t H W 3"]:
    """Lay rendered images over a plate, eq. (1): (1 - alpha) B + F, in linear light.

    Args:
        foreground: premultiplied colour and silhouette (..., H, W, 4), of one instant or the mean over an exposure.
        plate_linear: (H, W, 3), linear light.

    Raises:
        InputError: the shapes do not match.
    """
    if foreground.shape[-1:] != (4,) or foreground.shape[-3:-1] != plate_linear.shape[:2]:
        raise InputError(
            f"{foreground.shape} does not lie over a plate of {plate_linear.shape}: give (..., H, W, 4) and (H, W, 3)"
        )
    return compose_tensors(torch.as_tensor(foreground), torch.as_tensor(plate_linear)).numpy()


def evaluate(result: Result, truth: Result | str | Path | Array) -> dict[str, float]:
    """Compare a motion with the truth; see `hfb.evaluation.metrics.MotionErrors` for the figures [mm].

    Args:
        result: the motion.
        truth: another result, a motion.npz or truth.npz (compared at the nearest instants), or
            joints (R, 24, 3) [m].

    Raises:
        InputError: the truth is damaged, or has other rows.
    """
    if isinstance(truth, np.ndarray):
        joints = truth
    else:
        motion = truth.motion if isinstance(truth, Result) else load_motion(path_of(truth))[0]
        nearest = np.abs(motion.times_s[None] - result.times_s[:, None]).argmin(1)
        joints = motion.joints[nearest]
    if joints.shape != result.joints.shape or not np.isfinite(joints).all():
        raise InputError(f"the true joints are {joints.shape} and the result's {result.joints.shape}: give finite ones")
    return asdict(motion_errors(result.joints, joints.astype(np.float64), int(result.frame_index.max()) + 1))
