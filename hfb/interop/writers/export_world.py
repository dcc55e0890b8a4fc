"""The facts of the world that exports are written in, for result.json and the terminal."""

import numpy as np

from hfb.body.skeleton import JOINT_NAMES
from hfb.config import WorldUp
from hfb.geometry.placement import angles_of_world, in_world, z_up
from hfb.geometry.world import CALIBRATED, WorldFacts
from hfb.motion.footing import FEET, foot_skate_mm, lowest_soles_m
from hfb.motion.sampled import SampledMotion

_PELVIS, _NECK = JOINT_NAMES.index("pelvis"), JOINT_NAMES.index("neck")
_UPRIGHT_DEG = 60.0
_FARTHEST_FEET_M = 5.0  # beyond it a translation is in other units: a board's squares, decimetres
_AXES: tuple[WorldUp, ...] = ("z", "-z", "y", "-y")


def describe_world(motion: SampledMotion) -> WorldFacts:
    """Return the facts of a motion's world.

    Args:
        motion: camera coordinates.
    """
    world = motion.export_world
    (tilt, roll), in_floor = angles_of_world(world), z_up(world)
    trunks = motion.joints[:, _NECK] - motion.joints[:, _PELVIS]
    trunks /= np.linalg.norm(trunks, axis=-1, keepdims=True)
    lean = float(np.degrees(np.median(np.arccos(np.clip(trunks @ in_floor.R[2], -1, 1)))))
    skate = foot_skate_mm(motion, in_floor.R[2])
    angles = f"it looks down by {tilt:.1f} degrees and leans what is upright to the right by {roll:.1f}"
    give = "--camera.tilt-deg and --camera.roll-deg, or a calibration with rotation and translation"
    says = {
        "calibration": f"exports are in the calibration's world, whose {world.up} axis points up",
        "rotation": f"exports are in the calibration's axes, whose {world.up} axis points up, about the camera: the "
        "calibration's translation is not in metres; convert it for its origin",
        "options": f"the camera's direction in exports is as stated: {angles}",
        "person": f"the camera's direction in exports is estimated from the person: {angles}; give {give}",
        "level": f"the camera is taken as level in exports: give {give}",
    }[world.source]
    doubtful = world.source in ("rotation", "person", "level")
    if world.source == "level" and world.floor_source == "plane":
        doubtful, says = False, f"up in exports is the normal of the floor that is given: for the camera {angles}"
    says += {None: "", "plane": "; height 0 is that floor", "feet": "; height 0 is told by the feet"}[
        world.floor_source
    ]
    if lean > _UPRIGHT_DEG and world.source in (*CALIBRATED, "options"):
        doubtful, says = True, f"{says}, and the person's trunk is {lean:.0f} degrees off the vertical"
        along = np.median(trunks @ in_world(world).R.T, axis=0)
        best = max(_AXES, key=lambda axis: (-1 if axis[0] == "-" else 1) * along["xyz".index(axis[-1])])
        if world.source in CALIBRATED and best != world.up:
            says += f": if they stand upright, give --camera.world-up={best}"
    off_m = float(np.median(in_floor.points(motion.joints[:, FEET])[..., 2].min(1)))
    if world.source == "calibration" and abs(off_m) > _FARTHEST_FEET_M:
        doubtful = True
        says += f", and the person's feet are {abs(off_m):.0f} m {'above' if off_m > 0 else 'below'} its origin: "
        says += "give its translation in metres"
    return WorldFacts(
        source=world.source,
        up=world.up,
        tilt_deg=round(tilt, 2),
        roll_deg=round(roll, 2),
        lean_deg=round(lean, 2),
        floor=world.floor_source,
        soles_mm=None if world.floor is None else round(1000 * lowest_soles_m(motion), 1),
        foot_skate_mm=None if skate is None else round(skate, 2),
        says=says,
        doubtful=doubtful,
    )
