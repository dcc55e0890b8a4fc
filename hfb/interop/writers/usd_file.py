"""motion.usdz: the person with skin, skeleton, texture and camera for USD; needs the extra ``usd``.

The world is the motion's, in metres with y up; the camera's frame is a transform in it, as in motion.glb. Every
sub-frame is a sample at its exact time, between the whole frames: time code 0 is the first opening of the shutter.
"""

import math
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hfb.geometry.placement import y_up
from hfb.interop.writers.export_camera import NEAR_M, aspect_ratio, camera_of, far_m, lens_shift
from hfb.interop.writers.export_names import check_formats
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.keys import MotionKeys, exact_keys
from hfb.interop.writers.skin import Skin, skin_of
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float

_SENSOR = 0.24  # height, in tenths of a metre as the format has it: 24 mm
_WHEN = 946_684_800  # 2000-01-01
_TEXTURE = "texture.png"
_FRAME = "/motion/camera_frame"
_PERSON = f"{_FRAME}/person"
_MATERIAL = "/motion/material"


def write_usd(path: Path, exported: Exported) -> None:
    """Write the file whole or not at all.

    Args:
        path: the .usdz file.
        exported: the motion, body and texture; its rate is that of the time codes, its plate a datum of the camera.

    Raises:
        InputError: the library is missing, the motion's instants are not in order, or its K has no focal length.
    """
    check_formats(["usd"])
    from pxr import Gf, Sdf, Usd, UsdGeom

    motion, fps, texture_png = exported.motion, exported.fps, exported.texture_png
    keys, placed = exact_keys(motion), y_up(motion.export_world)
    with tempfile.TemporaryDirectory() as private:
        layer, package = Path(private) / "motion.usdc", Path(private) / "motion.usdz"
        stage = Usd.Stage.CreateNew(str(layer))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(math.floor(float(keys.times_s[0]) * fps))
        stage.SetEndTimeCode(math.ceil(float(keys.times_s[-1]) * fps - 1e-6))  # players show whole time codes
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/motion").GetPrim())
        matrix = np.eye(4)
        matrix[:3, :3], matrix[3, :3] = placed.R.T, placed.t  # the format's vectors are rows
        UsdGeom.Xform.Define(stage, _FRAME).AddTransformOp().Set(Gf.Matrix4d(matrix))
        _add_camera(stage, motion, exported.plate)
        _add_person(stage, motion, exported.surface, keys, fps)
        if texture_png is not None:
            (Path(private) / _TEXTURE).write_bytes(texture_png)
        _add_material(stage, texture_png is not None)
        stage.GetRootLayer().Save()
        writer = Sdf.ZipFileWriter.CreateNew(str(package))
        for part in (layer, Path(private) / _TEXTURE):  # the layer comes first
            if part.exists():
                os.utime(part, (_WHEN, _WHEN))  # the package keeps it: the same motion makes the same bytes
                writer.AddFile(str(part), part.name)
        writer.Save()
        write_bytes_atomic(path, package.read_bytes())


def _add_camera(stage: Any, motion: SampledMotion, plate: str | None) -> None:
    from pxr import Gf, UsdGeom

    seen, prim = camera_of(motion), UsdGeom.Camera.Define(stage, f"{_FRAME}/camera")
    right, up = lens_shift(seen)
    prim.AddTransformOp().Set(Gf.Matrix4d(np.diag([1.0, -1.0, -1.0, 1.0])))  # it looks along -z with y up
    prim.CreateVerticalApertureAttr(_SENSOR)
    prim.CreateHorizontalApertureAttr(_SENSOR * aspect_ratio(seen))
    prim.CreateFocalLengthAttr(_SENSOR * seen.fy / seen.height)
    prim.CreateHorizontalApertureOffsetAttr(_SENSOR * right)
    prim.CreateVerticalApertureOffsetAttr(_SENSOR * up)
    prim.CreateClippingRangeAttr(Gf.Vec2f(NEAR_M, far_m(motion)))
    facts: dict[str, Any] = {"width_px": seen.width, "height_px": seen.height}
    prim.GetPrim().SetCustomDataByKey("hfb", facts | ({"background": plate} if plate else {}))


