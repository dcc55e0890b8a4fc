"""A recorded run is made again: the same bits, from the same inputs, without what lies in the cache."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import hfb.flows.rerun
import hfb.tasks.image.fit_motion
from hfb.config import (
    RENAMED_FIT_OPTIONS,
    ExportConfig,
    FitConfig,
    InitConfig,
    MattingConfig,
    PriorConfig,
    RunConfig,
    Stage,
)
from hfb.errors import InputError
from hfb.flows.cli.cli import main
from hfb.flows.fit_image import fit_image
from hfb.flows.rerun import plan_rerun, repeat, with_networks
from hfb.flows.video import run_video
from hfb.io.media.images.image_io import read_picture_srgb, write_png
from hfb.motion.static_pose import load_first_body, save_first_body
from hfb.priors.mixture import write_mixture
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.inputs.inputs import Inputs, input_file
from hfb.tasks.inputs.video_inputs import take_video_inputs
from hfb.tasks.results.reload_inputs import reload_images
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.hidden_options import for_pictures, hidden_options, with_options
from hfb.tasks.tracking.recipe import RECIPE, GivenFile, Recipe
from tests.orchestration import Problem, mlflow_rows
from tests.small_clips import small_clip, small_config

MOVING = RunConfig(
    seed=3,
    init=InitConfig(method="matte"),
    fit=FitConfig(subframes=2, texture_px=16, initial_root_velocity=0.1, stages=(Stage(size_px=32, iterations=12),)),
    export=ExportConfig(films=(), report=False),
)
CLIP = "[camera]\nfocal_px = 140.0\n[exposure]\nfps = 25\nshutter_fraction = 0.5\n"


@pytest.fixture
def made(problem: Problem, store: Path, tmp_path: Path) -> dict[str, Any]:
    """A run of pictures in a folder of their own; the content of its result.json."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for name in ("frame", "background", "first_body"):
        path = getattr(problem, name)
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / "clip.toml").write_text(CLIP)
    aside(folder / problem.first_body.name)
    frame, plate, first = (folder / getattr(problem, name).name for name in ("frame", "background", "first_body"))
    return fit_image([frame], plate, tmp_path / "out", MOVING, clip=folder / "clip.toml", first_bodies=[first])


def aside(path: Path) -> None:
    """A first body that is not where the person is, so that the fit has something to do."""
    first = load_first_body(path)
    save_first_body(path, replace(first, translation=first.translation + torch.tensor([0.05, 0.02, 0.0])))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def again(run_id: str, **places: Path | None) -> dict[str, Any]:
    return repeat(plan_rerun(run_id, places.get("inputs"), places.get("out")))


def test_the_same_bits_without_the_cache(made: dict[str, Any], store: Path, tmp_path: Path) -> None:
    run_id, original = made["mlflow_run_id"], tmp_path / "out"
    history = json.loads((original / "intermediate" / "history.json").read_text())["total"]
    assert min(history) < 0.9 * history[0]  # a fit that ended where it began would prove nothing
    before = {path: path.stat().st_mtime_ns for path in original.rglob("*") if path.is_file()}
    verdict = again(run_id[:8])

    assert verdict["run_id"] == run_id
    assert verdict["bit_equal"]
    assert (verdict["mean_mm"], verdict["max_mm"]) == (0, 0)
    assert verdict["same_environment"]
    assert verdict["files_that_differ"] == []
    out = Path(verdict["out"])
    assert out == tmp_path / "runs" / f"rerun-{run_id[:8]}"
    assert json.loads((out / "rerun.json").read_text()) == verdict
    for name in ("matte_0.png", "motion.npz", "strip.png"):  # made here, not taken from the first run
        assert (out / "intermediate" / name).is_file()
        assert (out / name).read_bytes() == (original / name).read_bytes()
    assert {path: path.stat().st_mtime_ns for path in before} == before

    # a record of its own, below the first; the first as it was
    assert verdict["mlflow_run_id"] != run_id
    assert sorted(mlflow_rows(store, "select status from runs")) == [("FINISHED",)] * 2
    tags = dict(mlflow_rows(store, f"select key, value from tags where run_uuid = '{verdict['mlflow_run_id']}'"))
    assert tags[tracking.RERUN_TAG] == tags["mlflow.parentRunId"] == run_id
    metrics = "select key, value from metrics where key like 'rerun/%' order by key"
    assert mlflow_rows(store, metrics) == [("rerun/bit_equal", 1), ("rerun/max_mm", 0), ("rerun/mean_mm", 0)]
    # the clip's own clock was kept
    assert json.loads((out / "result.json").read_text())["inputs"] == made["inputs"]

    second = again(run_id)  # and once more, in another new folder
    assert Path(second["out"]).name == f"rerun-{run_id[:8]}-2"
    assert second["mlflow_run_id"] not in (run_id, verdict["mlflow_run_id"])


