"""The folder opensim/: a model of the person, markers, inverse kinematics and its motion; needs the extra ``opensim``.

The model is the person's own skeleton with the joints' centres as markers. Its bodies are OpenSim's: x ahead, y up, z
to the right in the rest pose, and so are the names of its coordinates where OpenSim's models have them. Knees and
elbows are hinges; the spine bends below the ribs and in their middle.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from hfb.body.skeleton import JOINT_NAMES, PARENTS
from hfb.errors import InputError
from hfb.interop.writers.export_names import check_formats
from hfb.interop.writers.joint_tables import trc_text
from hfb.interop.writers.keys import even_keys, rest_joints, subframe_rate_hz
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool, Float

MODEL, SETUP, MARKERS, MOTION = "model.osim", "ik_setup.xml", "markers.trc", "motion.mot"
OPENSIM_NAMES = (MODEL, SETUP, MARKERS, MOTION)
"""Names of the files."""

_SIDES = {"left": "l", "right": "r"}
_MIDDLE = {"pelvis": "PELV", "spine1": "L3", "spine2": "T12", "spine3": "T8", "neck": "C7", "head": "HEAD"}
_LATERAL = {
    "hip": "HJC",
    "knee": "KJC",
    "ankle": "AJC",
    "foot": "TOE",
    "collar": "CLAV",
    "shoulder": "SJC",
    "elbow": "EJC",
    "wrist": "WJC",
    "hand": "FIN",
}
_X, _Y, _Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
_TURNS: dict[str, tuple[tuple[str, tuple[int, int, int]], ...]] = {
    "spine1": (("lumbar_extension", _Z), ("lumbar_bending", _X), ("lumbar_rotation", _Y)),
    "spine3": (("thorax_extension", _Z), ("thorax_bending", _X), ("thorax_rotation", _Y)),
    "neck": (("neck_extension", _Z), ("neck_bending", _X)),
    "hip": (("hip_flexion", _Z), ("hip_adduction", _X), ("hip_rotation", _Y)),
    "knee": (("knee_angle", (0, 0, -1)),),
    "ankle": (("ankle_angle", _Z), ("subtalar_angle", _X)),
    "collar": (("clavicle_elevation", _X), ("clavicle_protraction", _Y)),
    "shoulder": (("arm_flex", _Y), ("arm_add", _X), ("arm_rot", _Z)),
    "elbow": (("elbow_flex", _Y),),
    "wrist": (("wrist_flex", _Y), ("wrist_dev", _X)),
}
"""Coordinates of a joint, and the axes on the right that they turn about in the rest pose; other joints are welds."""

_MIRRORED = np.array([-1, -1, 1])  # of the axes on the left: the same sign is the same movement
_PELVIS_TURNS = [("pelvis_tilt", _Z), ("pelvis_list", _X), ("pelvis_rotation", _Y)]
_RUN = f"""
import opensim
opensim.Logger.removeFileSink()
opensim.InverseKinematicsTool({SETUP!r}).run()
"""
"""In a process of its own, because OpenSim's solver can end the one that it runs in."""

_MASS_KG = 1.0  # kinematics need none, the format does


def marker_names() -> list[str]:
    """Return the markers' names in the order of the joints."""
    return [_MIDDLE.get(name) or name[0].upper() + _LATERAL[name.partition("_")[2]] for name in JOINT_NAMES]


