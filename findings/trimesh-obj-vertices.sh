#!/usr/bin/env bash
# trimesh: `process=False` keeps every vertex of a PLY, but of an OBJ it drops those in no face and splits those with two texture coordinates.
#
# Guess (2026-11-28): `process=False` keeps number and order of the vertices, so that vertex n of a body model stays vertex n.
# Seen with trimesh 5.2.0: PLY 7 of 7. OBJ 6 of 7 (one lay in no face), 5 of 4 with a texture seam. `maintain_order=True` keeps 7 of 7.
# So: give `maintain_order=True` too, and compare the number of vertices, before regressors or weights by vertex are applied to an OBJ.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check trimesh==5.2.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import io

import trimesh

VERTICES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (1, 0, 0), (5, 5, 5), (0, 0, 1)]
FACES = [(0, 1, 2), (0, 2, 3), (4, 6, 0)]
rows = "".join("{} {} {}\n".format(*vertex) for vertex in VERTICES)
ply = f"ply\nformat ascii 1.0\nelement vertex {len(VERTICES)}\nproperty float x\nproperty float y\nproperty float z\n"
ply += f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n{rows}"
ply += "".join("3 {} {} {}\n".format(*face) for face in FACES)
obj = "".join(f"v {row}\n" for row in rows.splitlines())
plain = obj + "".join("f {} {} {}\n".format(*(index + 1 for index in face)) for face in FACES)
seam = "".join(obj.splitlines(True)[:4]) + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .5 .5\nf 1/1 2/2 3/3\nf 1/5 3/3 4/4\n"


def count(text, kind, **options):
    return len(trimesh.load(io.BytesIO(text.encode()), file_type=kind, process=False, **options).vertices)


found = {"ply": count(ply, "ply"), "obj": count(plain, "obj"), "obj with a seam": count(seam, "obj")}
kept = count(plain, "obj", maintain_order=True)
print(found, "obj with maintain_order:", kept)
assert found == {"ply": 7, "obj": 6, "obj with a seam": 5} and kept == 7, (found, kept)
print(f"trimesh {trimesh.__version__}: as found")
PY
