#!/usr/bin/env bash
# trimesh: sparse values, normalised integers and default morph weights of a GLB are left out without a word, even where the file requires them.
#
# Guesses (2026-11-28): trimesh applies a sparse accessor, dequantises KHR_mesh_quantization, and applies the mesh's default morph weights.
# Seen with trimesh 5.2.0: a vertex that a sparse accessor moves stays; 16-bit positions of 1 m are 32767 m although `extensionsRequired` names the
# extension (gltfpack writes it); a target of weight 1 is not added.
# So: look at accessors' `sparse` and `normalized`, `extensionsRequired` and `weights` before trusting a loaded GLB, or convert it by another tool.
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

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")


def vertices(arrays, accessors, primitive, strides=(), **more):
    data, views = b"", []
    for number, array in enumerate(arrays):
        data += b"\0" * (-len(data) % 4)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        if number < len(strides):
            views[-1]["byteStride"] = strides[number]
        data += array.tobytes()
    data += b"\0" * (-len(data) % 4)
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive], **more.pop("mesh", {})}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}], **more,
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(data))
    glb = head + struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return trimesh.load(io.BytesIO(glb), file_type="glb").to_mesh().vertices.tolist()


def accessor(view, array, **more):
    columns = np.asarray(array)[:, :3]
    kind = {"f4": 5126, "i2": 5122}[array.dtype.str[1:]]
    return {
        "bufferView": view, "componentType": kind, "count": len(array), "type": "VEC3",
        "min": columns.min(0).tolist(), "max": columns.max(0).tolist(), **more,
    }


moved = np.array([[5, 6, 7]], "<f4")
sparse = {"count": 1, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 2}}
first = accessor(0, CORNERS, sparse=sparse) | {"min": [0, 0, 0], "max": [5, 6, 7]}
found = {"sparse": vertices([CORNERS, np.array([2], "<u2"), moved], [first], {"attributes": {"POSITION": 0}})}
whole = np.array([[0, 0, 0, 0], [32767, 0, 0, 0], [0, 32767, 0, 0]], "<i2")
found["quantised"] = vertices(
    [whole], [accessor(0, whole, normalized=True)], {"attributes": {"POSITION": 0}}, strides=(8,),
    extensionsUsed=["KHR_mesh_quantization"], extensionsRequired=["KHR_mesh_quantization"],
)
target = np.array([[0, 0, 9]] * 3, "<f4")
found["morphed"] = vertices(
    [CORNERS, target], [accessor(0, CORNERS), accessor(1, target)],
    {"attributes": {"POSITION": 0}, "targets": [{"POSITION": 1}]}, mesh={"weights": [1.0]},
)
meant = {"sparse": [[0, 0, 0], [1, 0, 0], [5, 6, 7]], "quantised": CORNERS.tolist(), "morphed": (CORNERS + target).tolist()}
for name, places in found.items():
    print(f"{name}: {places} for {meant[name]}")
assert found["sparse"] == found["morphed"] == CORNERS.tolist(), found
assert found["quantised"] == (CORNERS * 32767).tolist(), found
print(f"trimesh {trimesh.__version__}: as found")
PY
