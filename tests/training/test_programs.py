"""Every program of `hfb train` for a few steps: what one writes the next one reads."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from hfb.evidence.depth_fusion import DepthFusion
from hfb.evidence.joint_network import JointNetwork
from hfb.evidence.lifting_network import LiftingNetwork
from hfb.flows.cli.cli import main
from hfb.initialization.landmark_lift import LandmarkLift
from hfb.initialization.landmarks import networks_ready
from hfb.matting.matte_network import MatteNetwork
from hfb.training import programs
from hfb.training.joints import blurred_people, joint_fits
from hfb.training.matting import matte_training, training_plates

_PX = "48"


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few scenes and iterations."""
    monkeypatch.setattr(blurred_people, "_SCENES", 2)
    monkeypatch.setattr(blurred_people, "LEAST_PX", 5)
    monkeypatch.setattr(joint_fits, "_HASTE", (0.01, 0.02))
    monkeypatch.setattr(joint_fits, "_HASTE_WHOLE", (0.01, 0.02))
    for module in (training_plates, matte_training):
        monkeypatch.setattr(module, "ROOMS", 2)
        monkeypatch.setattr(module, "PATTERNS", 2)


def train(name: str, *words: object) -> None:
    """Run a program as from the command line."""
    assert main(["train", name, *map(str, words)]) == 0


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("training")