def _add_person(stage: Any, motion: SampledMotion, body: Body, keys: MotionKeys, fps: float) -> None:
    from pxr import UsdSkel, Vt

    betas = torch.from_numpy(motion.betas).to(body.template.dtype)
    rest = body.rest_joints(betas).double().numpy()
    root = UsdSkel.Root.Define(stage, _PERSON)
    facts = {"betas_space": body.betas_space, "betas": Vt.DoubleArray.FromNumpy(motion.betas)}
    facts |= {"body": body.name, "body_licence": body.licence, "world": motion.export_world.source}
    root.GetPrim().SetCustomDataByKey("hfb", facts)
    names = _joint_paths()
    skeleton = UsdSkel.Skeleton.Define(stage, f"{_PERSON}/skeleton")
    skeleton.CreateJointsAttr(names)
    skeleton.CreateBindTransformsAttr(_moved(rest))
    offsets = np.array([rest[j] - rest[p] if p >= 0 else rest[j] for j, p in enumerate(PARENTS)])
    skeleton.CreateRestTransformsAttr(_moved(offsets))

    animation = UsdSkel.Animation.Define(stage, f"{_PERSON}/animation")
    animation.CreateJointsAttr(names)
    animation.CreateScalesAttr(Vt.Vec3hArray(JOINT_COUNT, (1, 1, 1)))
    places, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    for time_s, quaternions, translation in zip(keys.times_s, keys.quaternions, keys.translations, strict=True):
        offsets[0] = rest[0] + translation
        places.Set(Vt.Vec3fArray.FromNumpy(offsets.astype(np.float32)), float(time_s) * fps)
        imaginary_first = np.roll(quaternions, -1, -1).astype(np.float32)
        turns.Set(Vt.QuatfArray.FromNumpy(imaginary_first), float(time_s) * fps)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    _add_surface(stage, skin_of(body, betas))


def _add_surface(stage: Any, skin: Skin) -> None:
    from pxr import Sdf, UsdGeom, UsdShade, UsdSkel, Vt

    mesh = UsdGeom.Mesh.Define(stage, f"{_PERSON}/surface")
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(skin.vertices))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(skin.normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(skin.corners.astype(np.int32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(skin.corners) // 3, 3))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([skin.vertices.min(0), skin.vertices.max(0)])))
    uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    uv.Set(Vt.Vec2fArray.FromNumpy(np.stack([skin.uv[:, 0], 1 - skin.uv[:, 1]], 1)))  # v = 0 is the lowest row
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    joints, weights = np.concatenate(skin.joints, 1).astype(np.int32), np.concatenate(skin.weights, 1)
    influences = joints.shape[1]
    binding.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray.FromNumpy(joints.ravel()))
    binding.CreateJointWeightsPrimvar(False, influences).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateSkeletonRel().SetTargets([f"{_PERSON}/skeleton"])
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(UsdShade.Material.Define(stage, _MATERIAL))


def _add_material(stage: Any, textured: bool) -> None:
    from pxr import Gf, Sdf, UsdShade

    material, kinds = UsdShade.Material.Define(stage, _MATERIAL), Sdf.ValueTypeNames

    def shader(name: str, identifier: str) -> Any:
        made = UsdShade.Shader.Define(stage, f"{_MATERIAL}/{name}")
        made.CreateIdAttr(identifier)
        return made

    surface = shader("surface", "UsdPreviewSurface")
    surface.CreateInput("roughness", kinds.Float).Set(1.0)
    colour = surface.CreateInput("diffuseColor", kinds.Color3f)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", kinds.Token))
    if not textured:
        colour.Set(Gf.Vec3f(0.72, 0.66, 0.62))
        return
    reader, texture = shader("uv", "UsdPrimvarReader_float2"), shader("texture", "UsdUVTexture")
    reader.CreateInput("varname", kinds.String).Set("st")
    texture.CreateInput("file", kinds.Asset).Set(Sdf.AssetPath(_TEXTURE))
    texture.CreateInput("sourceColorSpace", kinds.Token).Set("sRGB")
    texture.CreateInput("st", kinds.Float2).ConnectToSource(reader.CreateOutput("result", kinds.Float2))
    colour.ConnectToSource(texture.CreateOutput("rgb", kinds.Float3))


def _joint_paths() -> list[str]:
    """Return the joints' names with those above them, as the format tells the hierarchy."""
    paths: list[str] = []
    for name, parent in zip(JOINT_NAMES, PARENTS, strict=True):
        paths.append(f"{paths[parent]}/{name}" if parent >= 0 else name)
    return paths


def _moved(places: Float[Array, "J 3"]) -> Any:
    from pxr import Gf, Vt

    return Vt.Matrix4dArray([Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*place.tolist())) for place in places])
