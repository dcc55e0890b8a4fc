"""The parts of a result, whole, and everything that hfb makes of one that somebody damaged."""

import importlib.util
import json
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from hfb.body.assets import load_default_body
from hfb.body.skeleton import PARENTS
from hfb.evaluation.motion_difference import motion_difference
from hfb.fitting.alternatives import Alternatives, direction_record, load_alternatives, save_alternatives
from hfb.interop.readers.sniff import read_tracks
from hfb.interop.writers.amass import amass_arrays
from hfb.interop.writers.bvh import bvh_text
from hfb.interop.writers.c3d_file import c3d_bytes
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.joint_tables import csv_text, trc_text
from hfb.interop.writers.mesh_files import mesh_name
from hfb.interop.writers.skinned_glb import skinned_glb
from hfb.motion.motion_file import load_motion, save_motion
from hfb.motion.sampled import SampledMotion
from hfb.report.films.slow_motion import film_instants, overlay_rate, picture_count
from hfb.report.pages.result_curves import curve_charts, read_curves
from hfb.report.pages.result_facts import read_facts
from hfb.tasks.batch.batch_summary import BatchSummary
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.results.resolve_result import find_named_body
from hfb.tasks.results.result_report import ReportParts, page_text

FACTS: dict[str, Any] = {
    "matte_iou": 0.91,
    "psnr_db": 31.5,
    "mpjpe_mm": None,
    "frames": 2,
    "sub_frames": 6,
    "fit_seconds": 3.5,
    "seconds": 9.25,
    "gaps": [[3, 5]],
    "filled": [1],
    "background": "the median over time",
    "remarks": ["a remark"],
    "directions": [{"right": {"body": 0.6, "torso": None}, "given_body": {"torso": 0.9}}],
    "unknown": "One blurred picture does not tell.",
    "out": "/results/walk",
    "mlflow_run_id": "ab" * 16,
    "mlflow_link": "http://127.0.0.1:5000/#/experiments/1/runs/ab",
    "inputs": {"frame_0": "0" * 64},
    "config": {"fit": {"height_m": 1.8, "stages": [{"iterations": 4}, {"iterations": 2}]}, "body": {"model": None}},
    "people": [{"name": "person 1", "error": None, "out": "/results/walk/person-1", "frames": 2, "gaps": []}],
    "files": ["motion.npz", "strip.png"],
    "code": "1.0",
}
CURVES = {
    "losses": {"total": [3.0, 2.5, 2.0, 1.5, 1.25], "matte": [0.5, 0.4, None, 0.2, 0.1]},
    "windows": [{"frames": [0, 1], "total": [2.0, 1.0]}, {"frames": [1, 2], "total": [3.0]}],
    "frames": {"matte_iou": [[0, 0.9], [1, 0.95]], "psnr_db": [[0, 30.0], [1, 31.0]]},
}
_load_body = lru_cache(maxsize=1)(load_default_body)


@cache
def whole_motion(gap: int = 0) -> SampledMotion:
    """Two frames of three sub-frames of the embedded body, with so many frames without a person between them."""
    rng, body = np.random.default_rng(5), _load_body()
    rest = body.rest_joints(body.template.new_zeros(10)).double().numpy()
    frame = np.repeat([0, 1 + gap], 3)
    return SampledMotion(
        poses=np.zeros((6, 72)), trans=(trans := rng.normal(0, 0.1, (6, 3)) + [0, 0, 4]), betas=np.zeros(10),
        joints=rest + trans[:, None], times_s=frame / 30 + np.tile([0, 0.01, 0.02], 2), frame_index=frame,
        K=np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), joint_radius_mm=np.full((6, len(PARENTS)), 20.0),
    )  # fmt: skip


