"""An artist opens the body in Blender, looks through the camera, and presses play over the plate."""

import sys
from pathlib import Path

import cv2

import hfb
from hfb.datasets.example import write_example
from hfb.interop.writers.blender import run_blender
from hfb.interop.writers.export_names import find_blender

SHOWN = (1, 4, 8)
IN_BLENDER = """
import bpy, sys

glb, drawn_as, *frames = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=glb)
scene, camera = bpy.context.scene, bpy.data.objects["camera"]
scene.camera, data = camera, camera.data
scene.render.resolution_x, scene.render.resolution_y = data["size_px"]
data.shift_x, data.shift_y = data["lens_shift"]
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.rotation_euler = 3, (0.6, 0.3, 0)
scene.collection.objects.link(sun)
scene.render.engine, scene.cycles.samples, scene.render.film_transparent = "CYCLES", 8, True
for number in map(int, frames):
    scene.frame_set(number)
    scene.render.filepath = drawn_as % number
    bpy.ops.render.render(write_still=True)
"""


def main(out: Path) -> None:
    """Fit the embedded example, render some frames of its GLB in Blender, and lay them over the plate.

    Args:
        out: where results go.
    """
    if find_blender() is None:
        sys.exit("Blender is missing: install it, or name it in HFB_BLENDER (blender, or a Python that has bpy)")
    example = write_example(out / "input")
    hfb.fit(example.frame, example.background).export("glb", folder=out)
    glb, drawn_as = (str((out / name).absolute()) for name in ("motion.glb", "frame_%d.png"))
    run_blender(IN_BLENDER, [glb, drawn_as, *map(str, SHOWN)])

    plate, pictures = cv2.imread(str(out / "motion_plate.png")) / 255.0, []
    for number in SHOWN:
        drawn = cv2.imread(drawn_as % number, cv2.IMREAD_UNCHANGED) / 255.0
        pictures.append(drawn[..., :3] * drawn[..., 3:] + plate * (1 - drawn[..., 3:]))
    cv2.imwrite(str(out / "blender.png"), (255 * cv2.hconcat(pictures)).round().astype("uint8"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
