"""Run by Blender's Python: opens a .glb and prints what an artist would find there, as one line of JSON.

Arguments behind ``--``: the file, the steps of docs/howto/blender.md, the frames to look at. Pictures go beside it.
"""

import json
import sys
from pathlib import Path

import bpy
from bpy_extras.object_utils import world_to_camera_view

glb, steps, *numbers = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
bpy.ops.import_scene.gltf(filepath=glb)
armature = next(one for one in bpy.data.objects if one.type == "ARMATURE")
(camera,) = [one for one in bpy.data.objects if one.type == "CAMERA"]

exec(Path(steps).read_text().replace("RESULT", str(Path(glb).parent)))  # of docs/howto/blender.md

scene.render.engine = "CYCLES"
scene.cycles.samples = 16
scene.render.film_transparent = True
width, height = camera.data["size_px"]
found = {"frames": []}
for number in map(int, numbers):
    scene.frame_set(number)
    pixels = {}
    for bone in armature.pose.bones:
        x, y, _ = world_to_camera_view(scene, camera, armature.matrix_world @ bone.head)
        pixels[bone.name] = [x * width, (1 - y) * height]
    found["frames"].append({"number": number, "joints_px": pixels})
    scene.render.filepath = str(Path(glb).with_name(f"frame_{number}.png"))
    bpy.ops.render.render(write_still=True)
action = armature.animation_data.action
curves = [
    curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves
]
found |= {
    "action": action.name,
    "keys": sorted({point.co[0] for curve in curves for point in curve.keyframe_points}),
    "actions": [one.name for one in bpy.data.actions],
    "scene": [scene.render.fps, scene.frame_start, scene.frame_end],
    "background": camera.data.background_images[0].image.size[:],
    "fps": camera.data["fps"],
}
print("FOUND " + json.dumps(found))
