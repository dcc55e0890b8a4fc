"""Two recorded runs beside each other."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hfb.errors import InputError
from hfb.flows.cli.repeating import compare_text
from hfb.flows.compare import compare_runs
from hfb.flows.fit_image import fit_image
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.tasks.results.run_comparison import compare_records
from hfb.tasks.results.stored_runs import StoredRun
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.store_place import tracking_uri
from tests.flows.test_fit_image import TINY, run
from tests.orchestration import Problem, orchestrated


@pytest.fixture(scope="module")
def pair(problem: Problem, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Two runs whose sub-frames and seeds differ; both begin with a kick whose direction the seed gives.

    All tests look at the same two, in the same store.
    """
    one, other = (
        TINY.model_copy(
            update={
                "fit": TINY.fit.model_copy(update={"subframes": count, "initial_root_velocity": 0.1}),
                "seed": count,
            }
        )
        for count in (2, 3)
    )
    folder = tmp_path_factory.mktemp("pair")
    with pytest.MonkeyPatch.context() as patch, orchestrated(folder, patch):
        yield run(problem, folder / "one", one), run(problem, folder / "other", other)


def out_of(result: dict[str, Any]) -> Path:
    """The folder of a run."""
    return Path(result["strip"]).parent


def test_two_fits(pair: tuple[dict[str, Any], dict[str, Any]], tmp_path: Path) -> None:
    one, other = pair
    out = tmp_path / "compared"
    found = compare_runs((one["mlflow_run_id"], str(out_of(other))), out)

    assert (found["run_a"], found["run_b"]) == (one["mlflow_run_id"], other["mlflow_run_id"])
    assert found["config"] == [{"name": name, "a": "2", "b": "3"} for name in ("fit.subframes", "seed")]
    assert found["environment"] == []
    metrics = {row["name"]: (row["a"], row["b"]) for row in found["metrics"]}
    assert metrics["eval/matte_iou"] == pytest.approx((one["matte_iou"], other["matte_iou"]))
    assert not found["motion"]["bit_equal"]
    assert 0 < found["motion"]["mean_mm"] < found["motion"]["max_mm"]

    assert json.loads((out / "comparison.json").read_text()) == found
    picture = read_picture_srgb(Path(found["picture"]))
    strips = [read_picture_srgb(out_of(fitted) / "strip.png") for fitted in pair]
    assert picture.shape[0] > sum(strip.shape[0] for strip in strips)
    page = Path(found["page"]).read_text()
    assert all(words in page for words in ("fit.subframes", "data:image/png;base64,", one["mlflow_run_id"]))

    text = compare_text(found)
    assert "fit.subframes" in text
    assert "eval/psnr_db" in text
    assert found["sentence"] in text
    assert max(map(len, text.splitlines()[:-3])) < 120


def test_options_by_earlier_names_are_the_same_options() -> None:
    def stored(**params: str) -> StoredRun:
        named = {name.replace("__", "."): value for name, value in params.items()}
        return StoredRun("0" * 32, "run", "FINISHED", "", named, {}, {}, "")

    before = stored(seed="0", fit__across="0.2", fit__several__image="33", fit__root_kick="0.1")
    after = stored(seed="0", fit__xy_weight="0.2", fit__multi_frame__image="30", fit__initial_root_velocity="0.1")
    found = compare_records([before, after])
    assert found.config == (("fit.multi_frame.image", ("33", "30")),)
    assert found.same_options == 3


def test_three_runs(pair: tuple[dict[str, Any], dict[str, Any]], problem: Problem, tmp_path: Path) -> None:
    third = run(problem, tmp_path / "third", TINY.model_copy(update={"seed": 7}))
    ids = [one["mlflow_run_id"] for one in (*pair, third)]
    found = compare_runs(ids, tmp_path / "compared")
    assert found["runs"] == ids
    assert found["names"] == [
        f"{name} ({run_id[:8]})" for name, run_id in zip(("one", "other", "third"), ids, strict=True)
    ]
    assert {"name": "seed", "a": "2", "b": "3", "more": ["7"]} in found["config"]
    assert found["motion"] == found["motions"][0]
    assert len(found["motions"]) == len(found["sentences"]) == 2
    assert found["sentences"][1].startswith(f"third ({ids[2][:8]}) against one ({ids[0][:8]})")
    page = Path(found["page"]).read_text()
    assert page.count('class="viewer"') == 3
    assert page.count("data:image/jpeg;base64,") == 3
    assert max(map(len, compare_text(found).splitlines()[:-3])) < 130


def test_a_run_with_itself(pair: tuple[dict[str, Any], dict[str, Any]], tmp_path: Path) -> None:
    run_id = pair[0]["mlflow_run_id"]
    found = compare_runs((run_id, run_id), tmp_path / "compared")
    assert found["config"] == []
    assert found["motion"] == {"bit_equal": True, "mean_mm": 0, "max_mm": 0}
    assert "bit-equal" in compare_text(found)


def test_runs_without_pictures_or_motions(pair: tuple[dict[str, Any], dict[str, Any]], tmp_path: Path) -> None:
    """A benchmark's run, a number that is none, and a picture that is damaged: the numbers are shown all the same."""
    with tracking.record_run("plain", "k", {"seed": 5}, {}) as plain:
        tracking.log_histories(plain, {"all/ratio": [0.5], "loss/total": [float("nan")]})
        (tmp_path / "strip.png").write_bytes(b"no picture")
        tracking.log_files(plain, [tmp_path / "strip.png"])
    found = compare_runs((plain.run_id, plain.run_id), tmp_path / "compared")
    assert found["motion"] is None
    assert found["picture"] is None
    assert {"name": "loss/total", "a": None, "b": None} in found["metrics"]
    assert "<img" not in Path(found["page"]).read_text()

    mixed = compare_runs((plain.run_id, pair[0]["mlflow_run_id"]), tmp_path / "compared")
    assert {"name": "all/ratio", "a": 0.5, "b": None} in mixed["metrics"]
    assert mixed["picture"] is not None


def test_a_run_that_is_not_there(pair: tuple[dict[str, Any], dict[str, Any]], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no run abcdef"):
        compare_runs((pair[0]["mlflow_run_id"], "abcdef"), tmp_path / "compared")
    assert not (tmp_path / "compared").exists()


def test_a_folder_whose_result_was_not_recorded(
    problem: Problem, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = tracking_uri()
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/file/mlflow.db")
    fit_image([problem.frame], problem.background, tmp_path / "out", TINY, first_bodies=[problem.first_body])
    with pytest.raises(InputError, match="cannot be read"):
        compare_runs(("abcd", "abcd"), tmp_path / "compared")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", recorded)
    with pytest.raises(InputError, match="was not recorded in MLflow"):
        compare_runs((str(tmp_path / "out"),) * 2, tmp_path / "compared")
