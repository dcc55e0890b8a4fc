"""motion.glb: the person with skin, skeleton, texture and two animations, in real time and in slow motion.

The world is the motion's, in glTF's axes (metres, y up); a level camera is at its origin and looks along -z, as glTF's
own cameras do. One node moves the camera's frame into that world, so that joints and animations below it are those of
motion.npz. Each animation has one key per sub-frame, at its exact time.

A model's pose correctives (SMPL's pose blend shapes) are no part of a skin: joints are exact with such a body, its
surface is that of plain linear blend skinning.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hfb.geometry.placement import y_up
from hfb.interop.writers.gltf import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GlbBuffer
from hfb.interop.writers.keys import MotionKeys, exact_keys, subframe_rate_hz
from hfb.interop.writers.skin import skin_of
from hfb.io.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float, Tensor

_WORLD, _PELVIS = 1, 2  # nodes: the mesh, the camera's frame, then the joints
_SLOW_FPS = 30.0  # in slow motion sub-frames follow at this rate
_CLAMP = 33071
_PLAIN_COLOUR = (0.72, 0.66, 0.62, 1.0)


def slow_factor(motion: SampledMotion) -> float:
    """Return how many times slower the second animation is: one sub-frame per film frame.

    Args:
        motion: camera coordinates.
    """
    return max(1.0, subframe_rate_hz(motion) / _SLOW_FPS)


def skinned_glb(motion: SampledMotion, body: Body, texture_png: bytes | None = None) -> bytes:
    """Return the file's bytes.

    Args:
        motion: camera coordinates.
        body: the model that the motion was fitted with.
        texture_png: the person's texture as an sRGB image; a plain colour where there is none.

    Raises:
        InputError: the motion's instants are not in order.
    """
    keys, placed = exact_keys(motion), y_up(motion.export_world)
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
            "children": [_PELVIS],
        },
        *_joint_nodes(motion, keys, rest),
    ]
    document = {
        "asset": {"version": "2.0", "generator": "hfb", "extras": _facts(motion, body)},
        "scene": 0,
        "scenes": [{"nodes": [0, _WORLD]}],
        "nodes": nodes,
        "meshes": [{"name": body.name, "primitives": [mesh]}],
        "skins": [
            {
                "inverseBindMatrices": buffer.add(bind),
                "skeleton": _PELVIS,
                "joints": list(range(_PELVIS, _PELVIS + JOINT_COUNT)),
            }
        ],
        "materials": [_material(texture_png is not None)],
        "animations": _animations(buffer, keys, rest, slow_factor(motion)),
    }
    if texture_png is not None:
        view = buffer.add_file(texture_png)
        document["images"] = [{"name": "texture", "mimeType": "image/png", "bufferView": view}]
        document["samplers"] = [{"wrapS": _CLAMP, "wrapT": _CLAMP}]
        document["textures"] = [{"source": 0, "sampler": 0}]
    return buffer.glb(document)


def write_glb(path: Path, motion: SampledMotion, body: Body, texture_png: bytes | None = None) -> None:
    """Write the file whole or not at all; see `skinned_glb`.

    Args:
        path: the file.
        motion: camera coordinates.
        body: the model that the motion was fitted with.
        texture_png: the person's texture as an sRGB image; a plain colour where there is none.
    """
    write_bytes_atomic(path, skinned_glb(motion, body, texture_png))


def _facts(motion: SampledMotion, body: Body) -> dict[str, Any]:
    """Return the file's `extras`."""
    return {
        "betas": [round(float(beta), 6) for beta in motion.betas],
        "betas_space": body.betas_space,
        "world": motion.export_world.source,
        "body": body.name,
        "body_licence": body.licence,
        "slow_factor": round(slow_factor(motion), 9),
        "frames": len(np.unique(motion.frame_index)),
        "sub_frames": len(motion.times_s),
    }


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


def _animations(buffer: GlbBuffer, keys: MotionKeys, rest: Float[Array, "24 3"], slow: float) -> list[dict[str, Any]]:
    """Return both animations of the same poses."""
    places = buffer.add(_rows(rest[0] + keys.translations))
    turns = [buffer.add(_rows(np.roll(keys.quaternions[:, joint], -1, -1))) for joint in range(JOINT_COUNT)]
    animations = []
    for name, factor in (("true time", 1.0), (f"slow motion {slow:g}x", slow)):
        at = buffer.add(_rows(keys.times_s * factor), bounds=True)
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
