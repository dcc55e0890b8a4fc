"""Parts of a result that somebody damaged: each is refused in one sentence that names the file."""

import json
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from hfb.errors import InputError
from hfb.fitting.alternatives import load_alternatives
from hfb.flows.export import export_result
from hfb.flows.report import make_report
from hfb.interop.writers.bvh import bvh_text
from hfb.interop.writers.joint_tables import csv_text
from hfb.interop.writers.keys import even_keys
from hfb.io.media.video.video_file import FRAME_LIMIT
from hfb.motion.motion_file import load_motion, save_motion
from hfb.report.films.slow_motion import film_instants
from hfb.report.pages.limb_speed import exposure_s
from hfb.report.pages.page import checked_picture
from hfb.report.pages.result_curves import curve_charts, read_curves
from hfb.report.pages.result_facts import read_facts
from tests.fuzz.hostile import _large_png
from tests.fuzz.results import CURVES, FACTS, whole_motion, write_result

Change = Callable[[Any], Any]


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A whole result."""
    list(write_result(tmp_path / "result"))
    return tmp_path / "result"


def rewritten(path: Path, change: Change) -> None:
    content = json.loads(path.read_text())
    path.write_text(json.dumps(change(content)))


def arrays_of(path: Path, **changed: Any) -> None:
    with np.load(path) as found:
        arrays = dict(found)
    np.savez(path, **arrays | changed)


@pytest.mark.parametrize(
    "entry",
    [
        {"frames": 2.5},
        {"frames": "2"},
        {"frames": -1},
        {"frames": 10**30},
        {"matte_iou": "good"},
        {"psnr_db": 1e300},
        {"gaps": [[1]]},
        {"gaps": "all"},
        {"gaps": [[1, "b"]]},
        {"directions": [3]},
        {"directions": [{"right": []}]},
        {"directions": [{"right": {"body": "yes"}}]},
        {"remarks": [1]},
        {"filled": {"a": 1}},
        {"people": [{}]},
        {"people": 3},
        {"config": []},
        {"inputs": {"frame_0": 3}},
        {"out": 3},
        {"mlflow_link": ["x"]},
    ],
)
def test_a_result_with_entries_of_other_types_is_refused(entry: dict[str, Any], result: Path) -> None:
    assert read_facts(result / "result.json") == FACTS
    rewritten(result / "result.json", lambda content: content | entry)
    with pytest.raises(InputError, match=rf"result\.json is damaged \({next(iter(entry))}"):
        read_facts(result / "result.json")


@pytest.mark.parametrize(
    "entry",
    [
        {"losses": [1]},
        {"losses": {"total": "x"}},
        {"losses": {"total": [[1]]}},
        {"losses": {"total": [1e300]}},
        {"losses": {f"t{number}": [1.0] for number in range(300)}},
        {"windows": 3},
        {"windows": [{"total": [None]}]},
        {"frames": [1]},
        {"frames": {"psnr_db": [[1]]}},
        {"frames": {"psnr_db": [[10**12, 1.0]]}},
        {"windows": [{"total": [1.0] * 60_000}] + [{"total": []}] * 400},
    ],
)
def test_curves_of_another_kind_are_refused(entry: dict[str, Any], result: Path) -> None:
    assert curve_charts(read_curves(result / "curves.json"), FACTS)
    rewritten(result / "curves.json", lambda content: content | entry)
    with pytest.raises(InputError, match=r"curves\.json holds no curves"):
        read_curves(result / "curves.json")


def test_stages_that_are_none_leave_the_curves(result: Path) -> None:
    curves = read_curves(result / "curves.json")
    for stages in ("x", [{"iterations": "many"}], [{"iterations": 10**9}], [{"iterations": 1}] * 1000, [3], None):
        assert curve_charts(curves, {"config": {"fit": {"stages": stages}}})


@pytest.mark.parametrize(
    "curves",
    [
        {"frames": {"_iou": [[0, 0.9], [1, 0.95]]}},
        {"frames": {"a$\\frac{$": [[0, 0.9], [1, 0.95]]}},
        {"losses": {"_a": [1.0], "$\\b$": [2.0, 1.0]}},
        {"losses": {"total": [0.0, -1.0]}},
    ],
)
def test_curves_of_any_name_and_height(curves: dict[str, Any], result: Path) -> None:
    (result / "curves.json").write_text(json.dumps(curves))
    assert len(curve_charts(read_curves(result / "curves.json"), FACTS)) == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("times_s", 1e300),
        ("times_s", -1e300),
        ("frame_index", 10**9),
        ("frame_index", 2**62),
        ("joints", 1e300),
        ("trans", -1e9),
        ("poses", 1e5),
        ("betas", 1e6),
        ("K", 1e12),
    ],
)
def test_absurd_numbers_in_a_motion_are_refused(name: str, value: float, result: Path) -> None:
    motion, _ = load_motion(result / "motion.npz")
    array = getattr(motion, name).copy()
    array.reshape(-1)[-1] = value
    arrays_of(result / "motion.npz", **{name: array})
    with pytest.raises(InputError, match=f"its {name} has a number beyond"):
        load_motion(result / "motion.npz")


def test_a_motion_that_goes_back_or_stands_nearly_still_is_refused(result: Path) -> None:
    arrays_of(result / "motion.npz", frame_index=np.array([1, 1, 1, 0, 0, 0]))
    with pytest.raises(InputError, match="frames are not in order"):
        load_motion(result / "motion.npz")
    arrays_of(result / "motion.npz", frame_index=np.repeat([0, 1], 3), times_s=np.arange(6) * 1e-300)
    with pytest.raises(InputError, match="two sub-frames within"):
        load_motion(result / "motion.npz")


def test_a_long_absence_takes_no_memory(tmp_path: Path) -> None:
    """A gap of 1e5 frames: 333,000 rows of a .bvh are refused, the sub-frames themselves and films have no gap."""
    save_motion(tmp_path / "motion.npz", whole_motion(100_000), "hfb")
    motion, _ = load_motion(tmp_path / "motion.npz")
    tracemalloc.start()
    for formats in (("bvh",), ("trc",), ("amass",)):
        with pytest.raises(InputError, match=r"keys at .* are too many: export csv or glb"):
            export_result(str(tmp_path / "motion.npz"), tmp_path / "out", formats, ())
    instants = film_instants(motion)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    written = export_result(str(tmp_path / "motion.npz"), tmp_path / "out", ("csv", "glb"), ())
    assert set(written["files"]) == {"joints.csv", "motion.glb"}
    assert peak < 300 << 20
    assert len(instants) < 100, "the stretch without the person is cut out"
    assert motion.frame_index.max() < FRAME_LIMIT
    assert even_keys(replace(motion, times_s=motion.times_s * 1e-2, frame_index=motion.frame_index), 10.0).present.any()


def test_many_frames_take_time_by_their_number(tmp_path: Path) -> None:
    """60,000 frames of a row each: a search of all rows for each of them would take minutes."""
    one, count = whole_motion(), 60_000
    motion = replace(
        one,
        **{name: np.repeat(getattr(one, name)[:1], count, 0) for name in ("poses", "trans", "joints")},
        times_s=np.arange(count) / 30,
        frame_index=np.arange(count),
        joint_radius_mm=None,
    )
    assert exposure_s(motion) == 0
    assert csv_text(motion).count("\n") == count + 1
    with pytest.raises(InputError, match="fewer than two sub-frames per frame"):
        bvh_text(motion)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"chosen": np.array(7)}, "no motion that was chosen"),
        ({"chosen": np.array(0.5)}, "its chosen is float64"),
        ({"poses": np.zeros((2, 6, 72, 1))}, "its trans|its poses"),
        ({"frame_index": np.arange(6)}, "numbered from 0"),
        ({"frame_index": np.full(6, 10**9)}, "numbered from 0"),
        ({"probability": np.array([np.nan, 1])}, "finite"),
        ({"trans": np.full((2, 6, 3), 1e300)}, "beyond"),
        ({"joints": np.zeros((2, 5, 24, 3))}, "its joints"),
        ({"reversed_limbs": np.zeros((2, 2, 5))}, "its reversed_limbs"),
        ({"scores": np.zeros(2)}, "its scores"),
    ],
)
def test_alternatives_that_do_not_belong_together_are_refused(changed: dict[str, Any], says: str, result: Path) -> None:
    load_alternatives(result / "alternatives.npz")
    arrays_of(result / "alternatives.npz", **changed)
    with pytest.raises(InputError, match=says):
        load_alternatives(result / "alternatives.npz")


def test_pictures_reach_a_page_only_if_they_are_some(tmp_path: Path) -> None:
    bomb = tmp_path / "bomb.png"
    bomb.write_bytes(_large_png(np.random.default_rng(1)))
    with pytest.raises(InputError, match=r"megapixels|damaged|no picture|not a picture"):
        checked_picture(bomb, 100, 1 << 30)
    (tmp_path / "text.png").write_text("<svg onload='alert(1)'/>")
    with pytest.raises(InputError, match="is not a picture"):
        checked_picture(tmp_path / "text.png", 100, 1 << 20)
    tiff = tmp_path / "strip.png"
    Image.fromarray(np.zeros((4, 8, 3), np.uint8)).save(tiff, format="TIFF")
    assert checked_picture(tiff, 100, 1 << 20).startswith(b"\xff\xd8"), "browsers show no TIFF"


@pytest.mark.parametrize("how", ["cut", "folder", "text"])
@pytest.mark.parametrize("name", ["strip.png", "curves.json", "alternatives.npz", "result.json", "motion.npz"])
def test_hfb_report_names_the_damaged_file(name: str, how: str, result: Path, store: Path) -> None:
    path = result / name
    content = path.read_bytes()
    path.unlink()
    if how == "folder":
        path.mkdir()
    else:
        path.write_bytes(content[: len(content) // 2] if how == "cut" else b"no such thing")
    with pytest.raises(InputError, match=name.replace(".", r"\.")) as raised:
        make_report(str(result), None)
    assert "\n" not in str(raised.value)
    assert not (result / "report.html").exists()


def test_alternatives_of_another_motion_are_said(result: Path, store: Path) -> None:
    save_motion(result / "motion.npz", whole_motion(3), "hfb")
    with pytest.raises(InputError, match="belongs to another motion"):
        make_report(str(result), None)
    assert json.loads((result / "curves.json").read_text()) == CURVES
