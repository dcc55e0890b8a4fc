"""Export a result in the formats of other programs: motion files, meshes and films."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from hfb.body.model import BetasSpace
from hfb.config import AmassRate, CameraConfig, CsvFrame, ExportConfig, Film, MeshFormat, MotionFormat, WorldUp
from hfb.errors import InputError
from hfb.geometry.placement import with_floor
from hfb.geometry.world import CALIBRATED, World
from hfb.interop.writers.export_names import FILE_NAMES, FILM_NAMES, NEEDS_BODY, PLATE, RESULT, check_formats
from hfb.interop.writers.export_world import describe_world
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.mesh_files import earlier_meshes, write_meshes
from hfb.interop.writers.motion_exports import write_motion_file
from hfb.interop.writers.opensim_files import OPENSIM_NAMES, write_opensim
from hfb.io.atomic import write_bytes_atomic
from hfb.io.clip import Clip, read_clip
from hfb.io.media.images.image_io import stored_png
from hfb.io.media.lens.camera_pose import clip_world, pose_remarks
from hfb.io.safe_folder import check_tree
from hfb.motion.footing import floor_fault, stand
from hfb.motion.motion_file import load_motion
from hfb.motion.sampled import SampledMotion
from hfb.tasks.inputs.out_place import check_no_clip
from hfb.tasks.results.resolve_result import TEXTURE, FoundResult, find_named_body, load_fitted_body, resolve_result
from hfb.tasks.results.workspace import beside_result
from hfb.tasks.telemetry import progress

MESHES, _OPENSIM = "meshes", "opensim"
_FOLDER = "export"
_UNKNOWN = CameraConfig()


def export_result(
    source: str,
    out: Path | None,
    formats: Sequence[MotionFormat],
    meshes: Sequence[MeshFormat],
    *,
    body: Path | None = None,
    amass_rate: AmassRate = 120,
    films: Sequence[Film] = (),
    inputs: Path | None = None,
    csv_frame: CsvFrame = "camera",
    fps: float = ExportConfig().fps,
    camera: CameraConfig = _UNKNOWN,
    clip: Path | None = None,
    opensim: bool = False,
) -> dict[str, Any]:
    """Write a result's motion in several formats, and draw films of it.

    Args:
        source: a result's folder, a motion file, or a recorded run's id.
        out: where the files go; None for ``export`` beside the motion.
        formats: of motion files.
        meshes: of a mesh per sub-frame.
        body: the model that was fitted; None for the one that the result names, or the embedded one.
        amass_rate: poses per second in amass.npz.
        films: which.
        inputs: where to look for images that were moved; they are recognised by their content.
        csv_frame: coordinates in joints.csv.
        fps: frames per second of the program that opens motion.glb.
        camera: how the camera stands in the world, where the result does not know it, or is wrong.
        clip: a clip.toml that tells the same.
        opensim: run OpenSim's inverse kinematics; its files go into ``opensim`` below.

    Returns:
        ``out``, ``files`` (name: bytes), how many ``meshes``, whose betas they are, and whose ``world``.

    Raises:
        InputError: there is no such result, it is damaged, a library is missing, the body is not the one fitted, films
            are asked for and the images are gone, or somebody else's files lie where meshes belong.
    """
    check_formats([*formats, *(["mot"] if opensim else [])])
    with resolve_result(source, (TEXTURE, PLATE, RESULT)) as place:
        motion, space = load_motion(place.motion)
        told = read_clip(clip) if clip else Clip()
        world = clip_world(camera, told.camera, told.video.name if told.video else "")
        for remark in pose_remarks(told.camera, told.video.name if told.video else ""):
            progress.say(f"hfb: {remark}")
        world = with_floor(_with_up(world or motion.world, camera.world_up), camera.floor or told.camera.floor)
        motion = stand(replace(motion, world=world))
        surface = meshes or films or set(formats) & set(NEEDS_BODY)
        model = load_fitted_body(motion, space, body or find_named_body(place.files / RESULT)) if surface else None
        texture = stored_png(place.files / TEXTURE) if (place.files / TEXTURE).exists() else None
        plate = None
        if set(formats) & set(NEEDS_BODY) and (place.files / PLATE).exists():
            plate = stored_png(place.files / PLATE)
        exported = Exported(
            motion, cast(BetasSpace, space), model, texture, amass_rate, csv_frame, fps, PLATE if plate else None
        )
        folder = out or place.new_folder("export", place.folder / _FOLDER)
        if out is None and place.fetched is None:
            check_tree(place.folder, _FOLDER)  # nobody's link may lead the files elsewhere
        check_no_clip(folder)
        check_tree(folder, MESHES)
        check_tree(folder, _OPENSIM)
        for form in meshes:
            earlier_meshes(folder / MESHES, form)  # what is in their way is said before anything is written
        names = [
            *(FILE_NAMES[form] for form in formats),
            *(FILM_NAMES[film] for film in films),
            *([PLATE] if plate else []),
        ]
        with beside_result(folder, names) as target:
            written = _draw_films(target, films, place, exported=exported, inputs=inputs) if films else []
            if formats:
                with progress.step("motion files"):
                    written = [write_motion_file(target, form, exported) for form in formats] + written
            if plate:
                write_bytes_atomic(target / PLATE, plate)
                written.append(target / PLATE)
        of_opensim = _write_opensim(folder / _OPENSIM, motion) if opensim else {}
        count = sum(_write_meshes(folder / MESHES, form, exported) for form in meshes)
    facts = describe_world(motion)
    if facts.doubtful or facts.floor:
        progress.say(f"hfb: {facts.says}")
    if fault := floor_fault(motion):
        progress.say(f"hfb: {fault}")
    return {
        "out": str(folder.resolve()),
        "meshes": count,
        "files": {path.name: (folder / path.name).stat().st_size for path in written} | of_opensim,
        "sub_frames": len(motion.times_s),
        "betas_space": space,
        "world": facts.model_dump(),
    }


def _with_up(world: World | None, up: WorldUp | None) -> World | None:
    """Return a world with the axis that the user says is up. Raises InputError where it is no calibration's."""
    if up is None:
        return world
    if world is None or world.source not in CALIBRATED:
        raise InputError("--world-up is an axis of a calibration's world: give --clip with rotation and translation")
    return world.model_copy(update={"up": up})


