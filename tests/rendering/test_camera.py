import pytest
import torch

from hfb.geometry.camera import PinholeCamera


@pytest.fixture
def camera() -> PinholeCamera:
    return PinholeCamera(120.0, 110.0, 31.0, 25.5, 48, 64)


def points(count: int = 20) -> torch.Tensor:
    spread = torch.rand(count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return spread + torch.tensor([-0.5, -0.5, 1.0])


def test_projection_is_the_matrix(camera: PinholeCamera) -> None:
    homogeneous = points() @ camera.matrix().T
    torch.testing.assert_close(camera.project(points()), homogeneous[:, :2] / homogeneous[:, 2:])


def test_the_principal_ray_meets_the_middle_of_the_picture() -> None:
    camera = PinholeCamera.from_focal(100.0, 48, 64)
    torch.testing.assert_close(camera.project(torch.tensor([0.0, 0.0, 3.0])), torch.tensor([32.0, 24.0]))


def test_unprojection_undoes_projection(camera: PinholeCamera) -> None:
    torch.testing.assert_close(camera.unproject(camera.project(points()), points()[:, 2]), points())


def test_a_crop_shifts_pixels(camera: PinholeCamera) -> None:
    window = camera.crop(-5, 7, 20, 30)
    assert (window.height, window.width) == (30, 20)
    torch.testing.assert_close(window.project(points()), camera.project(points()) - torch.tensor([-5.0, 7.0]))


def test_resizing_scales_pixels(camera: PinholeCamera) -> None:
    small = camera.resize(24, 16)
    torch.testing.assert_close(small.project(points()), camera.project(points()) * torch.tensor([0.25, 0.5]))


def test_a_camera_survives_its_matrix(camera: PinholeCamera) -> None:
    assert PinholeCamera.from_matrix(camera.matrix(), camera.height, camera.width) == camera
