"""motion.fbx and motion.abc, which Blender makes of motion.glb: the slow motion, on whole frames.

Blender is a program here: the one that ``HFB_BLENDER`` names, that on the path, or its module for Python (`bpy`). Its
exporters sample whole frames only, so true time would lose the sub-frames.
"""

import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hfb.errors import InputError
from hfb.interop.writers.export_names import check_formats, find_blender
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.skinned_glb import write_glb
from hfb.io.atomic import write_bytes_atomic

_PATIENCE_S = 600
_SAID = 300  # characters of its last words
_CONVERT = """
import bpy, sys
source, target, fps = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.render.fps_base = round(float(fps)), round(float(fps)) / float(fps)
bpy.ops.import_scene.gltf(filepath=source)
for shape in [one for one in bpy.data.objects if one.name.startswith("Icosphere")]:
    bpy.data.objects.remove(shape)  # how the importer draws bones
rig = next(one for one in bpy.data.objects if one.type == "ARMATURE")
scene.frame_start, scene.frame_end = map(round, rig.animation_data.action.frame_range)
scene.camera = next(one for one in bpy.data.objects if one.type == "CAMERA")
camera = scene.camera.data
scene.render.resolution_x, scene.render.resolution_y = (width, height) = camera["size_px"]
wide, high = camera["focal_px"]
scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1, high / wide), max(1, wide / high)
aspect = (width / wide) / (height / high)
camera.sensor_width, camera.sensor_fit = aspect * camera.sensor_height, "HORIZONTAL"  # all that FBX knows
camera.shift_x, camera.shift_y = (shift / aspect for shift in camera["lens_shift"])
if target.endswith(".fbx"):  # its readers put time 0 on frame 1
    scene.frame_start, scene.frame_end = 0, scene.frame_end - scene.frame_start
    for one in bpy.data.objects:
        if one.animation_data and one.animation_data.action:
            one.animation_data.nla_tracks.new().strips.new("motion", 0, one.animation_data.action)
            one.animation_data.action = None
    bpy.ops.export_scene.fbx(filepath=target, add_leaf_bones=False, bake_anim_use_all_actions=False,
                             bake_anim_use_nla_strips=False, bake_anim_simplify_factor=0, path_mode="COPY",
                             embed_textures=True)
else:
    bpy.ops.wm.alembic_export(filepath=target, as_background_job=False)
"""


def run_blender(script: str, words: Sequence[str]) -> str:
    """Run a script in Blender without a window and without the user's settings; return what it printed.

    Args:
        script: Python; its arguments are those behind ``--``.
        words: the arguments.

    Raises:
        InputError: there is no Blender, or the script failed in it.
    """
    check_formats(["fbx"])
    program = find_blender()
    assert program is not None
    flags = ["--background", "--factory-startup", "--python-exit-code", "1", "--python-expr"]
    before = ["-c"] if program.name.startswith("python") else flags
    try:
        done = subprocess.run(
            [program, *before, script, "--", *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{program} took longer than {_PATIENCE_S} s: export a shorter part, or glb") from None
    if done.returncode:
        raise InputError(f"{program} could not do it: {(done.stderr or done.stdout).strip()[-_SAID:]}")
    return done.stdout


def write_by_blender(path: Path, exported: Exported) -> None:
    """Write an .fbx or .abc whole or not at all.

    Args:
        path: the file; its suffix tells the format.
        exported: the motion, body and texture; an .abc has no texture.

    Raises:
        InputError: there is no Blender, or it could not write the file.
    """
    with tempfile.TemporaryDirectory() as private:
        source, made = Path(private) / "motion.glb", Path(private) / path.name
        write_glb(source, exported)
        run_blender(_CONVERT, [str(source), str(made), str(exported.fps)])
        if not made.is_file():
            raise InputError(f"Blender wrote no {path.name}: try another version of it")
        write_bytes_atomic(path, made.read_bytes())
