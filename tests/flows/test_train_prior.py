"""Training a prior, whole: recordings in, weights out, everything recorded."""

import json
from pathlib import Path

import numpy as np
import pytest

from hfb.datasets.motions.sources import open_motions
from hfb.errors import InputError
from hfb.flows.train_prior import TrainingPlan, train_prior, work_folder
from hfb.motion.motion_file import save_motion
from hfb.motion.sampled import SampledMotion
from hfb.priors.load import load_pose_prior
from hfb.priors.mixture import MixturePrior
from hfb.priors.motion_prior import load_motion_prior
from hfb.training.priors.training_spec import MotionTraining, NetworkSizes, PoseTraining
from tests.orchestration import mlflow_rows
from tests.priors.motions import moving

SIZES = NetworkSizes(discriminator_width=16, discriminator_depth=2, corrector_width=16, corrector_depth=2)


def record(folder: Path, count: int = 6) -> Path:
    """Some lively built-in motions as files."""
    folder.mkdir()
    source = open_motions(None, 0)
    for number in range(count):
        clip = source.load(number)
        frames = min(len(clip.poses), 90)
        times_s = np.arange(frames) / clip.fps
        motion = SampledMotion(
            clip.poses[:frames].reshape(frames, 72),
            clip.translations[:frames],
            np.zeros(10),
            np.zeros((frames, 24, 3)),
            times_s,
            np.zeros(frames, int),
            np.eye(3),
        )
        save_motion(folder / f"motion_{number}.npz", motion, "hfb")
    return folder


@pytest.fixture
def plan(tmp_path: Path) -> TrainingPlan:
    motion = MotionTraining(epochs=3, windows_per_second=100, batch=64, sizes=SIZES)
    pose = PoseTraining(components=2, epochs=4)
    motions = record(tmp_path / "motions")
    return TrainingPlan(motions=motions, kind="motion", tests=("motion_5*",), motion=motion, pose=pose)


def test_a_motion_prior(plan: TrainingPlan, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "prior.safetensors"
    (plan.motions / "broken.npz").write_text("no archive")
    result = train_prior(plan, out)

    assert load_motion_prior(out).reversed_logits(moving()).shape == (1, 25)
    about = json.loads((out.parent / "prior.json").read_text())
    assert about.items() <= result.items()
    data = about["data"]
    assert data["tested"] == ["motion_5.npz"]
    assert data["held_out"] == ["motion_2.npz"]  # every fourth in the order of names: broken, 0, 1, 2, ...
    assert data["trained"] == ["motion_0.npz", "motion_1.npz", "motion_3.npz", "motion_4.npz"]
    assert list(data["refused"]) == ["broken.npz"]
    assert set(about["measures"]) == {"held_out", "tested"}
    assert str(tmp_path) not in json.dumps(about["training"])

    (run,) = mlflow_rows(store, "select run_uuid, name, status from runs")
    assert run[1:] == ("train-prior-motion", "FINISHED")
    curves = dict(mlflow_rows(store, "select key, count(*) from metrics where key like 'loss/%' group by key"))
    assert curves == {f"loss/{name}": 3 for name in ("indicator", "coefficients", "poses", "joints")}
    by_exposure = "select count(*) from metrics where key = 'held_out_by_exposure/whole_body'"
    assert mlflow_rows(store, by_exposure)[0][0] >= 3
    assert mlflow_rows(store, "select count(*) from metrics where key = 'tested/joint'") == [(1,)]
    assert ("3",) in mlflow_rows(store, "select value from params where key = 'motion.epochs'")
    kept = sorted(path.name for path in (tmp_path / "mlflow-artifacts").rglob("*.*") if path.is_file())
    assert kept == ["motion_prior.json", "motion_prior.safetensors"]


@pytest.mark.parametrize("name", ["prior.safetensors", "prior.json"])
def test_a_file_of_the_users_is_not_replaced(name: str, plan: TrainingPlan, store: Path, tmp_path: Path) -> None:
    (tmp_path / name).write_text('{"mine": 1}')
    with pytest.raises(InputError, match=f"holds {name}, which no training of hfb left: choose another --out"):
        train_prior(plan, tmp_path / "prior.safetensors")
    assert (tmp_path / name).read_text() == '{"mine": 1}'
    assert not work_folder(tmp_path / "prior.safetensors").exists()


def test_goes_on_where_it_stopped(plan: TrainingPlan, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "prior.safetensors"
    train_prior(plan, out)
    first = out.read_bytes()
    folder = work_folder(out) / "intermediate"
    stamps = {path.name: path.stat().st_mtime_ns for path in folder.glob("motion_*")}
    assert train_prior(plan, out)["mlflow_run_id"]
    assert {path.name: path.stat().st_mtime_ns for path in folder.glob("motion_*")} == stamps
    assert len(mlflow_rows(store, "select run_uuid from runs")) == 1

    (folder / "motion_prior.safetensors").write_bytes(b"damaged meanwhile")
    train_prior(plan, out)
    assert out.read_bytes() == first
    longer = plan.motion.model_copy(update={"epochs": 4})
    train_prior(plan.model_copy(update={"motion": longer}), out)
    assert out.read_bytes() != first
    assert len(mlflow_rows(store, "select run_uuid from runs")) == 2


def test_a_pose_prior(plan: TrainingPlan, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "poses.safetensors"
    result = train_prior(plan.model_copy(update={"kind": "pose"}), out)
    assert isinstance(load_pose_prior(out), MixturePrior)
    assert result["measures"]["held_out"]["all"]["prior_at_50"] > 0
    curve = mlflow_rows(store, "select value from metrics where key = 'loss/log_likelihood' order by step")
    assert 2 <= len(curve) <= 4
    assert curve[-1][0] == pytest.approx(result["last_losses"]["log_likelihood"])


def test_what_cannot_be_learned_from(plan: TrainingPlan, store: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    (nothing / "broken.bvh").write_text("")
    out = tmp_path / "new" / "prior.safetensors"
    for motions, told in ((nothing, "too little motion"), (tmp_path / "none", "no folder")):
        with pytest.raises(InputError, match=told):
            train_prior(plan.model_copy(update={"motions": motions, "tests": ()}), out)
    with pytest.raises(InputError, match="safetensors"):
        train_prior(plan, tmp_path / "prior.pt")
    assert not out.parent.exists()
