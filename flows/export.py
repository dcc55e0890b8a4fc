"""A result in the formats of other programs: its motion files; meshes and films on request."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from hfb.body.model import BetasSpace
from hfb.config import AmassRate, Film, FitConfig, MeshFormat, MotionFormat
from hfb.errors import InputError
from hfb.export.files import Exported, write_motion_file
from hfb.export.mesh_files import write_meshes
from hfb.export.motion_file import load_motion
from hfb.export.names import NEEDS_BODY, check_formats
from hfb.render.rasterizer import make_rasterizer
from tasks import progress
from tasks.fitted_body import fitted_body, named_body

MESHES = "meshes"
_MOTION, _TEXTURE, _RESULT = "motion.npz", "texture.png", "result.json"
_PICTURES_BY = FitConfig()  # what draws: wherever the result was computed, this machine has the default


@dataclass(frozen=True)
class _Source:
    """Where a result's files are, and what to call it; files that it may lack are named whether they exist or not.

    Attributes:
        run: what finds its record.
    """

    motion: Path
    texture: Path
    result: Path
    name: str
    run: str


def export_result(
    source: str,
    out: Path | None,
    formats: Sequence[MotionFormat],
    meshes: Sequence[MeshFormat],
    body: Path | None = None,
    amass_rate: AmassRate = 120,
    films: Sequence[Film] = (),
    inputs: Path | None = None,
) -> dict[str, Any]:
    """Write a result's motion in the asked-for formats, and draw the asked-for films of it.

    Args:
        source: a result's folder, a motion file, or a recorded run's id.
        out: where the files go; ``export`` beside the motion when not given.
        body: the model that was fitted; when not given the one that the result names, or the embedded one.
        inputs: where the pictures lie, for films, if they were moved; they are told by their content.

    Returns:
        ``out``, ``files`` (name: bytes), how many ``meshes``, and whose betas they are.

    Raises:
        InputError: there is no such result, it is damaged, a library is missing, the body is not the one fitted, or
            films are asked for and the pictures are gone.
    """
    check_formats(formats)
    with _found(source) as place:
        motion, space = load_motion(place.motion)
        surface = meshes or films or set(formats) & set(NEEDS_BODY)
        model = fitted_body(motion, space, body or named_body(place.result)) if surface else None
        texture = place.texture.read_bytes() if place.texture.is_file() else None
        exported = Exported(motion, cast(BetasSpace, space), model, texture, amass_rate)
        folder = out or (Path("runs") / f"export-{place.name}" if _is_run(source) else place.motion.parent / "export")
        written = _draw_films(folder, films, place, exported, inputs) if films else []
        if formats:
            with progress.step("motion files"):
                written = [write_motion_file(folder, form, exported) for form in formats] + written
        count = sum(_write_meshes(folder / MESHES, form, exported) for form in meshes)
    return {
        "out": str(folder.resolve()), "files": {path.name: path.stat().st_size for path in written}, "meshes": count,
        "sub_frames": len(motion.times_s), "betas_space": space,
    }  # fmt: skip


def _draw_films(
    folder: Path, films: Sequence[Film], place: _Source, exported: Exported, inputs: Path | None
) -> list[Path]:
    """The films; what they need is found before anything is written."""
    from hfb.media.pictures import read_picture_srgb
    from hfb.report.slow_motion import Shot
    from tasks.earlier_result import pictures_of
    from tasks.films import write_film
    from tasks.scene import in_light

    assert exported.body is not None
    if not place.texture.is_file():
        raise InputError(f"films need {_TEXTURE}, which {place.name} lacks: give a result's folder, or a run's id")
    with ExitStack() as stack:
        with progress.step("pictures"):
            seen = stack.enter_context(pictures_of(place.run, inputs))
        shot = Shot(
            motion=exported.motion,
            body=exported.body,
            texture=in_light(read_picture_srgb(place.texture), "srgb", seen.light),
            rasterizer=make_rasterizer("coverage", _PICTURES_BY.rasterizer, _PICTURES_BY.threads),
            camera=seen.camera,
            plate_linear=seen.plate_linear,
            frame_linear=seen.frame_linear,
            light=seen.light,
        )
        written = []
        for film in films:
            with progress.step(f"film ({film})"):
                written.append(write_film(film, shot, folder))
        return written


def _write_meshes(folder: Path, form: MeshFormat, exported: Exported) -> int:
    assert exported.body is not None
    total = len(exported.motion.times_s)
    with progress.step(f"meshes ({form})"):
        paths = write_meshes(folder, exported.motion, exported.body, form, exported.texture_png)
        for number, _ in enumerate(paths, 1):
            progress.advance(number, total)
    return total


def _is_run(source: str) -> bool:
    """Whether nothing lies there, so that a run's id is meant."""
    return not Path(source).exists()


@contextmanager
def _found(source: str) -> Iterator[_Source]:
    """The files of a result; those of a run are fetched for as long as they are needed."""
    path = Path(source)
    if not _is_run(source):
        folder = path if path.is_dir() else path.parent
        motion = path / _MOTION if path.is_dir() else path
        yield _Source(motion, folder / _TEXTURE, folder / _RESULT, folder.resolve().name, str(folder))
        return
    if path.suffix or len(path.parts) > 1:
        raise InputError(f"there is no {source}: give a result's folder, its motion.npz, or a run's id")
    from tasks.stored_runs import fetch_file, find_run, readable_store

    run = find_run(source)
    with tempfile.TemporaryDirectory() as fetched, readable_store():
        if fetch_file(run, _MOTION, Path(fetched)) is None:
            raise InputError(f"run {run.title} has no {_MOTION}: only results of `hfb fit` and `hfb video` have one")
        for name in (_TEXTURE, _RESULT):
            fetch_file(run, name, Path(fetched))
        motion, texture, result = (Path(fetched) / name for name in (_MOTION, _TEXTURE, _RESULT))
        yield _Source(motion, texture, result, run.run_id[:8], run.run_id)