def test_a_run_recorded_by_earlier_names_of_options(made: dict[str, Any], store: Path, tmp_path: Path) -> None:
    (path,) = (tmp_path / "mlflow-artifacts").rglob(RECIPE)
    content = json.loads(path.read_text())
    fit = content["config"]["fit"]
    fit |= {old: fit.pop(new) for old, new in RENAMED_FIT_OPTIONS.items()}
    assert {"across", "several", "root_kick"} <= fit.keys()
    path.write_text(json.dumps(content))
    assert again(made["mlflow_run_id"])["bit_equal"]


def test_inputs_that_were_moved_or_changed(made: dict[str, Any], store: Path, tmp_path: Path) -> None:
    (tmp_path / "pictures").rename(tmp_path / "archive")
    with pytest.raises(InputError, match=r"frame_0 \(.*/pictures/frame.png\) is gone.*--inputs DIR"):
        again(made["mlflow_run_id"])
    assert again(made["mlflow_run_id"], inputs=tmp_path / "archive")["bit_equal"]

    frame = tmp_path / "archive" / "frame.png"
    write_png(frame, 0.9 * read_picture_srgb(frame))
    (tmp_path / "archive").rename(tmp_path / "pictures")
    with pytest.raises(InputError, match=r"^frame_0 \(.*/frame.png\) was changed; nor is it in") as said:
        again(made["mlflow_run_id"], inputs=tmp_path / "pictures")
    assert "background" not in str(said.value)
    assert not (tmp_path / "runs" / f"rerun-{made['mlflow_run_id'][:8]}-2").exists()