def write_opensim(folder: Path, motion: SampledMotion) -> None:
    """Write the model, the markers, the set-up and the motion that OpenSim's inverse kinematics finds.

    Args:
        folder: the folder, which exists.
        motion: camera coordinates.

    Raises:
        InputError: the library is missing, or OpenSim finds no motion.
    """
    check_formats(["mot"])
    import opensim

    opensim.Logger.removeFileSink()  # it would leave a log in the working directory
    opensim.Logger.setLevelString("Off")
    (folder / MARKERS).write_text(trc_text(motion, MARKERS, marker_names()))
    model = _model(opensim, rest_joints(motion))
    model.printToXML(str(folder / MODEL))
    keys = even_keys(motion, subframe_rate_hz(motion))
    first, last = _longest_stretch(keys.present)
    tool = opensim.InverseKinematicsTool()
    tool.setName("hfb")
    tool.set_model_file(MODEL)
    tool.set_marker_file(MARKERS)
    tool.set_output_motion_file(MOTION)
    tool.set_report_errors(False)
    tool.set_results_directory(".")
    tool.setStartTime(float(keys.times_s[first]))
    tool.setEndTime(float(keys.times_s[last]))
    for name in marker_names():
        task = opensim.IKMarkerTask()
        task.setName(name)
        task.setApply(True)
        task.setWeight(1.0)
        tool.upd_IKTaskSet().cloneAndAppend(task)
    tool.printToXML(str(folder / SETUP))
    done = subprocess.run(
        [sys.executable, "-P", "-c", _RUN],  # -P: nothing of the folder, which may be somebody else's
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode or not (folder / MOTION).is_file():
        words = (done.stderr.strip().splitlines() or ["no word why"])[-1]
        raise InputError(f"OpenSim's inverse kinematics found no motion ({words}): export trc instead")


def _longest_stretch(present: Bool[Array, "F"]) -> tuple[int, int]:
    """Return the first and the last of the most keys in a row at which the person is there: OpenSim bridges no gap."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], present, [False]]).astype(int))).reshape(-1, 2)
    first, after = edges[np.argmax(edges[:, 1] - edges[:, 0])].tolist()
    return first, after - 1


def _model(opensim: Any, rest: Float[Array, "24 3"]) -> Any:
    """Return the model of a rest pose, which faces +z with its left along +x."""
    places = np.stack([rest[:, 2], rest[:, 1], -rest[:, 0]], 1)
    model = opensim.Model()
    model.setName("hfb")
    bodies: list[Any] = []
    for joint, (name, parent) in enumerate(zip(JOINT_NAMES, PARENTS, strict=True)):
        side, _, part = name.rpartition("_")
        suffix = f"_{_SIDES[side]}" if side else ""
        body = opensim.Body(name, _MASS_KG, opensim.Vec3(0), opensim.Inertia(1, 1, 1))
        above = bodies[parent] if parent >= 0 else model.getGround()
        offset = opensim.Vec3(*(places[joint] - places[parent] if parent >= 0 else np.zeros(3)).tolist())
        frames = (above, offset, opensim.Vec3(0), body, opensim.Vec3(0), opensim.Vec3(0))
        turns = [(f"{one}{suffix}", axis if suffix != "_l" else _MIRRORED * axis) for one, axis in _TURNS.get(part, ())]
        if parent < 0:
            link = _custom(opensim, f"ground_{name}", frames, _PELVIS_TURNS, ("pelvis_tx", "pelvis_ty", "pelvis_tz"))
        elif turns:
            link = _custom(opensim, name + "_joint", frames, turns, ())
        else:
            link = opensim.WeldJoint(name + "_weld", *frames)
        model.addBody(body)
        model.addJoint(link)
        bodies.append(body)
        model.addMarker(opensim.Marker(marker_names()[joint], body, opensim.Vec3(0)))
    model.finalizeConnections()
    return model


def _custom(opensim: Any, name: str, frames: Any, turns: list[tuple[str, Any]], moves: tuple[str, ...]) -> Any:
    """Return a joint that turns about some axes, one after the other, and moves along x, y, z."""
    transform = opensim.SpatialTransform()
    parts = [transform.upd_rotation1(), transform.upd_rotation2(), transform.upd_rotation3()]
    axes = [np.array(axis, float) for _, axis in turns]
    while len(axes) < len(parts):  # axes without a coordinate have to differ from the others too
        axes.append(next(one for one in np.eye(3) if all(abs(one @ other) < 0.5 for other in axes)))
    for number, (part, axis) in enumerate(zip(parts, axes, strict=True)):
        part.setAxis(opensim.Vec3(*axis.tolist()))
        if number < len(turns):
            part.setCoordinateNames(opensim.ArrayStr(turns[number][0], 1))
            part.set_function(opensim.LinearFunction(1, 0))
        else:
            part.set_function(opensim.Constant(0))
    along = [transform.upd_translation1(), transform.upd_translation2(), transform.upd_translation3()]
    for number, part in enumerate(along):
        part.setAxis(opensim.Vec3(*np.eye(3)[number].tolist()))
        if moves:
            part.setCoordinateNames(opensim.ArrayStr(moves[number], 1))
            part.set_function(opensim.LinearFunction(1, 0))
        else:
            part.set_function(opensim.Constant(0))
    return opensim.CustomJoint(name, *frames, transform)
