"""Meshes of single sub-frames, read by trimesh: the posed surface, y up."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from hfb.body.assets import load_default_body
from hfb.config import MeshFormat
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.interop.writers.mesh_files import write_meshes
from hfb.io.media.images.image_io import write_png
from tests.interop.writers.motions import motion_of

BODY = load_default_body()


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_surface(form: MeshFormat, tmp_path: Path) -> None:
    motion = motion_of(BODY, frames=1)
    write_png(tmp_path / "red.png", np.full((4, 4, 3), [1.0, 0.2, 0.2]))
    paths = []
    for path in write_meshes(tmp_path / "meshes", motion, BODY, form, (tmp_path / "red.png").read_bytes()):
        paths.append(path)
        if len(paths) == 2:
            break
    assert [path.name for path in paths] == [f"frame_0000_sub_0{row}.{form}" for row in (0, 1)]
    shaped = BODY.shape(torch.from_numpy(motion.betas).float())
    rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses[1:2]).float().unflatten(1, (24, 3)))
    expected = shaped.pose(rotations, torch.from_numpy(motion.trans[1:2]).float()).vertices[0].numpy() * [1, -1, -1]
    read = trimesh.load(paths[1], process=False, force="mesh")
    corners = np.asarray(read.vertices)[np.asarray(read.faces)]
    assert 1000 * np.linalg.norm(corners - expected[BODY.mesh.faces.numpy()], axis=-1).max() < 0.01
    assert read.is_winding_consistent
    assert read.is_watertight == (form == "ply")  # of .obj trimesh splits the seams
    if form == "ply":
        assert len(read.vertices) == len(BODY.template)
        assert read.volume > 0
        assert b"hfb, metres, y up" in paths[1].read_bytes()[:80]
    else:
        lines = paths[1].read_text().splitlines()
        kinds = [line.partition(" ")[0] for line in lines]
        counts = len(BODY.template), len(BODY.mesh.uv), len(BODY.mesh.faces)
        assert (kinds.count("v"), kinds.count("vt"), kinds.count("f")) == counts
        assert {"mtllib person.mtl", "usemtl person"} <= set(lines)
        image = read.visual.material.image
        assert image is not None
        assert image.getpixel((1, 1))[0] > 200
