"""A clip cut into windows, one person for all of them, and what is kept of a window."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.config import FitConfig, RunConfig, Stage, VideoConfig, Weights, preset
from hfb.errors import InputError
from hfb.fitting.clip.merge_identities import merge_identities
from hfb.fitting.clip.windows import (
    ClipWindow,
    WindowFit,
    WindowScene,
    fit_windows,
    load_window,
    person_config,
    person_windows,
    plan_windows,
    save_window,
    window_config,
)
from hfb.fitting.identity import Identity, load_identity, save_identity
from hfb.fitting.stages import for_frames
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.static_pose import FirstBody, rescale_first_body
from hfb.priors.anatomy import AnatomicalPrior
from tests.fitting.chains import timing, window_fits
from tests.scenes import moving_scene

BODY = load_default_body()
QUICK = FitConfig(
    subframes=3, texture_px=16, origin=0.5, stages=(Stage(size_px=32, iterations=6, learning_rate=0.002),),
    keep_image_size=True, weights=Weights(image=1, matte=1, shape=0.01, boundary=1),
)  # fmt: skip


def frames_of(usable: str, length: int) -> list[tuple[int, ...]]:
    return [window.frames for window in plan_windows(np.array([one == "x" for one in usable]), length)]


def test_windows_share_one_frame() -> None:
    assert frames_of("xxxx", 2) == [(0, 1), (1, 2), (2, 3)]
    assert frames_of("xxxxxx", 3) == [(0, 1, 2), (2, 3, 4), (4, 5)]
    assert frames_of("xxxxx", 5) == [(0, 1, 2, 3, 4)]
    assert frames_of("xxx", 5) == [(0, 1, 2)]
    assert frames_of("x", 2) == [(0,)]
    assert frames_of("..xx.x.", 2) == [(2, 3), (5,)]
    assert frames_of("...", 2) == []
    windows = plan_windows(np.array([True, True, False, True]), 2)
    assert [window.segment for window in windows] == [0, 1]
    with pytest.raises(ValueError, match="cannot overlap"):
        plan_windows(np.ones(3, bool), 1)


@pytest.mark.parametrize("frames", [2, 7, 50])
@pytest.mark.parametrize("length", [2, 3, 4, 5])
def test_every_frame_and_every_edge_is_in_a_window(frames: int, length: int) -> None:
    windows = frames_of("x" * frames, length)
    edges = [edge for window in windows for edge in pairwise(window)]
    assert edges == [(frame, frame + 1) for frame in range(frames - 1)]  # each once: the cost is linear


def test_the_person_is_settled_by_windows_apart() -> None:
    windows = plan_windows(np.ones(25, bool), 2)
    areas = np.ones(25)
    areas[[3, 13]] = 9
    chosen = person_windows(windows, areas, 3)
    assert len(chosen) == 3
    assert min(np.diff(chosen)) > 2
    assert {3, 13} <= {frame for index in chosen for frame in windows[index].frames}
    assert person_windows(windows[:2], areas, 5) == (0, 1)
    lone = (ClipWindow((0,), 0), ClipWindow((4, 5), 1))
    assert person_windows(lone, np.array([9.0, 0, 0, 0, 1, 1]), 1) == (1,)


def test_configurations_of_windows() -> None:
    run = preset("best")
    assert window_config(run).stages == run.video.stages
    assert for_frames(window_config(run), 4) == window_config(run)  # told as they are, for a window's frames
    assert window_config(run).directions.search is person_config(run).directions.search is False
    assert person_config(run).stages == run.fit.stages
    plain = RunConfig(fit=QUICK, video=VideoConfig(settle=50))
    assert window_config(plain).settle == 0  # a fit that never settles does not begin to in a clip


@cache
def known_fit() -> tuple[list[FirstBody], Identity, WindowFit]:
    scene = moving_scene(BODY, size_px=48, frames=2, instants=5)
    person = Identity(torch.full((10,), 0.3), torch.full((16, 16, 3), 0.4))
    aside = [replace(one, translation=one.translation + torch.tensor([0.06, 0.0, 0.0])) for one in scene.middle]
    seen = WindowScene(ClipWindow((4, 5), 1), scene.observation, aside, person)
    (found,) = fit_windows([seen], BODY, QUICK, seed=0, pose_prior=AnatomicalPrior())
    return scene.middle, person, found


def test_a_known_person_is_held_fixed() -> None:
    _, person, found = known_fit()
    assert torch.equal(found.betas, person.betas)
    assert found.texture is None
    assert found.frames == (4, 5)
    assert found.segment == 1
    assert found.joint_radius_mm is not None
    assert found.joint_radius_mm.shape == (2, 3, 24)
    assert np.isfinite(found.joint_radius_mm).all()
    assert min(found.history["total"]) < found.history["total"][0]


def test_windows_keep_what_they_found(tmp_path: Path) -> None:
    *_, found = known_fit()
    save_window(tmp_path / "w.npz", found)
    again = load_window(tmp_path / "w.npz")
    assert torch.equal(again.trajectory.rotation, found.trajectory.rotation)
    assert torch.equal(again.trajectory.translation, found.trajectory.translation)
    assert (again.trajectory.kind, again.trajectory.origin) == (found.trajectory.kind, found.trajectory.origin)
    assert np.array_equal(again.joint_radius_mm, found.joint_radius_mm)
    save_window(tmp_path / "again.npz", replace(again, seconds=99.0))
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "w.npz").read_bytes()
    (tmp_path / "w.npz").write_bytes(b"PK nonsense")
    for name in ("w.npz", "missing.npz"):
        with pytest.raises(InputError):
            load_window(tmp_path / name)


def test_another_shape_keeps_the_place_in_the_picture() -> None:
    camera = PinholeCamera.from_focal(500.0, 100, 100)
    first = FirstBody(
        torch.tensor([[3.1, 0, 0]] + [[0.0] * 3] * 23), torch.tensor([0.5, 0.2, 4.0]), torch.zeros(10), "x"
    )
    other = rescale_first_body(first, torch.linspace(-2, 2, 10), BODY)

    def seen(one: FirstBody) -> torch.Tensor:
        shaped = BODY.shape(one.betas)
        return camera.project(shaped.joints_of(axis_angle_to_matrix(one.pose)[None], one.translation[None])[0])

    assert torch.allclose(seen(other)[0], seen(first)[0], atol=1e-3)
    heights = [float(one[:, 1].max() - one[:, 1].min()) for one in (seen(first), seen(other))]
    assert heights[1] == pytest.approx(heights[0], rel=0.05)


def test_windows_agree_on_a_person(tmp_path: Path) -> None:
    clock = timing(4)
    fits = [
        replace(found, betas=torch.full((10,), value), texture=torch.full((32, 32, 3), value))
        for found, value in zip(window_fits(clock), (0.1, 0.2, 0.6), strict=True)
    ]
    person = merge_identities(fits, BODY)
    assert torch.allclose(person.betas, torch.full((10,), 0.3))
    assert person.texture.min() >= 0.1 - 1e-6
    assert person.texture.max() <= 0.6 + 1e-6
    assert abs(float(person.texture.mean()) - 0.3) < 0.05
    again = merge_identities(fits[::-1], BODY)
    assert torch.equal(again.betas, person.betas)
    assert torch.equal(again.texture, person.texture)
    save_identity(tmp_path / "p.npz", person)
    assert torch.equal(load_identity(tmp_path / "p.npz").texture, person.texture)
    with pytest.raises(ValueError, match="without a known one"):
        merge_identities(window_fits(clock), BODY)
    (tmp_path / "p.npz").write_bytes(b"")
    with pytest.raises(InputError):
        load_identity(tmp_path / "p.npz")