def _draw_films(
    folder: Path, films: Sequence[Film], place: FoundResult, *, exported: Exported, inputs: Path | None
) -> list[Path]:
    """Draw the films; their inputs are located before anything is written."""
    from hfb.tasks.results.exports import write_film
    from hfb.tasks.results.reload_inputs import reload_shot

    assert exported.body is not None
    texture = place.files / TEXTURE
    if not texture.is_file():
        raise InputError(f"films need {TEXTURE}, which {place.name} lacks: give a result's folder, or a run's id")
    with ExitStack() as stack:
        with progress.step("pictures"):
            shot = stack.enter_context(
                reload_shot(place.run_words, inputs, motion=exported.motion, body=exported.body, texture=texture)
            )
        written = []
        for film in films:
            with progress.step(f"film ({film})"):
                written.append(write_film(film, shot, folder))
        return written


def _write_opensim(folder: Path, motion: SampledMotion) -> dict[str, int]:
    """Write OpenSim's files; return their sizes by name."""
    with progress.step("OpenSim"), beside_result(folder, OPENSIM_NAMES) as target:
        write_opensim(target, motion)
    return {f"{folder.name}/{name}": (folder / name).stat().st_size for name in OPENSIM_NAMES}


def _write_meshes(folder: Path, form: MeshFormat, exported: Exported) -> int:
    assert exported.body is not None
    total = len(exported.motion.times_s)
    with progress.step(f"meshes ({form})"):
        paths = write_meshes(folder, exported.motion, exported.body, form, exported.texture_png)
        for number, _ in enumerate(paths, 1):
            progress.advance(number, total)
    return total
