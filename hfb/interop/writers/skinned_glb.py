"""motion.glb: the person with skin, skeleton, texture, camera and two animations, in slow motion and in real time.

The world is the motion's, in glTF's axes (metres, y up); a level camera is at its origin and looks along -z, as glTF's
own cameras do. One node moves the camera's frame into that world, so that joints and animations below it are those of
motion.npz. Each animation has one key per sub-frame: in slow motion, which programs play first, on whole frames of a
chosen rate from frame 1 on, as programs count them; in real time at its exact instant.

A model's pose correctives (SMPL's pose blend shapes) are no part of a skin: joints are exact with such a body, its
surface is that of plain linear blend skinning.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hfb.geometry.placement import y_up
from hfb.interop.writers.export_camera import NEAR_M, aspect_ratio, camera_of, far_m, field_of_view, lens_shift
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.gltf import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GlbBuffer
from hfb.interop.writers.keys import MotionKeys, exact_keys, subframe_rate_hz
from hfb.interop.writers.skin import skin_of
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float, Tensor

_WORLD, _PELVIS = 1, 2  # nodes: the mesh, the camera's frame, then the joints
_CAMERA = _PELVIS + JOINT_COUNT
_NEAREST = 0.4999  # halves of frames go down, whatever their rounding errors
_HALF_TURN = [1.0, 0.0, 0.0, 0.0]  # about x: glTF's cameras look along -z with y up
_CLAMP = 33071
_PLAIN_COLOUR = (0.72, 0.66, 0.62, 1.0)


def slow_factor(motion: SampledMotion, fps: float) -> float:
    """Return how many times slower the slow animation is: one sub-frame per film frame.

    Args:
        motion: camera coordinates.
        fps: film frames per second.
    """
    return max(1.0, subframe_rate_hz(motion) / fps)


def slow_frames(times_s: Float[Array, "F"], rate_hz: float) -> Float[Array, "F"]:
    """Return the whole frame of each key, from 1 on: the nearest that none before it has.

    Args:
        times_s: increasing instants of the keys.
        rate_hz: frames per second of the motion's own time.
    """
    nearest = np.floor((times_s - times_s[0]) * rate_hz + _NEAREST)
    order = np.arange(len(nearest))
    return 1 + np.maximum.accumulate(nearest - order) + order


def skinned_glb(exported: Exported) -> bytes:
    """Return the file's bytes.

    Args:
        exported: the motion, body and texture; slow motion has its keys on whole frames of its rate.

    Raises:
        InputError: the motion's instants are not in order, or its K has no focal length.
    """
    motion, body, fps = exported.motion, exported.surface, exported.fps
    keys, placed = exact_keys(motion), y_up(motion.export_world)
    slow = slow_factor(motion, fps)
    times_s = {
        f"slow motion {round(slow, 1):g}x": slow_frames(keys.times_s, slow * fps) / fps,
        "true time": keys.times_s,
    }
    buffer = GlbBuffer()
    betas = torch.from_numpy(motion.betas).to(body.template.dtype)
    rest = body.rest_joints(betas).double().numpy()
    mesh = _mesh(buffer, body, betas)
    bind = np.tile(np.eye(4, dtype=np.float32), (JOINT_COUNT, 1, 1))
    bind[:, 3, :3] = -rest  # matrices lie by columns
    nodes = [
        {"name": body.name, "mesh": 0, "skin": 0},
        {
            "name": "camera_frame",
            "rotation": np.roll(placed.quaternion(), -1).tolist(),
            "translation": placed.t.tolist(),
            "children": [_PELVIS, _CAMERA],
        },
        *_joint_nodes(motion, keys, rest),
        {"name": "camera", "camera": 0, "rotation": _HALF_TURN},
    ]
    document = {
        "asset": {"version": "2.0", "generator": "hfb", "extras": _facts(motion, body, fps)},
        "scene": 0,
        "scenes": [{"nodes": [0, _WORLD]}],
        "nodes": nodes,
        "cameras": [_camera(motion, fps, exported.plate)],
        "meshes": [{"name": body.name, "primitives": [mesh]}],
        "skins": [
            {
                "inverseBindMatrices": buffer.add(bind),
                "skeleton": _PELVIS,
                "joints": list(range(_PELVIS, _PELVIS + JOINT_COUNT)),
            }
        ],
        "materials": [_material(exported.texture_png is not None)],
        "animations": _animations(buffer, keys, rest, times_s),
    }
    if exported.texture_png is not None:
        view = buffer.add_file(exported.texture_png)
        document["images"] = [{"name": "texture", "mimeType": "image/png", "bufferView": view}]
        document["samplers"] = [{"wrapS": _CLAMP, "wrapT": _CLAMP}]
        document["textures"] = [{"source": 0, "sampler": 0}]
    return buffer.glb(document)


def write_glb(path: Path, exported: Exported) -> None:
    """Write the file whole or not at all; see `skinned_glb`.

    Args:
        path: the file.
        exported: the motion, body and texture.
    """
    write_bytes_atomic(path, skinned_glb(exported))


def _facts(motion: SampledMotion, body: Body, fps: float) -> dict[str, Any]:
    """Return the file's `extras`."""
    return {
        "betas": [round(float(beta), 6) for beta in motion.betas],
        "betas_space": body.betas_space,
        "world": motion.export_world.source,
        "body": body.name,
        "body_licence": body.licence,
        "fps": fps,
        "slow_factor": round(slow_factor(motion, fps), 9),
        "frames": len(np.unique(motion.frame_index)),
        "sub_frames": len(motion.times_s),
    }


