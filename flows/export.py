"""A result in the formats of other programs: its motion files, and a mesh per sub-frame on request."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from hfb.body.assets import load_body
from hfb.body.model import BetasSpace, Body
from hfb.config import AmassRate, MeshFormat, MotionFormat
from hfb.errors import InputError
from hfb.export.files import Exported, write_motion_file
from hfb.export.keys import rest_joints
from hfb.export.mesh_files import write_meshes
from hfb.export.motion_file import load_motion
from hfb.export.names import NEEDS_BODY, check_formats
from hfb.motion.sampled import SampledMotion
from tasks import progress

MESHES = "meshes"
_MOTION, _TEXTURE, _RESULT = "motion.npz", "texture.png", "result.json"
_SAME_BODY_M = 1e-3
_RESULT_LIMIT_BYTES = 64 << 20


@dataclass(frozen=True)
class _Source:
    """Where a result's files are, and what to call it; files that it may lack are named whether they exist or not."""

    motion: Path
    texture: Path
    result: Path
    name: str


def export_result(
    source: str,
    out: Path | None,
    formats: Sequence[MotionFormat],
    meshes: Sequence[MeshFormat],
    body: Path | None = None,
    amass_rate: AmassRate = 120,
) -> dict[str, Any]:
    """Write a result's motion in the asked-for formats.

    Args:
        source: a result's folder, a motion file, or a recorded run's id.
        out: where the files go; ``export`` beside the motion when not given.
        body: the model that was fitted; when not given the one that the result names, or the embedded one.

    Returns:
        ``out``, ``files`` (name: bytes), how many ``meshes``, and whose betas they are.

    Raises:
        InputError: there is no such result, it is damaged, a library is missing, or the body is not the one fitted.
    """
    check_formats(formats)
    with _found(source) as place:
        motion, space = load_motion(place.motion)
        surface = meshes or set(formats) & set(NEEDS_BODY)
        model = _body_of(motion, space, body or _named_body(place.result)) if surface else None
        texture = place.texture.read_bytes() if place.texture.is_file() else None
        exported = Exported(motion, cast(BetasSpace, space), model, texture, amass_rate)
        folder = out or (Path("runs") / f"export-{place.name}" if _is_run(source) else place.motion.parent / "export")
        with progress.step("motion files"):
            written = [write_motion_file(folder, form, exported) for form in formats]
        count = sum(_write_meshes(folder / MESHES, form, exported) for form in meshes)
    return {
        "out": str(folder.resolve()), "files": {path.name: path.stat().st_size for path in written}, "meshes": count,
        "sub_frames": len(motion.times_s), "betas_space": space,
    }  # fmt: skip


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
        yield _Source(motion, folder / _TEXTURE, folder / _RESULT, folder.name)
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
        yield _Source(Path(fetched) / _MOTION, Path(fetched) / _TEXTURE, Path(fetched) / _RESULT, run.run_id[:8])


def _named_body(result: Path) -> Path | None:
    """The body model that result.json names; None where it names none or cannot be read."""
    try:
        if result.stat().st_size > _RESULT_LIMIT_BYTES:
            return None
        named = json.loads(result.read_bytes())["config"]["body"]["model"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Path(named) if isinstance(named, str) else None


def _body_of(motion: SampledMotion, space: str, path: Path | None) -> Body:
    """The body model that a motion was fitted with.

    Raises:
        InputError: it is a SMPL file that is not given, or another one is.
    """
    if path is None and space == "smpl":
        raise InputError("this motion was fitted with a SMPL file: give it with --body for formats with a surface")
    body = load_body(path)
    betas = torch.from_numpy(motion.betas).to(body.template.dtype)
    if body.betas_space != space or body.shape_count < len(motion.betas):
        raise InputError(
            f"the betas of this motion are {space}'s, and {body.name} has others: give the body that was fitted"
        )
    fitted = body.rest_joints(betas).double().numpy()
    far = float(np.abs(fitted - rest_joints(motion)).max())
    if far > _SAME_BODY_M:
        raise InputError(f"{body.name} is not the body that was fitted (joints {1000 * far:.0f} mm off): give that one")
    return body
