"""Scores of a fitted motion: the re-blurred image and, where it is known, the truth."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import torch

from hfb.body.model import Body, PosedBody
from hfb.datasets.truth import Truth
from hfb.evaluation.metrics import motion_errors, psnr_db, silhouette_iou, soft_iou, turned_in_time, wrong_direction
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.sampled import SampledMotion, still_motion
from hfb.motion.static_pose import FirstBody
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Bool, Float, Int, Tensor


def pose_rows(motion: SampledMotion, rows: Int[Array, "S"], body: Body) -> PosedBody:
    """Pose the body at some rows of a motion.

    Args:
        motion: camera coordinates.
        rows: numbers of rows.
        body: model of the motion.
    """
    dtype = body.template.dtype
    rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses[rows]).to(dtype).unflatten(1, (24, 3)))
    shaped = body.shape(torch.from_numpy(motion.betas).to(dtype))
    return shaped.pose(rotations, torch.from_numpy(motion.trans[rows]).to(dtype))


def reblur(
    motion: SampledMotion, texture: Float[Tensor, "A A 3"], observation: Observation, body: Body, rasterizer: Rasterizer
) -> Float[Tensor, "T H W 4"]:
    """Return the mean over the sub-frames of colour and silhouette, per frame, as the observation's camera sees it.

    Args:
        motion: camera coordinates.
        texture: linear light.
        observation: gives the camera and the number of frames.
        body: model of the motion.
        rasterizer: draws it.
    """
    with torch.no_grad():
        return torch.stack(
            [
                rasterizer.render_mean(
                    pose_rows(motion, motion.rows_of(frame), body).vertices, texture, observation.camera, body.mesh
                )
                for frame in range(observation.mattes.shape[0])
            ]
        )


def picture_scores(
    blurred: Float[Tensor, "T H W 4"], observation: Observation, region: tuple[int, int, int, int] | None = None
) -> dict[str, float]:
    """Score how well re-blurred frames explain the observed ones.

    ``matte_iou``: soft IoU of re-blurred alpha and matte. ``psnr_db``: of the sRGB images within the region of
    interest (the box of the mattes, widened), so that the size of the empty background does not count.

    Args:
        blurred: mean premultiplied colour and silhouette of every frame.
        observation: frames, plate and mattes.
        region: left, top, width and height [px]; that of the observation's mattes when not given.
    """
    left, top, width, height = region or observation.region()
    rows, columns = slice(max(top, 0), max(top + height, 0)), slice(max(left, 0), max(left + width, 0))
    predicted = observation.to_srgb(compose(blurred, observation.plate_linear))[:, rows, columns].numpy()
    seen = observation.to_srgb(observation.frames_linear)[:, rows, columns].numpy()
    alphas, mattes = blurred[..., 3].numpy(), observation.mattes.numpy()
    return {
        "matte_iou": float(np.mean([soft_iou(a, m) for a, m in zip(alphas, mattes, strict=True)])),
        "psnr_db": float(np.mean([psnr_db(p, s) for p, s in zip(predicted, seen, strict=True)])),
    }


def truth_scores(motion: SampledMotion, truth: Truth, body: Body, rasterizer: Rasterizer) -> dict[str, float]:
    """Return all motion errors [mm] and the silhouette IoU against the truth at the nearest instants.

    ``mpjpe_mm`` and ``iou`` keep the direction of time that the fit chose; ``better_mpjpe_mm`` and ``better_iou`` take
    the better of it and its reverse by MPJPE, which no single uniformly exposed image can tell apart.

    Args:
        motion: camera coordinates.
        truth: the case's truth.
        body: model of the motion.
        rasterizer: draws it.
    """
    nearest = np.abs(truth.motion.times_s[None, :] - motion.times_s[:, None]).argmin(1)
    height, width = truth.silhouettes.shape[1:]
    camera = PinholeCamera.from_matrix(torch.from_numpy(motion.K), height, width)
    silhouettes = np.zeros((len(nearest), height, width), np.float32)
    with torch.no_grad():
        for row, vertices in enumerate(pose_rows(motion, np.arange(len(nearest)), body).vertices):
            silhouettes[row] = rasterizer.silhouette_mean(vertices[None], camera, body.mesh) >= 0.5
    frames = int(motion.frame_index.max()) + 1
    true, shown = truth.motion.joints[nearest], truth.silhouettes[nearest].astype(np.float32)
    errors = asdict(motion_errors(motion.joints, true, frames))
    return errors | silhouette_scores(silhouettes, shown, wrong_direction(motion.joints, true, frames))


def silhouette_scores(
    drawn: Float[Array, "R H W"], shown: Float[Array, "R H W"], wrong: Bool[Array, "T"]
) -> dict[str, float]:
    """Return ``iou`` in the direction of time of the result, and ``better_iou`` with the wrong frames' time reversed.

    Args:
        drawn: silhouettes of the result.
        shown: true silhouettes.
        wrong: frames whose direction of time is wrong.
    """
    better = turned_in_time(drawn, wrong)
    return {"iou": silhouette_iou(drawn, shown), "better_iou": silhouette_iou(better, shown)}


def at_rest(first_bodies: Sequence[FirstBody], like: SampledMotion, body: Body) -> SampledMotion:
    """Return the start of a fit as a motion: each frame's first body, held still, on the same clock.

    Args:
        first_bodies: one per frame.
        like: motion whose clock and camera are used.
        body: model of the first bodies.
    """
    return still_motion(
        torch.stack([first.pose for first in first_bodies]),
        torch.stack([first.translation for first in first_bodies]),
        torch.stack([first.betas for first in first_bodies]).mean(0),
        like,
        body,
    )