def test_a_difference_is_measured(
    made: dict[str, Any], store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine that computes otherwise: its fits take steps of another length, and its processor has another name."""
    original = hfb.tasks.image.fit_motion.fit

    def another_machine(observation: Any, first_bodies: Any, body: Any, config: Any, *rest: Any, **more: Any) -> Any:
        stages = tuple(one.model_copy(update={"learning_rate": 0.011}) for one in config.stages)
        return original(observation, first_bodies, body, config.model_copy(update={"stages": stages}), *rest, **more)

    monkeypatch.setattr(hfb.tasks.image.fit_motion, "fit", another_machine)
    same = again(made["mlflow_run_id"])
    assert not same["bit_equal"]
    assert same["same_environment"]
    assert 0 < same["mean_mm"] < same["max_mm"] < 500
    assert {"motion.npz", "strip.png"} <= set(same["files_that_differ"])
    assert "matte_0.png" not in same["files_that_differ"]

    now = hfb.flows.rerun.environment()
    monkeypatch.setattr(hfb.flows.rerun, "environment", lambda: now | {"processor": "another"})
    other = again(made["mlflow_run_id"])
    assert other["changed"] == [f"processor ({now['processor']} then, another now)"]
    assert not other["same_environment"]
    assert other["mean_mm"] == same["mean_mm"]

    for path in (tmp_path / "mlflow-artifacts").rglob("motion.npz"):  # a store that lost what was recorded
        path.unlink()
    unknown = again(made["mlflow_run_id"])
    assert not unknown["bit_equal"]
    assert unknown["mean_mm"] is unknown["max_mm"] is None


def test_files_that_options_name_move_too(
    made: dict[str, Any], store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A prior that was given by a path from the folder of then, and that lies elsewhere now."""
    folder = tmp_path / "pictures"
    write_mixture(folder / "prior.safetensors", np.zeros((1, 69)), np.eye(69)[None], np.ones(1))
    monkeypatch.chdir(folder)
    config = MOVING.model_copy(update={"prior": PriorConfig(pose=Path("prior.safetensors"))})
    frame, first = folder / "frame.png", folder / "first_body.npz"
    run = fit_image([frame], folder / "background.png", tmp_path / "prior", config, first_bodies=[first])
    monkeypatch.chdir(tmp_path)
    assert plan_rerun(run["mlflow_run_id"]).run.params["prior.pose"] == "prior.safetensors"
    folder.rename(tmp_path / "moved")
    assert again(run["mlflow_run_id"], inputs=tmp_path / "moved")["bit_equal"]


def test_an_interrupted_repetition_goes_on(
    made: dict[str, Any], store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hfb.tasks.chains import image_chain

    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(image_chain, "strip", interrupted)
        with pytest.raises(KeyboardInterrupt):
            again(made["mlflow_run_id"])
    out = tmp_path / "runs" / f"rerun-{made['mlflow_run_id'][:8]}"
    before = (out / "intermediate" / "motion.npz").stat().st_mtime_ns
    verdict = again(made["mlflow_run_id"])
    assert Path(verdict["out"]) == out
    assert (out / "intermediate" / "motion.npz").stat().st_mtime_ns == before
    assert verdict["bit_equal"]


def test_runs_that_cannot_be_repeated(made: dict[str, Any], store: Path, tmp_path: Path) -> None:
    run_id = made["mlflow_run_id"]
    for words, says in (
        ("0" * 32, "there is no run 0000"),
        ("demo", "neither the id of a run nor"),
        (str(tmp_path / "pictures"), "has no result.json"),
    ):
        with pytest.raises(InputError, match=says):
            plan_rerun(words)
    with pytest.raises(InputError, match="holds something already: choose a new folder"):
        plan_rerun(run_id, out=tmp_path / "out")
    with tracking.record_run("older", "k", {"seed": 0}, {}) as older:
        pass
    with pytest.raises(InputError, match="only runs of `hfb fit`"):
        plan_rerun(older.run_id)
    client = tracking.client()
    client.set_terminated(run_id, "FAILED")
    with pytest.raises(InputError, match="is FAILED: it has no result"):
        plan_rerun(run_id)
    client.set_terminated(run_id, "FINISHED")
    (recipe,) = (tmp_path / "mlflow-artifacts").rglob(RECIPE)
    for content, says in (('{"format": 1}', "recipe of run"), ("{", "is damaged"), ("[]", "another version of hfb")):
        recipe.write_text(content)
        with pytest.raises(InputError, match=says):
            plan_rerun(run_id)
    recipe.unlink()
    with pytest.raises(InputError, match="is gone from the store"):
        plan_rerun(run_id)


def test_everyone_of_a_clip_is_repeated_one_by_one(store: Path, tmp_path: Path) -> None:
    for name, told in {
        ".": {"people": []},
        "person-10": {"mlflow_run_id": "0123"},
        "person-2": {"mlflow_run_id": "4567"},
        "person-3": {"mlflow_run_id": None},
        "person-4": None,
    }.items():
        (tmp_path / "all" / name).mkdir(parents=True, exist_ok=True)
        if told is not None:
            (tmp_path / "all" / name / "result.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match=r"a run for each person: give all/person-2 or all/person-10$"):
        plan_rerun("all")
    for name in ("person-2", "person-10"):
        (tmp_path / "all" / name / "result.json").unlink()
    with pytest.raises(InputError, match="names no run"):
        plan_rerun("all")


def test_options_of_another_version(made: dict[str, Any], store: Path, tmp_path: Path) -> None:
    (recipe,) = (tmp_path / "mlflow-artifacts").rglob(RECIPE)
    content = json.loads(recipe.read_text())
    assert content["command"] == "fit"
    content["config"]["fit"]["warp"] = 9
    recipe.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"unknown option fit\.warp.*check that version out"):
        plan_rerun(made["mlflow_run_id"])


def test_options_and_places_that_held_a_secret(
    problem: Problem, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The record hides them: an option is given again; files are told apart by content where paths look the same."""
    places = {}
    for name, token in (("frame", "first-one"), ("background", "another-one"), ("first_body", "last-one")):
        source = getattr(problem, name)
        places[name] = tmp_path / f"token={token}" / f"input{source.suffix}"
        places[name].parent.mkdir()
        places[name].write_bytes(source.read_bytes())
    aside(places["first_body"])
    monkeypatch.setenv("CORPORATE_TOKEN", "known-background")
    config = MOVING.model_copy(update={"matting": MattingConfig(method="known-background")})
    made = fit_image(
        [places["frame"]], places["background"], tmp_path / "out", config, first_bodies=[places["first_body"]]
    )
    monkeypatch.delenv("CORPORATE_TOKEN")
    run_id = made["mlflow_run_id"]
    (recipe,) = (tmp_path / "mlflow-artifacts").rglob(RECIPE)
    assert "known-background" not in recipe.read_text()
    assert "another-one" not in recipe.read_text()

    assert main(["rerun", run_id, "--inputs", str(tmp_path), "--json"]) == 2
    told = json.loads(capsys.readouterr().out)["error"]
    assert "had a secret in matting.method, which its record hides: give --option matting.method=VALUE" in told
    again = ["rerun", run_id, "--inputs", str(tmp_path), "--out", str(tmp_path / "again"), "--json"]
    for words, says in (
        (["--option", "seed=3"], "a repetition keeps the options of run"),
        (["--option", "matting.method"], "--option takes NAME=VALUE"),
        (["--option", "matting.method=sepia"], "matting.method"),
    ):
        assert main([*again, *words]) == 2
        assert says in json.loads(capsys.readouterr().out)["error"]
    assert main([*again, "--option", "matting.method=known-background"]) == 0
    assert json.loads(capsys.readouterr().out)["bit_equal"]
    with reload_images(run_id, tmp_path) as seen:  # films need no such option
        np.testing.assert_allclose(seen.frame_linear(0).shape, read_picture_srgb(places["frame"]).shape)


def test_hidden_options_of_a_recipe() -> None:
    """Also in lists and in what clip.toml said; a file's path is no option."""
    file = GivenFile(path=Path("/a/token=***/w.pt"), sha256="1", bytes=3)
    recipe = Recipe(
        command="video",
        code="",
        options={},
        results={},
        files={"init_file_0": file},
        config={"init": {"person": "***", "file": "/a/token=***/w.pt"}, "export": {"formats": ["bvh", "***"]}},
        inputs={"clip": {"exposure": {"light": "x***"}}, "video": [{"path": "/b/sig=***/v.mp4", "sha256": "2"}]},
    )
    names = ("init.person", "export.formats", "inputs.clip.exposure.light")
    assert hidden_options(recipe) == names
    told = with_options(recipe, {name: f"value of {name}" for name in names}, "x")
    assert hidden_options(told) == ()
    assert told.config["init"]["person"] == "value of init.person"
    assert told.inputs["clip"] == {"exposure": {"light": "value of inputs.clip.exposure.light"}}
    with pytest.raises(InputError, match="make the result again"):
        for_pictures(recipe, "x")
    two = {"a": file, "b": file.model_copy(update={"sha256": "3"})}  # which of them init.file was nobody can tell
    assert "init.file" in hidden_options(recipe.model_copy(update={"files": two}))


def test_pose_networks_of_then(made: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there were no networks `auto` meant the matte alone, also once there are; other ones are refused."""
    here: list[FileHandle] = []
    monkeypatch.setattr(hfb.flows.rerun, "networks_at_hand", lambda choice="auto": tuple(here))
    frame, plate = tmp_path / "pictures" / "frame.png", tmp_path / "pictures" / "background.png"
    auto = RunConfig(init=InitConfig(method="auto"))
    without = Inputs(frames=(input_file(frame),), background=input_file(plate))
    having = without.model_copy(update={"networks": (input_file(frame),)})

    for present in ([], [input_file(frame)]):
        here[:] = present
        inputs, config = with_networks(without, auto, "x")
        assert inputs == without
        assert config.init.method == "matte"
    assert with_networks(having, auto, "x") == (having, auto)
    here[:] = [input_file(plate)]
    with pytest.raises(InputError, match=r"are other ones now: `hfb models fetch --force`"):
        with_networks(having, auto, "x")
    here.clear()
    with pytest.raises(InputError, match="are gone"):
        with_networks(having, auto, "x")


def test_a_clip_is_repeated_too(store: Path, tmp_path: Path) -> None:
    """`hfb video`: from files that were moved, with a record of its own and one point per frame and metric."""
    shutil.copytree(small_clip(frames=2).source.parent, tmp_path / "clip")
    config = small_config()
    source = tmp_path / "clip" / small_clip(frames=2).source.name
    made = run_video(take_video_inputs(source, config), tmp_path / "out", config, 1)
    (tmp_path / "clip").rename(tmp_path / "elsewhere")
    verdict = again(made["mlflow_run_id"], inputs=tmp_path / "elsewhere")
    assert verdict["bit_equal"]
    assert verdict["files_that_differ"] == []
    assert sorted(mlflow_rows(store, "select status from runs")) == [("FINISHED",)] * 2
    points = "select count(*) from metrics where key = 'frame/seen' group by run_uuid"
    assert mlflow_rows(store, points) == [(2,), (2,)]
