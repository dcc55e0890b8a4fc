"""METRO's interface: a mesh is registered to the body it belongs to, joints to any other, before the clip's camera."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
import torch
from torch import Tensor, nn

from hfb.body.assets import load_default_body
from hfb.body.skeleton import H36M_14
from hfb.config import InitConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rays import seen_along
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.initializer import Initializer, make_initializer
from hfb.initialization.network_body import read_samplings, registered
from hfb.initialization.person_crop import person_square
from hfb.initialization.silhouette_fit import silhouette
from hfb.motion.static_pose import FirstBody
from hfb.networks.runtimes import Outputs
from hfb.rendering.backends import make_rasterizer
from tests.scenes import standing_pose

BODY = load_default_body()
SMPL = replace(BODY, betas_space="smpl")
CAMERA = PinholeCamera.from_focal(300.0, 200, 260)


class Metro(nn.Module):
    """Says the same of every picture; refuses one that is no 224 px crop."""

    def __init__(self, camera: Tensor, joints: Tensor, mesh: Tensor) -> None:
        super().__init__()
        for name, value in (("camera", camera), ("joints", joints), ("mesh", mesh)):
            self.register_buffer(name, value)

    def forward(self, picture: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        assert picture.shape == (1, 3, 224, 224)
        return self.camera[None], self.joints[None], self.mesh[None, :431], self.mesh[None]


def someone() -> FirstBody:
    pose = standing_pose()
    pose[18, 1], pose[4, 0] = -0.9, 0.5
    return FirstBody(
        pose, torch.tensor([0.5, 0.15, 4.0]), 0.5 * torch.randn(10, generator=torch.Generator().manual_seed(1)), "truth"
    )


def exported(true: FirstBody, folder: Path) -> tuple[Path, np.ndarray]:
    """What METRO would say of this person, and their matte: seen along the crop's ray, about the pelvis."""
    matte = silhouette(true, CAMERA, BODY, make_rasterizer()).numpy()
    posed = BODY.shape(true.betas).pose(axis_angle_to_matrix(true.pose)[None], true.translation[None])
    pelvis = posed.joints[0, 0]
    left, top, side = person_square(matte, 1.2)
    middle = torch.tensor([left + side / 2, top + side / 2])
    turn = seen_along(CAMERA.unproject(middle, torch.tensor(1.0)))
    points, joints = ((one[0] - pelvis) @ turn for one in (posed.vertices, posed.joints))
    scale = 2 * CAMERA.fx / (float(pelvis[2]) * side)
    offset = pelvis[:2] - CAMERA.unproject(middle, pelvis[2])[:2]
    network = Metro(torch.tensor([scale, *offset.tolist()]), joints[list(H36M_14)], points)
    path = folder / "metro.pt"
    torch.jit.trace(network, torch.zeros(1, 3, 224, 224)).save(str(path))
    return path, matte


@pytest.mark.parametrize(("body", "within_mm"), [(SMPL, 25), (BODY, 60)], ids=["its own mesh", "joints"])
def test_the_person_of_the_network(tmp_path: Path, body: object, within_mm: float) -> None:
    true = someone()
    path, matte = exported(true, tmp_path)
    initializer = make_initializer(InitConfig(method="metro", weights=path))
    assert isinstance(initializer, Initializer)
    frame = np.full((200, 260, 3), 0.3, np.float32)
    found = initializer(frame, frame, matte, CAMERA, body)  # type: ignore[arg-type]
    assert found.source == "metro"
    joints = [
        BODY.shape(one.betas).joints_of(axis_angle_to_matrix(one.pose)[None], one.translation[None])[0]
        for one in (true, found)
    ]
    relative = 1000 * ((joints[0] - joints[0][0]) - (joints[1] - joints[1][0])).norm(dim=-1)
    assert float(relative.mean()) < within_mm
    assert float((joints[0][0] - joints[1][0]).norm()) < 0.15
    pixels = (CAMERA.project(joints[0]) - CAMERA.project(joints[1])).norm(dim=-1)
    assert float(pixels.mean()) < 3


@pytest.mark.parametrize("count", [1723, 431])
def test_a_coarse_mesh_alone(tmp_path: Path, count: int) -> None:
    """METRO's coarser meshes keep some of the vertices; its own file, as scipy pickled it, says which."""
    true = someone()
    posed = BODY.shape(true.betas).pose(axis_angle_to_matrix(true.pose)[None], true.translation[None])
    first = np.sort(np.random.default_rng(3).choice(len(BODY.template), 1723, replace=False))
    second = np.arange(431) * 4
    steps = np.empty(2, object)
    for number, (kept, before) in enumerate(((first, len(BODY.template)), (second, 1723))):
        steps[number] = scipy.sparse.csr_matrix((np.ones(len(kept)), (range(len(kept)), kept)), (len(kept), before))
    np.savez(tmp_path / "mesh_downsampling.npz", D=steps)
    samplings = read_samplings(tmp_path / "mesh_downsampling.npz")
    kept = {1723: first, 431: first[second]}[count]
    mesh = (posed.vertices[0] - posed.joints[0, 0]).numpy()[kept]
    outputs = Outputs(tmp_path, ("", ""), (np.ones((1, 3), np.float32), mesh[None].astype(np.float32)))
    found = registered(outputs, SMPL, samplings)
    joints = BODY.shape(found.betas).joints_of(axis_angle_to_matrix(found.pose)[None], found.translation[None])[0]
    off = (joints - joints[0] - (posed.joints[0] - posed.joints[0, 0])).norm(dim=-1)
    assert float(off.mean()) < 0.012
    with pytest.raises(InputError, match="mesh-sampling"):
        registered(outputs, SMPL)


def test_a_file_of_samplings_that_is_none(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", A=np.eye(3))
    np.savez(tmp_path / "mean.npz", D=np.array([scipy.sparse.csr_matrix(np.full((2, 4), 0.25)), None], object))
    for name in ("other.npz", "mean.npz"):
        with pytest.raises(InputError, match="mesh_downsampling"):
            read_samplings(tmp_path / name)


def test_a_network_that_is_no_metro(tmp_path: Path) -> None:
    class Other(nn.Module):
        def forward(self, picture: Tensor) -> Tensor:
            return picture.mean((2, 3)).repeat(1, 5)

    torch.jit.trace(Other(), torch.zeros(1, 3, 224, 224)).save(str(tmp_path / "other.pt"))
    matte = exported(someone(), tmp_path)[1]
    frame = np.full((200, 260, 3), 0.3, np.float32)
    with pytest.raises(InputError, match="is it METRO"):
        make_initializer(InitConfig(method="metro", weights=tmp_path / "other.pt"))(frame, frame, matte, CAMERA, BODY)
    with pytest.raises(InputError, match="--init-weights FILE"):
        make_initializer(InitConfig(method="metro"))