def write_result(folder: Path) -> Iterator[tuple[str, Path]]:
    """(kind, file) of every part of a result."""
    folder.mkdir(parents=True, exist_ok=True)
    motion = whole_motion()
    several = np.stack([motion.joints, motion.joints[::-1]])
    others = Alternatives(
        reversed_limbs=np.array([[[False] * 5] * 2, [[True] * 5] * 2]),
        poses=np.zeros((2, 6, 72)),
        trans=np.stack([motion.trans, motion.trans[::-1]]),
        joints=several,
        probability=np.array([0.7, 0.3]),
        chosen=0,
        scores={"loss": np.array([1.0, 2.0]), "image": np.array([0.1, 0.2])},
        frame_index=np.repeat(np.arange(2), 3),
    )
    save_motion(folder / "motion.npz", motion, "hfb")
    save_motion(folder / "motion_with_a_gap.npz", whole_motion(1000), "hfb")
    save_alternatives(folder / "alternatives.npz", others, {"reach": np.ones((6, 24))})
    (folder / "result.json").write_text(json.dumps(FACTS))
    (folder / "curves.json").write_text(json.dumps(CURVES))
    Image.fromarray(np.random.default_rng(3).integers(0, 255, (40, 160, 3), np.uint8)).save(folder / "strip.png")
    for kind, name in (
        ("moving", "motion.npz"),
        ("moving", "motion_with_a_gap.npz"),
        ("alternatives", "alternatives.npz"),
        ("facts", "result.json"),
        ("curves", "curves.json"),
        ("strip", "strip.png"),
    ):
        yield kind, folder / name


def _page(**damaged: Path) -> None:
    """The result's page with one of its parts damaged, and the others whole; charts take long and are drawn for two."""
    folder = Path("whole")
    if not (folder / "no_curves.json").exists():
        list(write_result(folder))
        (folder / "no_curves.json").write_text("{}")
    names = {
        "motion": "motion.npz",
        "curves": "no_curves.json",
        "alternatives": "alternatives.npz",
        "strip": "strip.png",
    }
    paths = {part: damaged.get(part, folder / name) for part, name in names.items()}
    if "motion" in damaged:
        del paths["alternatives"]  # they would be another motion's
    if "facts" in damaged:
        paths["curves"] = folder / "curves.json"
    facts = read_facts(damaged.get("facts", folder / "result.json"))
    parts = ReportParts(**{part: FileHandle.of(path) for part, path in paths.items()})
    page_text(parts, _load_body(), facts, {}, name="walk").encode()


def _batch(path: Path) -> None:
    """A batch's page with a clip whose result.json or strip this is: its trouble is a row of the page."""
    out = Path("batch")
    folder = out / "walk"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("result.json", "strip.png"):
        (folder / name).write_bytes((path if path.name == name else Path("whole") / name).read_bytes())
    summary = BatchSummary("Clips of fuzz", out, out / "thumbnails")
    summary.show_all([("walk", "done", "", None), ("wave", "new", "", None)])
    assert summary.counts().done + summary.counts().set_aside == 1
    assert (out / "summary.html").stat().st_size < 5 << 20


def _exports(path: Path) -> None:
    motion, _ = load_motion(path)
    csv_text(motion)
    skinned_glb(Exported(motion, "hfb", _load_body()))
    mesh_name(motion, len(motion.poses) - 1, "obj")
    bvh_text(motion)
    trc_text(motion)
    amass_arrays(motion, "hfb")
    if importlib.util.find_spec("c3d"):
        c3d_bytes(motion)


def _films(path: Path) -> None:
    motion, _ = load_motion(path)
    film_instants(motion)
    overlay_rate(motion)
    picture_count(motion, "exact")
    picture_count(motion, "overlay")


def _difference(path: Path) -> None:
    motion, _ = load_motion(path)
    motion_difference(motion, whole_motion())
    motion_difference(whole_motion(), motion)


RESULT_READERS: dict[str, tuple[Callable[[Path], Any], ...]] = {
    "moving": (
        _exports,
        _films,
        _difference,
        lambda path: _page(motion=path),
        lambda path: read_tracks([path], 480, 640),
    ),
    "alternatives": (
        lambda path: direction_record(load_alternatives(path)[0]),
        lambda path: _page(alternatives=path),
    ),
    "facts": (find_named_body, lambda path: _page(facts=path), _batch),
    "curves": (lambda path: curve_charts(read_curves(path), FACTS),),
    "strip": (lambda path: _page(strip=path), _batch),
}
"""Kind of file -> everything that opens one; each reader goes its way, whatever the others said."""
