"""Cropping and resizing an observation keep what it says about the world."""

import pytest
import torch

from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.rendering.observation import Observation


def observation(height: int = 40, width: int = 60) -> Observation:
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    inside = ((rows - 20) ** 2 + (columns - 25) ** 2 < 100).float()
    return Observation(
        frames_linear=torch.rand(2, height, width, 3, generator=torch.Generator().manual_seed(0)),
        plate_linear=torch.rand(height, width, 3, generator=torch.Generator().manual_seed(1)),
        mattes=torch.stack([inside, inside * 0.5]),
        camera=PinholeCamera.from_focal(80.0, height, width),
        exposure_s=0.02,
        interval_s=0.04,
    )


def test_the_region_holds_every_matte() -> None:
    seen = observation()
    left, top, width, height = seen.region()
    window = seen.cropped(left, top, width, height)
    assert window.mattes.shape == (2, height, width)
    torch.testing.assert_close(window.mattes.sum((1, 2)), seen.mattes.sum((1, 2)))


def test_a_window_may_reach_outside_the_picture() -> None:
    seen = observation()
    window = seen.cropped(-5, -7, 80, 60)
    torch.testing.assert_close(window.frames_linear[:, 7:47, 5:65], seen.frames_linear)
    torch.testing.assert_close(window.plate_linear[0, 0], seen.plate_linear[0, 0])
    assert window.mattes[:, :7].max() == 0


def test_a_point_projects_to_the_same_place_in_the_window() -> None:
    seen = observation()
    point = torch.tensor([[0.1, -0.05, 2.0]])
    full = seen.camera.project(point)
    cropped = seen.cropped(3, 5, 30, 20).camera.project(point)
    torch.testing.assert_close(cropped, full - torch.tensor([3.0, 5.0]))
    resized = seen.resized(120).camera.project(point)
    torch.testing.assert_close(resized, full * 2)


def test_a_smaller_picture_has_the_same_mean() -> None:
    small = observation().resized(30)
    assert small.mattes.shape == (2, 20, 30)
    torch.testing.assert_close(small.mattes.mean(), observation().mattes.mean(), atol=1e-4, rtol=0)


def test_no_person_is_said_so() -> None:
    seen = observation()
    empty = Observation(seen.frames_linear, seen.plate_linear, seen.mattes * 0, seen.camera, 0.02, 0.04)
    with pytest.raises(InputError, match="check the plate"):
        empty.region()
