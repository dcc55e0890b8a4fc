"""motion.usdz, read back by USD itself."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.evaluation.protocol import pose_rows
from hfb.geometry.placement import world_of_up, y_up
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.usd_file import write_usd
from tests.interop.writers.motions import motion_of
from tests.interop.writers.test_skinned_glb import _PNG

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Gf, Usd, UsdGeom, UsdSkel

BODY = load_default_body()
_K = np.array([[700.0, 0, 350], [0, 720, 220], [0, 0, 1]])
MOTION = replace(motion_of(BODY, frames=2), K=_K, size=(640, 480), world=world_of_up(np.array([0.1, -0.9, -0.4])))
_FPS = 24.0
_BOUND_MM = 1.0


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Usd.Stage:
    path = tmp_path_factory.mktemp("usd") / "motion.usdz"
    write_usd(path, Exported(MOTION, "hfb", BODY, _PNG, fps=_FPS, plate="plate.png"))
    return Usd.Stage.Open(str(path))


def in_world(points: np.ndarray) -> np.ndarray:
    return y_up(MOTION.export_world).points(points)


def test_joints_and_surface_at_every_sub_frame(stage: Usd.Stage) -> None:
    root = UsdSkel.Root(stage.GetPrimAtPath("/motion/camera_frame/person"))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(binding.GetSkeleton())
    (skin,) = binding.GetSkinningTargets()
    assert [str(name).split("/")[-1] for name in query.GetJointOrder()] == list(JOINT_NAMES)
    codes = query.GetAnimQuery().GetJointTransformTimeSamples()
    np.testing.assert_allclose(codes, MOTION.times_s * _FPS, atol=1e-9)
    mesh = UsdGeom.Mesh(skin.GetPrim())
    rest = np.array(mesh.GetPointsAttr().Get())
    own = BODY.shape(torch.from_numpy(MOTION.betas).float()).vertices.numpy()
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    index = BODY.mesh.faces.numpy().ravel()
    np.testing.assert_allclose(rest[faces], own[index], atol=1e-5)
    for row, code in enumerate(codes):
        above = UsdGeom.XformCache(code).GetLocalToWorldTransform(root.GetPrim())
        places = [above.Transform(one.ExtractTranslation()) for one in query.ComputeJointSkelTransforms(code)]
        apart_m = np.linalg.norm(np.array(places) - in_world(MOTION.joints[row]), axis=-1)
        assert 1000 * apart_m.max() < _BOUND_MM
        points = mesh.GetPointsAttr().Get()
        skin.ComputeSkinnedPoints(query.ComputeSkinningTransforms(code), points, code)
        posed = pose_rows(MOTION, np.array([row]), BODY).vertices[0].detach().numpy()
        turned = np.array(points)[faces] @ np.array(above)[:3, :3] + np.array(above)[3, :3]
        assert 1000 * np.linalg.norm(turned - in_world(posed)[index], axis=-1).max() < _BOUND_MM


def test_the_camera_sees_what_ours_does(stage: Usd.Stage) -> None:
    prim = UsdGeom.Camera(stage.GetPrimAtPath("/motion/camera_frame/camera"))
    assert prim.GetPrim().GetCustomDataByKey("hfb:background") == "plate.png"
    frustum = prim.GetCamera(Usd.TimeCode(0)).frustum
    seen = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    for place, joint in zip(in_world(MOTION.joints[3]), MOTION.joints[3], strict=True):
        x, y, _ = seen.Transform(Gf.Vec3d(*place.tolist()))
        projected = _K @ joint
        expected = projected[:2] / projected[2]
        np.testing.assert_allclose([(1 + x) * 320, (1 - y) * 240], expected, atol=0.01)


def test_the_stage_and_its_checks(stage: Usd.Stage, tmp_path: Path) -> None:
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode()) == (_FPS, 0)
    assert stage.GetEndTimeCode() - 1 < MOTION.times_s[-1] * _FPS <= stage.GetEndTimeCode() == 2  # 1.28: all is played
    for name in ("one.usdz", "two.usdz"):
        write_usd(tmp_path / name, Exported(MOTION, "hfb", BODY, _PNG, fps=_FPS))
        time.sleep(2.1)  # the package counts time in steps of two seconds
    assert (tmp_path / "one.usdz").read_bytes() == (tmp_path / "two.usdz").read_bytes()
    validation = pytest.importorskip("pxr.UsdValidation", reason="this usd-core has no validators")
    checks = validation.ValidationContext(validation.ValidationRegistry().GetOrLoadAllValidators())
    assert [one.GetMessage() for one in checks.Validate(stage)] == []