@pytest.fixture(scope="module")
def joint_run(place: Path, mocap: Path, backgrounds: Path) -> Path:
    """A joint network of two iterations."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(blurred_people, "_SCENES", 2)
        drawn = ("--mocap", mocap, "--backgrounds", backgrounds, "--frame-px", _PX)
        train("joints-bank", *drawn, "--out", place / "bank", "--count", 3)
        train("joints-bank", *drawn, "--out", place / "dev", "--count", 2, "--seed", 9, "--split", "dev")
        train("joints-doubles", *drawn, "--out", place / "doubles", "--count", 2)
    banks = ("--bank", place / "bank", "--dev", place / "dev", "--fits", place / "doubles")
    train("joints", *banks, "--out", place / "run", "--iterations", 2, "--batch", 4)
    return place / "run"


def test_the_joint_network_learns_and_is_written(joint_run: Path, place: Path) -> None:
    facts = json.loads((joint_run / "training.json").read_text())
    assert (facts["iterations"], facts["pictures"], facts["beside"]) == (2, 3, 2)
    train("joints-export", "--run", joint_run, "--held-out", place / "dev", "--out", place / "shipped")
    about = json.loads((place / "shipped" / "joints.json").read_text())
    assert about["held_out"]["pictures"] == 2
    assert np.isfinite(about["held_out"]["joints"])
    JointNetwork().load_state_dict(load_file(place / "shipped" / "joints.safetensors"), strict=False)
    train("joints-export", "--run", joint_run, "--held-out", place / "dev", "--out", place / "shipped", "--went-on")
    assert len(json.loads((place / "shipped" / "joints.json").read_text())["training"]) == 2


def test_a_small_network_is_widened_to_one_that_goes_on(joint_run: Path, place: Path) -> None:
    banks = ("--bank", place / "bank", "--dev", place / "dev", "--iterations", 1, "--batch", 2)
    train("joints", *banks, "--out", place / "small", "--small")
    train("joints-widen", "--run", place / "small", "--out", place / "wide")
    train("joints", *banks, "--out", place / "gone-on", "--go-on", place / "wide" / "average.pt")


def test_fits_are_drawn_and_learned_from(place: Path, mocap: Path, backgrounds: Path) -> None:
    drawn = ("--mocap", mocap, "--backgrounds", backgrounds, "--frame-px", 64)
    train("joints-fits", *drawn, "--out", place / "fits", "--count", 1)
    with np.load(place / "fits" / "joints.npz") as rows:
        assert rows["truth"].shape == (1, 2, 3, 24, 3)
    train("matting-fits", *drawn, "--out", place / "mattes.npy", "--count", 1)
    assert np.load(place / "mattes.npy").any()


@pytest.mark.skipif(not networks_ready(), reason="the pose networks are not there (hfb models fetch)")
def test_the_landmark_lift_learns_from_what_the_networks_say(place: Path, mocap: Path, backgrounds: Path) -> None:
    drawn = ("--mocap", mocap, "--backgrounds", backgrounds, "--frame-px", 192, "--count", 3)
    train("landmarks-bank", *drawn, "--out", place / "sightings.npz")
    with np.load(place / "sightings.npz") as rows:
        assert rows["truth"].shape == (3, 19, 3)
        assert rows["world"].shape == (3, 33, 3)
        assert np.isfinite(rows["rays"]).all()
    train("landmarks", "--bank", place / "sightings.npz", "--out", place / "lift", "--iterations", 2, "--batch", 4)
    LandmarkLift().load_state_dict(load_file(place / "lift" / "landmark_lift.safetensors"))


def test_lifting_and_fusion_learn_from_fits(place: Path, mocap: Path, backgrounds: Path) -> None:
    train("lifting-bank", "--mocap", mocap, "--out", place / "people.npz", "--count", 8)
    drawn = ("--mocap", mocap, "--backgrounds", backgrounds, "--frame-px", 64, "--count", 1)
    fits = place / "fits.npz"
    train("lifting-fits", *drawn, "--out", fits)
    learned = ("--bank", place / "people.npz", "--held-out", place / "people.npz", "--fits", fits)
    train("lifting", *learned, "--out", place / "lifting", "--iterations", 2, "--batch", 8)
    LiftingNetwork().load_state_dict(load_file(place / "lifting" / "lifting.safetensors"))
    train("fusion", "--fits", fits, "--held-out", fits, "--out", place / "fusion", "--iterations", 2)
    DepthFusion().load_state_dict(load_file(place / "fusion" / "depth_fusion.safetensors"))
    about = json.loads((place / "fusion" / "depth_fusion.json").read_text())
    assert about["training"]["frames"] == 2


def test_a_matting_network_learns_is_measured_and_written(place: Path, mocap: Path, backgrounds: Path) -> None:
    photos = ("--photos", backgrounds / "polyhaven")
    bank, held_out = place / "figures.npy", place / "held_out.npy"
    train("matting-bank", "--mocap", mocap, *photos, "--out", bank, "--count", 2)
    train("matting-bank", "--mocap", mocap, *photos, "--out", held_out, "--count", 2, "--held-out", "--doubles")
    learned = ("--bank", bank, *photos, "--size", 48, "--batch", 2, "--fresh", 1, "--loaders", 0)
    train("matting", *learned, "--out", place / "matting", "--iterations", 6)
    facts = json.loads((place / "matting" / "training.json").read_text())
    assert facts["iterations"] == 6
    assert np.isfinite(facts["loss"])
    measured = ("--bank", held_out, *photos, "--weights", place / "matting" / "folded.pt", "--per-family", 1)
    train("matting-measure", *measured, "--out", place / "metrics.json")
    train("matting-doubles", "--bank", held_out, *photos, "--per-family", 1, "--out", place / "doubles.json")
    written = ("--metrics", place / "metrics.json", "--out", place / "matting-shipped")
    train("matting-export", "--run", place / "matting", *written)
    MatteNetwork().load_state_dict(load_file(place / "matting-shipped" / "matting.safetensors"))


def test_the_third_matting_network_begins_with_the_second(place: Path, mocap: Path, backgrounds: Path) -> None:
    bank = place / "doubles.npy"
    train("matting-bank", "--mocap", mocap, "--out", bank, "--count", 1, "--doubles")
    second = programs.__file__.replace("training/programs.py", "matting/data/second_look.safetensors")
    learned = ("--bank", bank, "--photos", backgrounds / "polyhaven", "--size", 48, "--batch", 1, "--fresh", 1)
    began = ("--third", "--go-on", second, "--loaders", 0)
    train("matting", *learned, *began, "--out", place / "third", "--iterations", 3)
    state = torch.load(place / "third" / "folded.pt", weights_only=True)
    assert state["entry.0.weight"].shape[1] == matte_training._CHANNELS[3]


def test_recordings_are_cut_into_clips(mocap: Path, tmp_path: Path) -> None:
    train("clips", "--bvh", mocap, "--out", tmp_path)
    assert len(list(tmp_path.glob("cmu_*_daz*.bvh"))) == 5


@pytest.mark.parametrize("name", [*programs.PROGRAMS, *programs.PRIORS])
def test_every_program_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["train", name, "--help"])
    assert end.value.code == 0
    assert "--out" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["nothing"], "invalid choice"),
        (["joints", "--dev", "."], "required: --out"),
        (["joints", "--dev", ".", "--out", "x"], "give --bank or --fits"),
        (["joints", "--dev", ".", "--bank", ".", "--out", "x"], "joints-bank"),
        (["lifting-bank", "--mocap", ".", "--out", "x"], "cmu_SUBJECT_TRIAL"),
        (["matting-bank", "--mocap", ".", "--out", "x"], "no clips"),
        (["clips", "--bvh", ".", "--out", "x"], "no .bvh"),
        (["acclaim", "--skeletons", ".", "--out", "x"], "SUBJECT.asf"),
        (["confidence", "--out", "."], "no answered case"),
        (["confidence", "--network", ".", "--out", "."], "no answered case"),
        (["limb-speeds", "--singles", ".", "--several", ".", "--out", "."], "no answered case"),
        (["joints-widen", "--run", ".", "--out", "x"], "average.pt"),
        (["joints-bank", "--mocap", ".", "--backgrounds", ".", "--out", "x", "--count", "0"], "1 or more"),
    ],
)
def test_errors_name_the_fix(
    words: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", *words]) == 2
    assert told in capsys.readouterr().err
