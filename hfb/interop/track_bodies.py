"""First bodies from another system's result.

A system's camera is rarely the clip's: most assume a focal length, some of many metres. The appearance is kept: the
root appears at the same pixel and in the same size, and is turned with its view ray, since a body at the image's edge
is seen from the front by a lens far away, and a little from the side by a wide one.
"""

from dataclasses import replace

import numpy as np
import torch

from hfb.body.model import Body
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rays import between_rays
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.keypoint_registration import register_keypoints
from hfb.initialization.point_registration import register_joints
from hfb.initialization.silhouette_fit import Level, SilhouetteStage, Stay, matte_level, overlap, refine
from hfb.interop.readers.pose_track import PoseTrack
from hfb.motion.static_pose import FirstBody
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Float, Tensor

_SMPL_PELVIS_M = (-0.002, -0.23, 0.028)
"""About where SMPL's mean shape has its root joint: for its results where SMPL itself is not there."""
_SAME = 1e-6
_SHAPE_FRAMES, _CHUNK = 48, 256
_COMPARE_PX = 96
_LEAST_DEPTH_M = 0.1
_LEAST_OVERLAP = 0.02
_TURNS = 12
_STAGES = (SilhouetteStage(64, 30, 0.02, shape=False), SilhouetteStage(_COMPARE_PX, 20, 0.015, shape=False))
_STAY = Stay(pose=0.05, root=0.1, place=0.1)
_STAY_UNPLACED = Stay(pose=0.05, root=0.02)


def body_at(track: PoseTrack, frame: int, camera: PinholeCamera, body: Body) -> FirstBody | None:
    """Return the first body of a frame; None where the system saw nobody.

    The translation is NaN where the system gives no camera: see `on_matte`.

    Args:
        track: with poses (`with_poses`).
        frame: its number.
        camera: camera of the clip.
        body: the model that is fitted; betas count only where they are this model's.

    Raises:
        InputError: too little is known of the body.
    """
    row = np.flatnonzero(track.frames == frame)
    if not row.size:
        return None
    one = track.rows(row[:1])
    pose, pelvis, betas = _standing(one, body)
    if one.K is None:
        place = torch.full((3,), torch.nan)
    else:
        theirs = PinholeCamera.from_matrix(torch.from_numpy(one.K[0]), camera.height, camera.width)
        pose, pelvis = _before_camera(pose, pelvis, theirs, camera)
        place = pelvis - _rest_pelvis(body, betas)
    return FirstBody(pose.float(), place.float(), betas.float(), track.system)


def with_poses(track: PoseTrack, body: Body) -> PoseTrack:
    """Fit the body to the joints of a system that gives no poses; its shape by some frames, then held.

    Args:
        track: with joints or poses.
        body: the model that is fitted.

    Raises:
        InputError: too few joints are known.
    """
    if track.poses is not None:
        return track
    if track.pixels is not None:
        return _with_seen_poses(track, track.pixels, body)
    if track.joints is None:
        raise InputError(f"the {track.system} result has neither poses nor joints")
    some = np.unique(np.linspace(0, len(track) - 1, min(len(track), _SHAPE_FRAMES)).round().astype(int))
    betas = register_joints(track.joints[some], body).betas
    parts = [register_joints(track.joints[at : at + _CHUNK], body, betas) for at in range(0, len(track), _CHUNK)]
    places = torch.cat([part.translations for part in parts]).double() + _rest_pelvis(body, betas)
    return replace(
        track,
        poses=torch.cat([part.poses for part in parts]).double().numpy(),
        betas=betas.double().numpy()[None].repeat(len(track), 0),
        betas_space=body.betas_space,
        pelvis=places.numpy(),
        joints=None,
    )


def _with_seen_poses(track: PoseTrack, pixels: Float[Array, "R 24 2"], body: Body) -> PoseTrack:
    """Fit the mean person to the visible joints, before the camera that the track assumes."""
    if track.K is None or track.size is None:
        raise InputError(f"the {track.system} result has keypoints without a camera")
    camera = PinholeCamera.from_matrix(torch.from_numpy(track.K[0]), *track.size)
    parts = [register_keypoints(pixels[at : at + _CHUNK], camera, body) for at in range(0, len(track), _CHUNK)]
    places = torch.cat([part.translations for part in parts]).double() + _rest_pelvis(body, parts[0].betas)
    return replace(
        track, poses=torch.cat([part.poses for part in parts]).double().numpy(), pelvis=places.numpy(), pixels=None
    )


def on_matte(
    first: FirstBody,
    turn_is_known: bool,
    matte: Float[Array, "H W"],
    camera: PinholeCamera,
    body: Body,
    rasterizer: Rasterizer,
) -> FirstBody:
    """Fit the body to the matte while keeping its pose near; keep the result only where its overlap is larger.

    A body without a position gets one first, by the matte's height and middle; where its turn is unknown, too, twelve
    are tried.

    Args:
        first: body to start from.
        turn_is_known: whether the root's rotation about the vertical is known.
        matte: matte of the frame, in [0, 1].
        camera: camera of the frame.
        body: the model that is fitted.
        rasterizer: draws silhouettes.

    Raises:
        InputError: the matte is empty, or the body stands elsewhere.
    """
    level = matte_level(matte, camera, _COMPARE_PX)
    unplaced = bool(first.translation.isnan().any())
    if unplaced:
        turns = range(1 if turn_is_known else _TURNS)
        tries = [_placed(_yawed(first, 2 * np.pi * turn / _TURNS), level, body) for turn in turns]
        first = max(tries, key=lambda one: overlap(one, level, body, rasterizer))
    closer = refine(first, matte, camera, body, rasterizer, _STAGES, _STAY_UNPLACED if unplaced else _STAY)
    shares = {overlap(one, level, body, rasterizer): one for one in (first, closer)}  # the refined one of equals
    if max(shares) < _LEAST_OVERLAP:
        raise InputError(
            f"the {first.source} result has the body where the picture shows nobody: another frame (--init.frame), "
            "another person (--init.person), or a result for other pictures"
        )
    return shares[max(shares)]


