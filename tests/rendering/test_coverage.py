"""The exact share of each pixel, against counting samples."""

import numpy as np
import pytest
import torch

from hfb.geometry.camera import PinholeCamera
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.reference import front_faces, visible_faces
from tests.rendering.bodies import people, person_mesh

SAMPLES = 16


def counted_share(vertices: torch.Tensor, camera: PinholeCamera) -> torch.Tensor:
    """Share of 16 x 16 sample points per pixel that lie on the body; in plain torch, no outline involved."""
    fine = camera.resize(camera.height * SAMPLES, camera.width * SAMPLES)
    xy, inverse_depth, faces = fine.project(vertices), 1 / vertices[:, 2], person_mesh().faces
    front = front_faces(xy, vertices[:, 2] > 0.05, faces)
    seen = visible_faces(xy, inverse_depth, front, faces, fine.height, fine.width) >= 0
    return seen.double().unflatten(0, (camera.height, SAMPLES)).unflatten(2, (camera.width, SAMPLES)).mean((1, 3))


@pytest.mark.parametrize("size_px", [24, 48])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_coverage_is_what_samples_count(size_px: int, seed: int) -> None:
    camera = PinholeCamera.from_focal(1.25 * size_px, size_px, size_px)
    body = people(1, seed)
    share = make_rasterizer().silhouette_mean(body, camera, person_mesh())
    counted = counted_share(body[0], camera)
    assert share.sum().item() == pytest.approx(counted.sum().item(), rel=5e-3)
    # The samples' own error: an edge along a row or column of samples shifts a pixel by up to 1 / 16.
    assert (share - counted).abs().max() < 1.5 / SAMPLES
    assert np.sqrt(((share - counted) ** 2).mean().item()) < 0.2 / SAMPLES
