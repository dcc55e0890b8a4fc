"""Somebody who crosses more than their own width: size, place and path are found where no body at rest fits."""

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.config import InitConfig
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.initializer import make_initializer
from hfb.initialization.matte_search import search_by_matte
from hfb.initialization.pose_bank import bank_rotations
from hfb.initialization.silhouette_fit import matte_level, overlap, silhouette
from hfb.initialization.swept_search import search_swept
from hfb.motion.static_pose import FirstBody
from hfb.rendering.backends import make_rasterizer
from hfb.tracking.clip_bodies import body_between

BODY, RASTERIZER = load_default_body(), make_rasterizer()
CAMERA = PinholeCamera.from_focal(420.0, 300, 420)
DEPTH_M = 3.4


def walker() -> FirstBody:
    names, poses = bank_rotations()
    upright = axis_angle_to_matrix(torch.tensor([torch.pi, 0, 0])) @ axis_angle_to_matrix(torch.tensor([0, 1.3, 0]))
    pose = torch.cat([matrix_to_axis_angle(upright)[None], poses[names.index("stride")]])
    return FirstBody(pose, torch.tensor([0.1, 0.15, DEPTH_M]), torch.zeros(10), "truth")


def crossed(first: FirstBody, travel_m: tuple[float, float, float]) -> np.ndarray:
    """The matte of a body carried along a line, at 17 instants."""
    path = torch.tensor(travel_m)
    shares = [
        silhouette(FirstBody(first.pose, first.translation + t * path, first.betas, "truth"), CAMERA, BODY, RASTERIZER)
        for t in np.linspace(-0.5, 0.5, 17).tolist()
    ]
    return torch.stack(shares).mean(0).numpy()


def test_a_path_is_found_where_no_body_at_rest_fits() -> None:
    truth = walker()
    matte = crossed(truth, (1.1, 0.0, 0.0))
    still, shared = search_by_matte(matte, CAMERA, BODY, RASTERIZER)
    found = search_swept(matte, CAMERA, BODY, RASTERIZER)
    assert shared < 0.5
    assert found.shared > 0.65
    assert abs(abs(float(found.travel_m[0])) - 1.1) < 0.35
    assert abs(float(found.first.translation[2]) - DEPTH_M) < 0.35
    assert abs(float(still.translation[2]) - DEPTH_M) > abs(float(found.first.translation[2]) - DEPTH_M)
    again = search_swept(matte, CAMERA, BODY, RASTERIZER)
    assert torch.equal(found.first.pose, again.first.pose)
    assert torch.equal(found.travel_m, again.travel_m)


def test_the_default_start_takes_it() -> None:
    matte = crossed(walker(), (1.1, 0.0, 0.0))
    frame = np.repeat(matte[..., None], 3, -1) * 0.5 + 0.2
    make = make_initializer(InitConfig(method="matte"), RASTERIZER)
    first = make(frame, np.full_like(frame, 0.2), matte, CAMERA, BODY)
    assert abs(float(first.translation[2]) - DEPTH_M) < 0.4


def test_between_neighbours_the_way_is_known() -> None:
    truth, path = walker(), torch.tensor([1.0, 0.0, 0.0])
    known = {frame: FirstBody(truth.pose, truth.translation + (frame - 1) * path, truth.betas, "x") for frame in (0, 2)}
    matte = crossed(truth, (1.0, 0.0, 0.0))
    found = body_between(1, known, matte, CAMERA, BODY, RASTERIZER)
    level = matte_level(matte, CAMERA, 64)
    assert overlap(truth, level, BODY, RASTERIZER) < 0.5
    # Five instants are lumpier than seventeen: the truth's own smear sets the scale.
    reached, truths = (overlap(one, level, BODY, RASTERIZER, path) for one in (found, truth))
    assert reached > 0.85 * truths
    assert float((found.translation - truth.translation).norm()) < 0.25