def _camera(motion: SampledMotion, fps: float, plate: str | None) -> dict[str, Any]:
    """Return the camera; its `extras` are what glTF has no words for, one property each in Blender."""
    camera = camera_of(motion)
    extras: dict[str, Any] = {
        "size_px": [camera.width, camera.height],
        "focal_px": [camera.fx, camera.fy],
        "principal_point_px": [camera.cx, camera.cy],
        "lens_shift": list(lens_shift(camera)),
        "fps": fps,
    }
    view = {"yfov": field_of_view(camera), "aspectRatio": aspect_ratio(camera), "znear": NEAR_M, "zfar": far_m(motion)}
    extras |= {"background": plate} if plate else {}
    return {"name": "camera", "type": "perspective", "perspective": view, "extras": extras}


def _mesh(buffer: GlbBuffer, body: Body, betas: Float[Tensor, "K"]) -> dict[str, Any]:
    """Add the person in the rest pose and return the mesh's primitive."""
    skin = skin_of(body, betas)
    attributes = {
        "POSITION": buffer.add(skin.vertices, ARRAY_BUFFER, bounds=True),
        "NORMAL": buffer.add(skin.normals, ARRAY_BUFFER),
        "TEXCOORD_0": buffer.add(skin.uv, ARRAY_BUFFER),
    }
    for number, (joints, weights) in enumerate(zip(skin.joints, skin.weights, strict=True)):
        attributes[f"JOINTS_{number}"] = buffer.add(joints, ARRAY_BUFFER)
        attributes[f"WEIGHTS_{number}"] = buffer.add(weights, ARRAY_BUFFER)
    return {"attributes": attributes, "indices": buffer.add(skin.corners, ELEMENT_ARRAY_BUFFER), "material": 0}


def _joint_nodes(motion: SampledMotion, keys: MotionKeys, rest: Float[Array, "24 3"]) -> list[dict[str, Any]]:
    """Return the skeleton, posed as in the first sub-frame."""
    radius = motion.joint_radius_mm
    nodes: list[dict[str, Any]] = []
    for joint, (name, parent) in enumerate(zip(JOINT_NAMES, PARENTS, strict=True)):
        offset = rest[0] + keys.translations[0] if parent < 0 else rest[joint] - rest[parent]
        node: dict[str, Any] = {
            "name": name,
            "translation": offset.tolist(),
            "rotation": np.roll(keys.quaternions[0, joint], -1).tolist(),
        }
        children = [_PELVIS + child for child, above in enumerate(PARENTS) if above == joint]
        if children:
            node["children"] = children
        if radius is not None and np.isfinite(radius[:, joint]).any():
            known = radius[np.isfinite(radius[:, joint]), joint]
            node["extras"] = {
                "joint_radius_mm": {"mean": round(float(known.mean()), 2), "max": round(float(known.max()), 2)}
            }
        nodes.append(node)
    return nodes


def _animations(
    buffer: GlbBuffer, keys: MotionKeys, rest: Float[Array, "24 3"], times_s: Mapping[str, Float[Array, "F"]]
) -> list[dict[str, Any]]:
    """Return animations of the same poses, each with instants of its own."""
    places = buffer.add(_rows(rest[0] + keys.translations))
    turns = [buffer.add(_rows(np.roll(keys.quaternions[:, joint], -1, -1))) for joint in range(JOINT_COUNT)]
    animations = []
    for name, instants in times_s.items():
        at = buffer.add(_rows(instants), bounds=True)
        channels = [(_PELVIS, "translation", places)]
        channels += [(_PELVIS + joint, "rotation", turn) for joint, turn in enumerate(turns)]
        animations.append(
            {
                "name": name,
                "channels": [
                    {"sampler": number, "target": {"node": node, "path": path}}
                    for number, (node, path, _) in enumerate(channels)
                ],
                "samplers": [{"input": at, "output": output, "interpolation": "LINEAR"} for _, _, output in channels],
            }
        )
    return animations


def _material(textured: bool) -> dict[str, Any]:
    surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    surface |= {"baseColorTexture": {"index": 0}} if textured else {"baseColorFactor": list(_PLAIN_COLOUR)}
    return {"name": "person", "pbrMetallicRoughness": surface}


def _rows(values: Float[Array, "F *c"]) -> Float[Array, "F *c"]:
    return values.astype(np.float32)
