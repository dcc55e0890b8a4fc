"""The window's units are about what is seen, the network's claims about where the joints are."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import MIRROR
from hfb.errors import InputError
from hfb.evidence.joint_evidence import JointEvidence, predict_joint_evidence
from hfb.evidence.joint_network import CHANNELS, PICTURE_PX, JointNetwork, Window, picture_channels
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.static_pose import FirstBody
from tests.scenes import Scene, moving_scene

CAMERA = PinholeCamera.from_focal(200.0, 120, 160)


def box(height: int, width: int, rows: slice, columns: slice) -> np.ndarray:
    matte = np.zeros((height, width), np.float32)
    matte[rows, columns] = 1
    return matte


def people(seed: int) -> torch.Tensor:
    """Joints some metres before the camera."""
    joints = torch.randn(2, 24, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 0.4
    return joints + torch.tensor([0.1, 0.0, 4.0])


def test_the_window_is_a_square_around_the_matte() -> None:
    window = Window.around(box(120, 160, slice(30, 90), slice(50, 80)), CAMERA)
    assert window.left + window.side / 2 == pytest.approx(65)
    assert window.top + window.side / 2 == pytest.approx(60)
    assert 60 < window.side < 90
    with pytest.raises(InputError):
        Window.around(np.zeros((120, 160), np.float32), CAMERA)


def test_units_put_the_windows_corner_at_minus_one_and_the_pelvis_at_depth_zero() -> None:
    window = Window.around(box(120, 160, slice(30, 90), slice(50, 80)), CAMERA)
    corner = CAMERA.unproject(torch.tensor([window.left, window.top]), torch.tensor(3.0))
    joints = corner.expand(24, 3).clone()
    joints[5, 2] += 0.3
    units = window.to_units(joints)
    assert torch.allclose(units[0], torch.tensor([-1.0, -1.0, 0.0]), atol=1e-5)
    metres = float(units[5, 2]) * 3.0 * window.units_to_tangents()
    assert metres == pytest.approx(0.3, rel=1e-5)


def test_units_know_neither_size_nor_distance_nor_the_cut() -> None:
    window = Window.around(box(120, 160, slice(30, 90), slice(50, 80)), CAMERA)
    joints = people(1)
    seen = window.to_units(joints)
    assert torch.allclose(window.to_units(1.7 * joints), seen, atol=1e-9)  # larger and further away
    cut = Window.around(box(90, 100, slice(20, 80), slice(20, 50)), CAMERA.crop(30, 10, 100, 90))
    assert torch.allclose(cut.to_units(joints), seen, atol=1e-9)
    finer = Window.around(box(240, 320, slice(60, 180), slice(100, 160)), CAMERA.resize(240, 320))
    assert torch.allclose(finer.to_units(joints), seen, atol=1e-9)


def test_a_window_has_the_same_lines_of_sight_in_a_crop_of_another_size() -> None:
    window = Window.around(box(120, 160, slice(30, 90), slice(50, 80)), CAMERA)
    other = window.within(CAMERA.crop(30, 10, 100, 90).resize(180, 200))
    assert other.side == pytest.approx(2 * window.side)
    assert torch.allclose(other.to_units(people(1)), window.to_units(people(1)), atol=1e-9)


def test_the_picture_shows_the_matte_where_the_units_say() -> None:
    matte = box(120, 160, slice(30, 90), slice(50, 80))
    window = Window.around(matte, CAMERA)
    picture = picture_channels(
        np.full((120, 160, 3), 0.2, np.float32), np.full((120, 160, 3), 0.2, np.float32), matte, window
    )
    assert picture.shape == (CHANNELS, PICTURE_PX, PICTURE_PX)
    assert picture.dtype == np.uint8
    rows, columns = np.nonzero(picture[0] > 127)
    middle = (np.array([columns.mean(), rows.mean()]) + 0.5) / PICTURE_PX * 2 - 1
    assert np.abs(middle).max() < 2.5 / PICTURE_PX
    assert np.ptp(rows) > 1.8 * np.ptp(columns)
    assert np.abs(picture[4:].astype(int) - 127).max() <= 1  # nothing changed


def test_the_window_may_reach_outside_the_picture() -> None:
    matte = box(120, 160, slice(0, 118), slice(0, 60))
    window = Window.around(matte, CAMERA)
    assert window.left < 0
    cut = window.cut(matte, cv2.BORDER_CONSTANT)
    assert cut.shape == (PICTURE_PX, PICTURE_PX)
    assert cut.mean() == pytest.approx(matte.sum() / window.side**2, rel=0.05)


def test_every_weight_gets_a_gradient() -> None:
    torch.manual_seed(0)
    network = JointNetwork()
    claim = network(torch.randn(2, CHANNELS, PICTURE_PX, PICTURE_PX), torch.randn(2, 24, 3) * 0.3)
    rounds = sum(one.square().sum() for one in claim.rounds)
    tall = claim.log_height.square() + claim.height_scale
    (rounds + claim.log_scale.sum() + claim.path.square().sum() + (claim.log_odds + tall).sum()).backward()
    assert not [name for name, values in network.named_parameters() if values.grad is None]


def wrong_start(scene: Scene) -> FirstBody:
    """Beside its place, and with both arms and a leg elsewhere."""
    true = scene.middle[0]
    pose = true.pose.clone()
    pose[16, 2] += 0.6
    pose[17, 1] += 0.7
    pose[1, 0] -= 0.5
    return replace(true, pose=pose, translation=true.translation + torch.tensor([0.2, -0.05, 0.1]))


def errors_mm(evidence: JointEvidence, scene: Scene, start: FirstBody) -> tuple[float, float]:
    """Relative to the pelvis: of the start and of the claim."""
    body = load_default_body().shape(torch.zeros(10))
    true, erring = (
        body.joints_of(axis_angle_to_matrix(one.pose)[None], one.translation[None])[0]
        for one in (scene.middle[0], start)
    )
    window = evidence.windows[0]
    unit_mm = 1000 * float(true[0, 2]) * window.units_to_tangents()
    goal = window.to_units(true)
    found = [(joints - joints[:1]) - (goal - goal[:1]) for joints in (window.to_units(erring), evidence.middle[0])]
    return float(found[0].norm(dim=-1).mean() * unit_mm), float(found[1].norm(dim=-1).mean() * unit_mm)


def test_the_shipped_network_improves_a_bad_start_and_says_the_same_twice() -> None:
    body = load_default_body()
    scene = moving_scene(body, size_px=192, step_m=0.1)
    start = wrong_start(scene)
    evidence = predict_joint_evidence(scene.observation, [start], body)
    before, after = errors_mm(evidence, scene, start)
    assert after < 0.75 * before
    again = predict_joint_evidence(scene.observation, [start], body)
    assert torch.equal(evidence.middle, again.middle)
    assert torch.equal(evidence.scale, again.scale)
    spread = evidence.spread_m(
        body.shape(start.betas).joints_of(torch.eye(3).expand(1, 24, 3, 3), torch.tensor([[0.0, 0, 3.4]]))
    )
    assert spread.shape == (1, 24)
    assert float(spread.min()) > 0.002
    assert float(spread.max()) < 0.5


def test_a_mirrored_scene_gives_the_mirrored_claim() -> None:
    """The claim is the mean over both mirror images, so it cannot prefer a side."""
    body = load_default_body()
    scene = moving_scene(body, size_px=128)
    seen, start = scene.observation, wrong_start(scene)
    flipped = replace(
        seen,
        frames_linear=seen.frames_linear.flip(2),
        plate_linear=seen.plate_linear.flip(1),
        mattes=seen.mattes.flip(2),
    )
    turned = start.pose[list(MIRROR)] * torch.tensor([1.0, -1, -1])
    mirrored = replace(start, pose=turned, translation=start.translation * torch.tensor([-1.0, 1, 1]))
    one = predict_joint_evidence(seen, [start], body)
    other = predict_joint_evidence(flipped, [mirrored], body)
    reflected = other.middle[0, list(MIRROR)] * torch.tensor([-1.0, 1, 1])
    # The embedded body is symmetric to a millimetre, and windows fall on whole pixels.
    assert float((one.middle[0] - reflected).abs().max()) < 0.03


def test_several_frames_give_the_paths_their_signs() -> None:
    """The network cannot know the direction; where the next frame's joints are, it is known."""
    body = load_default_body()
    for step_m in (0.3, -0.3):
        scene = moving_scene(body, size_px=96, frames=2, step_m=step_m)
        evidence = predict_joint_evidence(scene.observation, scene.middle, body)
        assert (torch.sign(evidence.path[..., 0].mean(1)) == np.sign(step_m)).all()


def test_other_pictures_are_looked_at_in_the_same_windows() -> None:
    scene = moving_scene(load_default_body(), size_px=128, frames=2)
    seen = scene.observation
    evidence = predict_joint_evidence(seen, scene.middle, load_default_body())
    dark = evidence.predict_for(replace(seen, frames_linear=0.5 * seen.frames_linear))
    assert dark.windows == evidence.windows
    assert torch.equal(dark.start, evidence.start)
    assert 0.001 < float((dark.middle - evidence.middle).abs().mean()) < 0.1
    # A crop whose border repeats shows the windows the same pixels.
    torch.testing.assert_close(
        evidence.predict_for(seen.cropped(*seen.region())).middle, evidence.middle, atol=1e-3, rtol=0
    )
