"""SfB and MfB: an object of unknown shape in rigid motion."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.errors import InputError
from hfb.evaluation.baselines.shape_from_blur import ShapeFromBlur
from hfb.evaluation.baselines.sphere import make_sphere
from hfb.evaluation.baselines.sphere_start import DEPTH_M, shutter_tau, sphere_starts
from hfb.evaluation.metrics import silhouette_iou, soft_iou
from hfb.evaluation.prediction import Prediction
from hfb.geometry.camera import PinholeCamera
from hfb.motion.clock import subframe_times_s
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.rendering.texels import texel_faces
from tests.evaluation.baselines.cases import bare_case

_SIZE, _DEPTH = 64, 3.5
_STAGES = ((32, 50), (64, 30))


@dataclass(frozen=True)
class Flight:
    """A textured egg that flies in a straight line, turned towards neither axis."""

    observation: Observation
    silhouettes: np.ndarray  # per frame 8 sub-frames

    def iou(self, prediction: Prediction) -> tuple[float, float]:
        """In the claimed direction of time and in the other."""
        assert prediction.silhouettes is not None
        frames = len(self.observation.mattes)
        claimed = prediction.silhouettes.reshape(frames, 8, _SIZE, _SIZE)
        both = (claimed, claimed[:, ::-1])
        return tuple(silhouette_iou(one.reshape(-1, _SIZE, _SIZE).astype(np.float32), self.silhouettes) for one in both)  # type: ignore[return-value]


def flight(metres: float, frames: int = 1) -> Flight:
    """An egg of 0.5 x 0.8 m that flies so far in each exposure; the shutter is open 7/8 of the time."""
    sphere, camera = make_sphere(), PinholeCamera.from_focal(1.4 * _SIZE, _SIZE, _SIZE)
    exposure_s, interval_s = 0.07, 0.08
    times = subframe_times_s(frames, 8, exposure_s, interval_s)[0] - (exposure_s + (frames - 1) * interval_s) / 2
    steps = torch.from_numpy(times / exposure_s * metres).float()[:, None] * torch.tensor([0.9, 0.45, 0.0])
    egg = sphere.vertices * torch.tensor([0.25, 0.4, 0.25])
    generator = torch.Generator().manual_seed(1)
    texture = torch.rand(8, 8, 3, generator=generator).repeat_interleave(8, 0).repeat_interleave(8, 1)
    plate = 0.2 + 0.3 * torch.rand(_SIZE, _SIZE, 3, generator=generator)
    vertices = egg + (steps + torch.tensor([0.1, 0.0, _DEPTH]))[:, None]
    drawn = make_rasterizer().render(vertices, texture, camera, sphere.mesh)
    mean = drawn.unflatten(0, (frames, 8)).mean(1)
    observation = Observation(compose(mean, plate), plate, mean[..., 3], camera, exposure_s, interval_s)
    return Flight(observation, (drawn[..., 3] >= 0.5).numpy().astype(np.float32))


def test_the_prototype_is_a_closed_textured_sphere() -> None:
    sphere = make_sphere()
    assert sphere.vertices.shape == (642, 3)
    assert torch.allclose(sphere.vertices.norm(dim=1), torch.ones(642))
    assert (sphere.mesh.edge_faces >= 0).all()
    a, b, c = sphere.vertices[sphere.mesh.faces].unbind(1)
    normals = torch.linalg.cross(b - a, c - a)
    assert ((normals * (a + b + c)).sum(1) > 0).all()  # counter-clockwise from outside
    assert float((a * normals).sum() / 6) == pytest.approx(4 / 3 * np.pi, rel=0.01)
    assert 0 <= sphere.mesh.uv.min() <= sphere.mesh.uv.max() <= 1
    assert len(texel_faces(sphere.mesh, 256).unique()) == len(sphere.mesh.faces) + 1  # every face has texels


def test_moving_every_vertex_alike_is_smooth() -> None:
    sphere = make_sphere(2)
    assert sphere.laplacian(torch.ones_like(sphere.vertices)).abs().max() < 1e-6
    bump = torch.zeros_like(sphere.vertices)
    bump[7, 0] = 1.0
    assert float(sphere.laplacian(bump)[7, 0]) == pytest.approx(1.0)


def test_the_start_is_where_the_matte_is() -> None:
    scene = flight(0.0).observation
    still = sphere_starts(scene, 2)[0]
    assert still.path_m[0].tolist() == pytest.approx([0.1, 0.0, _DEPTH], abs=0.02)
    assert still.axes_m[:2].tolist() == pytest.approx([0.25, 0.4], rel=0.1)
    assert DEPTH_M == _DEPTH


def test_several_mattes_tell_the_motion() -> None:
    (start,) = sphere_starts(flight(0.4, frames=3).observation, 4)
    exposures = (0.07 + 2 * 0.08) / 0.07
    assert start.path_m[1, :2].tolist() == pytest.approx([0.36 * exposures, 0.18 * exposures], rel=0.1)


def test_the_clock_runs_through_the_gaps() -> None:
    tau = shutter_tau(flight(0.0, frames=2).observation, 8)
    assert tau[0, 0] == -0.5
    assert tau[1, 7] == 0.5
    inside, between = tau[0, 1] - tau[0, 0], tau[1, 0] - tau[0, 7]
    assert float(between / inside) == pytest.approx(0.01 / 0.01, rel=1e-4)


def test_sfb_finds_a_flight_up_to_its_direction(tmp_path: Path) -> None:
    seen = flight(0.5)
    prediction = ShapeFromBlur("sfb", False, 8, _STAGES)(bare_case(tmp_path), seen.observation, [])
    assert prediction.motion is None
    assert prediction.pictures is not None
    assert max(seen.iou(prediction)) > 0.7
    matte = seen.observation.mattes[0].numpy()
    assert soft_iou(prediction.pictures[..., 3].mean(0), matte) > 0.85
    # As if at rest it would share far less with each sub-frame:
    resting = np.repeat((matte >= 0.5)[None], 8, 0).astype(np.float32)
    assert silhouette_iou(resting, seen.silhouettes) < 0.65


def test_mfb_knows_the_direction(tmp_path: Path) -> None:
    seen = flight(0.4, frames=2)
    prediction = ShapeFromBlur("mfb", True, 8, _STAGES)(bare_case(tmp_path, 2), seen.observation, [])
    forth, back = seen.iou(prediction)
    assert forth > 0.7
    assert forth > back + 0.1


def test_what_rests_is_found_at_rest(tmp_path: Path) -> None:
    seen = flight(0.0)
    prediction = ShapeFromBlur("sfb", False, 8, _STAGES)(bare_case(tmp_path), seen.observation, [])
    assert min(seen.iou(prediction)) > 0.85


def test_sfb_takes_frames_one_by_one(tmp_path: Path) -> None:
    """And gives the same bits again, alone or beside another frame."""
    from hfb.evaluation.baselines.frames import one_by_one

    seen = flight(0.3, frames=2).observation
    method = ShapeFromBlur("sfb", False, 4, ((32, 10),))
    both = method(bare_case(tmp_path, 2), seen, []).pictures
    second = method(bare_case(tmp_path), one_by_one(seen)[1], []).pictures
    assert both is not None
    assert second is not None
    assert both.shape == (8, _SIZE, _SIZE, 4)
    assert np.array_equal(both[4:], second)


def test_nobody_there(tmp_path: Path) -> None:
    seen = flight(0.0).observation
    empty = Observation(seen.frames_linear, seen.plate_linear, 0 * seen.mattes, seen.camera, 0.07, 0.08)
    with pytest.raises(InputError, match="matte is empty"):
        ShapeFromBlur("sfb", False, 4, ((32, 2),))(bare_case(tmp_path), empty, [])
