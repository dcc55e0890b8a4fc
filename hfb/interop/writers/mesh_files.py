"""The surface at every sub-frame as files of its own: .obj with texture, or .ply; metres, the motion's world with y up.

Large (about 1 MB an .obj), hence on request only. Pose correctives of the model are in it, unlike in motion.glb.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from hfb.body.model import Body, ShapedBody
from hfb.config import MeshFormat
from hfb.errors import TemporaryError
from hfb.geometry.placement import y_up
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.io.atomic import write_bytes_atomic
from hfb.io.safe_folder import check_tree, is_regular
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float, Int

_MATERIAL, _TEXTURE = "person.mtl", "texture.png"
_MATERIAL_TEXT = f"newmtl person\nKd 1 1 1\nillum 1\nmap_Kd {_TEXTURE}\n".encode()
_NAME = re.compile(r"frame_\d{4,}_sub_\d{2,}\.(obj|ply)")
_MARK = "hfb, metres, y up"
_TRIMESH_COMMENT = b"comment https://github.com/mikedh/trimesh"


def mesh_name(motion: SampledMotion, row: int, form: MeshFormat) -> str:
    """Return a mesh's file name: ``frame_0003_sub_05.obj`` is the sixth sub-frame of frame 3.

    Args:
        motion: camera coordinates.
        row: row of the motion.
        form: ``obj`` or ``ply``.
    """
    frame = int(motion.frame_index[row])
    return f"frame_{frame:04d}_sub_{row - int(motion.rows_of(frame)[0]):02d}.{form}"


def earlier_meshes(folder: Path, form: MeshFormat) -> list[Path]:
    """Return the meshes of an earlier export: those of a longer one would stay among the new ones.

    Args:
        folder: the folder of the meshes.
        form: ``obj`` or ``ply``.

    Raises:
        TemporaryError: a file of such a name is not from hfb.
    """
    check_tree(folder)
    named = [path for path in sorted(folder.glob(f"frame_*.{form}")) if _NAME.fullmatch(path.name)]
    for path in named:
        if not is_regular(path) or not _is_marked(path):
            raise TemporaryError(f"{path} is not from this version of hfb: move it away, or choose another --out")
    texture = folder / _TEXTURE
    if form == "obj" and texture.exists() and not _is_material(folder / _MATERIAL):
        raise TemporaryError(f"{texture} is not from hfb, and meshes bring one: move it away, or choose another --out")
    return named


def _is_marked(path: Path) -> bool:
    with path.open("rb") as file:
        return _MARK.encode() in file.read(80)


def _is_material(path: Path) -> bool:
    return is_regular(path) and path.stat().st_size == len(_MATERIAL_TEXT) and path.read_bytes() == _MATERIAL_TEXT


def write_meshes(
    folder: Path, motion: SampledMotion, body: Body, form: MeshFormat, texture_png: bytes | None = None
) -> Iterator[Path]:
    """Write one file per sub-frame in place of earlier ones, each whole or not at all; yield each when it is finished.

    Args:
        folder: the folder of the meshes.
        motion: camera coordinates.
        body: model of the motion.
        form: ``obj`` or ``ply``.
        texture_png: the person's texture as an sRGB image; .obj files refer to it.

    Raises:
        TemporaryError: see `earlier_meshes`.
    """
    for earlier in earlier_meshes(folder, form):
        earlier.unlink()
    shaped = body.shape(torch.from_numpy(motion.betas).to(body.template.dtype))
    textured = form == "obj" and texture_png is not None
    if textured:
        assert texture_png is not None
        write_bytes_atomic(folder / _MATERIAL, _MATERIAL_TEXT)  # it marks the texture as ours
        write_bytes_atomic(folder / _TEXTURE, texture_png)
    faces, surface = body.mesh.faces.numpy(), _obj_surface(body, textured)
    for row in range(len(motion.poses)):
        vertices = _posed(shaped, motion, row)
        data = _obj(vertices, surface, textured) if form == "obj" else _ply(vertices, faces)
        path = folder / mesh_name(motion, row, form)
        write_bytes_atomic(path, data)
        yield path


def _posed(shaped: ShapedBody, motion: SampledMotion, row: int) -> Float[Array, "V 3"]:
    dtype = shaped.vertices.dtype
    rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses[row : row + 1]).to(dtype).unflatten(1, (24, 3)))
    with torch.no_grad():
        posed = shaped.pose(rotations, torch.from_numpy(motion.trans[row : row + 1]).to(dtype))
    return y_up(motion.export_world).points(posed.vertices[0].double().numpy())


def _obj_surface(body: Body, textured: bool) -> bytes:
    """Return the constant part: texture coordinates (v = 0 at the bottom in .obj) and faces (counted from 1).

    trimesh is not used, since it has one texture coordinate per vertex: every seam would split the surface, and
    vertices would no longer be the body model's.
    """
    faces = body.mesh.faces.numpy() + 1
    if not textured:
        return "".join(f"f {a} {b} {c}\n" for a, b, c in faces).encode()
    uv = body.mesh.uv.double().numpy()
    corners = np.stack([faces, body.mesh.uv_faces.numpy() + 1], -1).reshape(-1, 6)
    lines = [f"vt {u:.6f} {1 - v:.6f}\n" for u, v in uv]
    return "".join([*lines, "usemtl person\n", *("f {}/{} {}/{} {}/{}\n".format(*row) for row in corners)]).encode()


def _obj(vertices: Float[Array, "V 3"], surface: bytes, textured: bool) -> bytes:
    head = f"# {_MARK}\n" + (f"mtllib {_MATERIAL}\n" if textured else "")
    return (head + "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in vertices)).encode() + surface


def _ply(vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"]) -> bytes:
    import trimesh  # slow to import, and few need it

    content = trimesh.Trimesh(vertices, faces, process=False).export(file_type="ply", vertex_normal=False)
    assert isinstance(content, bytes)  # of another kind of file it may be text, or several files
    return content.replace(_TRIMESH_COMMENT, f"comment {_MARK}".encode(), 1)  # hfb replaces only what it marked
