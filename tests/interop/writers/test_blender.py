"""motion.glb in Blender itself: play moves the body, and the camera shows it where the picture does."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.evaluation.protocol import pose_rows
from hfb.geometry.placement import world_of_pose, world_of_up
from hfb.geometry.world import World
from hfb.interop.writers.blender import run_blender, write_by_blender
from hfb.interop.writers.export_camera import camera_of
from hfb.interop.writers.export_names import BLENDER, check_formats, find_blender
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.skinned_glb import write_glb
from hfb.motion.sampled import SampledMotion
from hfb.rendering.backends import make_rasterizer
from tests.interop.writers.motions import motion_of
from tests.interop.writers.test_skinned_glb import _PNG

pytestmark = pytest.mark.integration

BODY = load_default_body()
_SCRIPT = Path(__file__).with_name("blender_scene.py")
_HOWTO = Path(__file__).parents[3] / "docs" / "howto" / "blender.md"
_TO_BLENDER = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # of a level camera: z is up, y ahead
_MOST_PX = 0.5
_SIZE = (160, 120)
_K = np.array([[175.0, 0, 80], [0, 175, 60], [0, 0, 1]])
_K_ASKEW = np.array([[175.0, 0, 92], [0, 190, 47], [0, 0, 1]])
_TURNED = Rotation.from_euler("xyz", [112, 17, -40], degrees=True).as_matrix()


def need_blender() -> None:
    if find_blender() is None:
        pytest.skip(f"there is no Blender: {BLENDER} names it, or a Python with bpy")


def seen_in_blender(glb: Path, *frames: int) -> dict[str, Any]:
    """What `blender_scene.py` found; skips where there is no Blender."""
    need_blender()
    _, steps = _HOWTO.read_text().split("```python")
    (glb.parent / "steps.py").write_text(steps.partition("```")[0])
    said = run_blender(_SCRIPT.read_text(), [str(glb), str(glb.parent / "steps.py"), *map(str, frames)])
    (found,) = [line for line in said.splitlines() if line.startswith("FOUND ")]
    return json.loads(found.removeprefix("FOUND "))


def overlap(seen: np.ndarray, motion: SampledMotion, row: int) -> float:
    """IoU of a silhouette and our own render of one row."""
    vertices = pose_rows(motion, np.array([row]), BODY).vertices.detach()
    ours = make_rasterizer().render(vertices, None, camera_of(motion), BODY.mesh)[0, ..., 3].numpy()
    return float(np.minimum(seen, ours).sum() / np.maximum(seen, ours).sum())


@pytest.mark.parametrize(
    ("K", "world"),
    [
        (_K, None),
        (_K, world_of_up(np.array([0.1, -0.9, -0.4]))),
        (_K_ASKEW, world_of_pose(_TURNED, np.array([0.4, -0.7, 2.5]), "z")),
    ],
    ids=["level", "tilted", "calibrated"],
)
def test_play_moves_and_the_camera_overlays(K: np.ndarray, world: World | None, tmp_path: Path) -> None:
    motion = replace(motion_of(BODY, frames=2), K=K, size=_SIZE, world=world)
    write_glb(tmp_path / "motion.glb", Exported(motion, "hfb", BODY, plate="plate.png"))
    Image.new("RGB", _SIZE, "teal").save(tmp_path / "plate.png")
    shown = {1: 0, 8: 7, 20: 15}  # frame of the scene: row of the motion
    found = seen_in_blender(tmp_path / "motion.glb", *shown)

    assert found["scene"] == [found["fps"], 1, 250]  # Blender's own, untouched
    assert found["action"] == "slow motion 14.6x"
    assert found["actions"] == ["slow motion 14.6x", "true time"]
    assert found["keys"] == [*range(1, 9), *range(13, 21)]
    assert tuple(found["background"]) == _SIZE
    for one, (number, row) in zip(found["frames"], shown.items(), strict=True):
        seen = np.array([one["joints_px"][name] for name in JOINT_NAMES])
        projected = motion.joints[row] @ K.T
        assert np.abs(seen - projected[:, :2] / projected[:, 2:]).max() < 0.01
        assert overlap(read_alpha(tmp_path / f"frame_{number}.png"), motion, row) > 0.97
    assert overlap(read_alpha(tmp_path / "frame_1.png"), motion, 15) < 0.9  # it moved


def read_alpha(path: Path) -> np.ndarray:
    """The share of each pixel that is not transparent."""
    return np.asarray(Image.open(path).getchannel("A"), np.float32) / 255


_READ = """
import bpy, json, sys
from bpy_extras.object_utils import world_to_camera_view
name = sys.argv[-1]
bpy.ops.wm.read_factory_settings(use_empty=True)
if name.endswith(".fbx"):
    new = "new" in sys.argv and "fbx_import" in dir(bpy.ops.wm)
    (bpy.ops.wm.fbx_import if new else bpy.ops.import_scene.fbx)(filepath=name)
else:
    bpy.ops.wm.alembic_import(filepath=name)
scene, seen = bpy.context.scene, []
scene.render.resolution_x, scene.render.resolution_y = 160, 120
scene.render.pixel_aspect_x = 190 / 175
(camera,) = [one for one in bpy.data.objects if one.type == "CAMERA"]
(mesh,) = [one for one in bpy.data.objects if one.type == "MESH"]
for frame in (1, 8, 20):
    scene.frame_set(frame)
    shown = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    places = [shown.matrix_world @ vertex.co for vertex in shown.data.vertices]
    seen.append([[*place, *world_to_camera_view(scene, camera, place)] for place in places])
print("FOUND " + json.dumps(seen))
"""


@pytest.mark.parametrize(("name", "reader"), [("motion.fbx", "new"), ("motion.fbx", "legacy"), ("motion.abc", "new")])
def test_files_that_blender_writes(name: str, reader: str, tmp_path: Path) -> None:
    """The surface and how the camera sees it, at its first, a middle and its last frame, read as Blender does it."""
    need_blender()
    motion = replace(motion_of(BODY, frames=2), K=_K_ASKEW, size=_SIZE)
    write_by_blender(tmp_path / name, Exported(motion, "hfb", BODY, _PNG))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    said = run_blender(_READ, [reader, str(tmp_path / name)])
    (found,) = [line for line in said.splitlines() if line.startswith("FOUND ")]
    for values, row in zip(json.loads(found.removeprefix("FOUND ")), (0, 7, 15), strict=True):
        points, views = np.split(np.array(values), 2, axis=1)
        ours = pose_rows(motion, np.array([row]), BODY).vertices[0].detach().double().numpy()
        apart_m, nearest = cKDTree(points).query(ours @ _TO_BLENDER.T)
        assert 1000 * apart_m.max() < 1
        pixels = ours @ _K_ASKEW.T
        seen = views[nearest, :2] * [1, -1] + [0, 1]
        assert np.abs(seen * _SIZE - pixels[:, :2] / pixels[:, 2:]).max() < _MOST_PX


def test_without_blender_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BLENDER, "/nowhere/blender")
    with pytest.raises(InputError, match=f"{BLENDER} names no program: /nowhere/blender"):
        check_formats(["abc"])
    monkeypatch.delenv(BLENDER)
    monkeypatch.setenv("PATH", "/nowhere")
    if importlib.util.find_spec("bpy") is None:
        with pytest.raises(InputError, match=f"need Blender: install it, or name it in {BLENDER}"):
            check_formats(["glb", "fbx"])
    check_formats(["glb"])
