#!/usr/bin/env bash
# trimesh: a skinned GLB comes with its mesh node's transform, which glTF says to ignore, and without its joints'.
#
# Guess (2026-11-28): trimesh shows a skinned body in its rest pose, where viewers show it.
# Seen with trimesh 5.2.0: glTF 2.0 (3.7.3.3) places skinned vertices by the joints alone. A body whose mesh node is moved by 9 m, or whose joints are
# scaled by .01 (a rig in centimetres), is 9 m away and a hundred times too large here; no warning, `units` are metres.
# So: apply joint world transform x inverse bind matrix x weights before anything of a skinned GLB is measured.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check trimesh==5.2.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import io
import json
import struct

import numpy as np
import trimesh

VERTICES = np.array([[0, 0, 0], [100, 0, 0], [0, 180, 0]], "<f4")  # centimetres
FACES = np.array([0, 1, 2], "<u2")


def skinned():
    weights, joints = np.tile(np.float32([1, 0, 0, 0]), (3, 1)), np.zeros((3, 4), "u1")
    data, views, accessors = b"", [], []
    for array, component, kind in (
        (VERTICES, 5126, "VEC3"), (FACES, 5123, "SCALAR"), (weights, 5126, "VEC4"), (joints, 5121, "VEC4"),
        (np.eye(4, dtype="<f4").reshape(1, 16), 5126, "MAT4"),
    ):
        data += b"\0" * (-len(data) % 4)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind})
        data += array.tobytes()
    accessors[0] |= {"min": VERTICES.min(0).tolist(), "max": VERTICES.max(0).tolist()}
    data += b"\0" * (-len(data) % 4)
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0, "translation": [9, 0, 0]}, {"name": "hips", "scale": [0.01, 0.01, 0.01]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "WEIGHTS_0": 2, "JOINTS_0": 3}, "indices": 1}]}],
        "skins": [{"joints": [1], "inverseBindMatrices": 4}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(data))
    return head + struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data


scene = trimesh.load(io.BytesIO(skinned()), file_type="glb")
bounds = scene.to_mesh().bounds
print("bounds:", bounds.tolist(), "units:", scene.units, "- by glTF: [0, 0, 0] to [1, 1.8, 0]")
assert np.allclose(bounds, [[9, 0, 0], [109, 180, 0]]) and scene.units == "meters"
print(f"trimesh {trimesh.__version__}: as found")
PY
