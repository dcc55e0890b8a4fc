"""An artist opens the body in Blender, looks through the camera, and presses play over the plate."""

import json
import subprocess
import sys
from pathlib import Path

import cv2

import hfb
from hfb.datasets.example import write_example
from hfb.interop.writers.export_names import find_blender

SHOWN = (1, 4, 8)
IN_BLENDER = """
import bpy, json, sys
from pathlib import Path

given = json.loads(GIVEN)
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=given["glb"])
scene, camera = bpy.context.scene, bpy.data.objects["camera"]
scene.camera, data = camera, camera.data
scene.render.resolution_x, scene.render.resolution_y = data["size_px"]
data.shift_x, data.shift_y = data["lens_shift"]
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.rotation_euler = 3, (0.6, 0.3, 0)
scene.collection.objects.link(sun)
scene.render.engine, scene.cycles.samples, scene.render.film_transparent = "CYCLES", 8, True
for number in given["frames"]:
    scene.frame_set(number)
    scene.render.filepath = given["out"] % number
    bpy.ops.render.render(write_still=True)
"""


def main(out: Path) -> None:
    """Fit the embedded example, render some frames of its GLB in Blender, and lay them over the plate.

    Args:
        out: where results go.
    """
    program = find_blender()
    if program is None:
        sys.exit("Blender is missing: install it, or name it in HFB_BLENDER (blender, or a Python that has bpy)")
    example = write_example(out / "input")
    hfb.fit(example.frame, example.background).export("glb", folder=out)
    glb, drawn_as = (out / name for name in ("motion.glb", "frame_%d.png"))
    given = {"glb": str(glb.absolute()), "frames": SHOWN, "out": str(drawn_as.absolute())}
    script = out / "in_blender.py"
    script.write_text(IN_BLENDER.replace("GIVEN", repr(json.dumps(given))))
    with_module = program.name.startswith("python")
    options = [str(script)] if with_module else ["--background", "--python-exit-code", "1", "--python", str(script)]
    subprocess.run([str(program), *options], check=True, stdout=subprocess.DEVNULL)

    plate, pictures = cv2.imread(str(out / "motion_plate.png")) / 255.0, []
    for number in SHOWN:
        drawn = cv2.imread(str(drawn_as) % number, cv2.IMREAD_UNCHANGED) / 255.0
        pictures.append(drawn[..., :3] * drawn[..., 3:] + plate * (1 - drawn[..., 3:]))
    cv2.imwrite(str(out / "blender.png"), (255 * cv2.hconcat(pictures)).round().astype("uint8"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