def share_on_matte(track: PoseTrack, frame: int, matte: Float[Array, "H W"], body: Body) -> float:
    """Return the mean of a matte at a person's projected joints, which identifies the person of the matte.

    It is 0 where the system has no row for that frame, or no camera.

    Args:
        track: with poses or joints.
        frame: the system's number of the matte's image.
        matte: matte of the frame, in [0, 1].
        body: model that gives the joints of poses.
    """
    row = np.flatnonzero(track.frames == frame)
    if not row.size or track.K is None:
        return 0.0
    camera = PinholeCamera.from_matrix(torch.from_numpy(track.K[row[0]]), *matte.shape)
    if track.pixels is None:
        seen = camera.project(_joints_at(track, int(row[0]), camera, body))
    else:
        seen = torch.from_numpy(track.pixels[row[0]])
    pixels = seen[torch.isfinite(seen).all(-1)].floor().long()
    inside = ((pixels >= 0) & (pixels < torch.tensor(matte.shape[::-1]))).all(-1)
    columns, rows = pixels[inside].numpy().T
    return float(matte[rows, columns].sum() / max(1, len(pixels)))


def _joints_at(track: PoseTrack, row: int, camera: PinholeCamera, body: Body) -> Float[Tensor, "n 3"]:
    """Return the joints in front of the system's own camera [m]."""
    if track.poses is None:
        joints = torch.from_numpy(track.joints[row]) if track.joints is not None else torch.zeros(0, 3)
    else:
        first = body_at(track, int(track.frames[row]), camera, body)
        if first is None:
            return torch.zeros(0, 3)
        turns = axis_angle_to_matrix(first.pose)[None].to(body.template.dtype)
        shaped = body.shape(first.betas.to(turns))
        joints = shaped.joints_of(turns, first.translation[None].to(turns))[0]
    return joints[joints[:, 2] > _LEAST_DEPTH_M]  # NaN is not


def _standing(one: PoseTrack, body: Body) -> tuple[Tensor, Tensor, Tensor]:
    """Pose, place of the root joint and betas, in the system's own frame; double precision."""
    if one.poses is None:
        raise InputError(f"the {one.system} result has no poses")
    pose = torch.from_numpy(one.poses[0])
    same = one.betas is not None and one.betas_space == body.betas_space
    betas = torch.from_numpy(one.betas[0]) if same and one.betas is not None else pose.new_zeros(body.shape_count)
    if one.pelvis is not None:
        return pose, torch.from_numpy(one.pelvis[0]), betas
    if one.trans is None:
        return pose, pose.new_zeros(3), betas
    rest = _rest_pelvis(body, betas) if same else pose.new_tensor(_SMPL_PELVIS_M)
    return pose, torch.from_numpy(one.trans[0]) + rest, betas


def _rest_pelvis(body: Body, betas: Float[Tensor, "K"]) -> Float[Tensor, "3"]:
    return body.joint_template[0].double() + body.joint_shape_directions[0].double() @ betas.double()


def _before_camera(
    pose: Float[Tensor, "24 3"], pelvis: Float[Tensor, "3"], theirs: PinholeCamera, ours: PinholeCamera
) -> tuple[Float[Tensor, "24 3"], Float[Tensor, "3"]]:
    """Return the position with the same appearance before our camera."""
    if float(pelvis[2]) <= 0:
        raise InputError("the result has a body behind its camera")
    if all(abs(getattr(theirs, name) / getattr(ours, name) - 1) < _SAME for name in ("fx", "fy", "cx", "cy")):
        return pose, pelvis
    pixel = theirs.project(pelvis)
    depth = pelvis[2] * (ours.fx + ours.fy) / (theirs.fx + theirs.fy)
    place = ours.unproject(pixel, depth)
    root = between_rays(pelvis, place) @ axis_angle_to_matrix(pose[0])
    return torch.cat([matrix_to_axis_angle(root)[None], pose[1:]]), place


def _yawed(first: FirstBody, angle: float) -> FirstBody:
    """Turn the body about the vertical."""
    turn = axis_angle_to_matrix(first.pose.new_tensor([0.0, angle, 0.0]))
    root = matrix_to_axis_angle(turn @ axis_angle_to_matrix(first.pose[0]))
    return replace(first, pose=torch.cat([root[None], first.pose[1:]]))


def _placed(first: FirstBody, level: Level, body: Body) -> FirstBody:
    """Move the body so that its silhouette's box is the matte's: height by the depth, middle by x and y."""
    shaped = body.shape(first.betas.to(body.template.dtype))
    turns = axis_angle_to_matrix(first.pose.to(body.template.dtype))[None]
    points = shaped.pose(turns, turns.new_zeros(1, 3)).vertices[0]
    low, high = points.amin(0), points.amax(0)
    rows, columns = (torch.nonzero((level.matte > 0.3).any(axis)).flatten() for axis in (1, 0))
    if not len(rows):
        raise InputError("the matte is empty: no person differs from the background; check the plate")
    top, bottom = float(rows[0]), float(rows[-1]) + 1
    depth = level.camera.fy * (high[1] - low[1]) / max(1.0, bottom - top)
    middle = torch.tensor([(float(columns[0]) + float(columns[-1]) + 1) / 2, (top + bottom) / 2])
    place = level.camera.unproject(middle.to(depth), depth) - torch.cat([(low + high)[:2] / 2, points.mean(0)[2:]])
    return replace(first, translation=place.float())
