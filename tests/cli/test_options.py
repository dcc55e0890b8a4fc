"""Options come from flags, a file, a preset and defaults, in this order."""

import argparse
from pathlib import Path

import pytest

from hfb.config import RunConfig, preset
from hfb.errors import InputError
from hfb.flows.cli.options import add_config_flags, run_config
from hfb.flows.deployed import Options


def config_of(*words: str, file: Path | None = None) -> RunConfig:
    parser = argparse.ArgumentParser()
    add_config_flags(parser)
    return run_config(parser.parse_args(words, argparse.Namespace(config=file)))


def write(folder: Path, text: str) -> Path:
    path = folder / "run.toml"
    path.write_text(text)
    return path


def test_nothing_given_is_the_default_preset() -> None:
    assert config_of() == preset("best")
    assert config_of("--preset", "paper") == preset("paper")


def test_flag_over_file_over_preset(tmp_path: Path) -> None:
    file = write(tmp_path, 'preset = "paper"\nseed = 4\n[fit]\nsubframes = 5\ndegree = 3\n[fit.weights]\nimage = 2.5')
    config = config_of("--fit.subframes", "7", file=file)
    paper = preset("paper").fit
    assert config.preset == "paper"
    assert config.seed == 4
    assert (config.fit.subframes, config.fit.degree, config.fit.weights.image) == (7, 3, 2.5)
    assert config.fit.weights.matte == paper.weights.matte
    assert config.fit.silhouette == paper.silhouette
    assert config_of("--preset", "best", file=file).fit.silhouette == preset("best").fit.silhouette


def test_both_spellings_and_lists() -> None:
    assert config_of("--fit.texture-px", "32") == config_of("--fit.texture_px", "32")
    stages = config_of("--fit.stages", '[{"size_px": 40, "iterations": 2, "cosine": true}]').fit.stages
    assert [(stage.size_px, stage.iterations, stage.cosine) for stage in stages] == [(40, 2, True)]


def test_every_key_is_a_flag() -> None:
    parser = argparse.ArgumentParser()
    add_config_flags(parser)
    keys = {action.dest.removeprefix("config:") for action in parser._actions if action.dest.startswith("config:")}

    def leaves(content: dict, prefix: str = "") -> set[str]:
        found = set()
        for name, value in content.items():
            found |= leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name}
        return found

    assert keys == leaves(RunConfig().model_dump())


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--fit.subframes", "99"), "fit.subframes: .*64.*'99'"),
        (("--fit.subframes", "many"), "fit.subframes: .*integer"),
        (("--preset", "fast"), "preset: .*'paper' or 'best'"),
        (("--fit.stages", "[{"), "fit.stages is not valid JSON"),
        (("--fit.stages", '[{"size_px": 64}]'), "fit.stages.0.iterations: "),
    ],
)
def test_impossible_values_are_named(words: tuple[str, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        config_of(*words)


def test_the_file_is_named_too(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run\.toml: unknown option fit.subframe; did you mean fit.subframes"):
        config_of(file=write(tmp_path, "[fit]\nsubframe = 3"))
    with pytest.raises(InputError, match="does not exist"):
        config_of(file=tmp_path / "none.toml")


EARLIER = {
    "across": ("xy_weight", "0.3"),
    "at_once": ("batch_size", "7"),
    "size_moves_away": ("keep_image_size", "false"),
    "root_kick": ("initial_root_velocity", "0.5"),
    "several.image": ("multi_frame.image", "5"),
}


def test_a_flag_shows_the_kind_and_the_unit_of_its_value() -> None:
    parser = argparse.ArgumentParser()
    add_config_flags(parser)
    shown = {one.option_strings[0]: one.metavar for one in parser._actions if one.help != argparse.SUPPRESS}
    numbers = {
        "--fit.height-m": "M",
        "--exposure.seconds": "S",
        "--exposure.fps": "FPS",
        "--camera.focal-px": "PX",
        "--camera.tilt-deg": "DEG",
        "--camera.floor": "estimate|X,Y,Z,D",
        "--matting.half": "true|false",
        "--fit.subframes": "N",
        "--fit.origin": "X",
        "--export.amass-rate": "30|60|120",
        "--export.formats": "NAME,...",
    }
    assert {flag: shown[flag] for flag in numbers} == numbers
    assert {flag for flag, metavar in shown.items() if metavar == "JSON"} == {"--fit.stages", "--video.stages"}


@pytest.mark.parametrize("earlier", EARLIER)
def test_earlier_names_are_read_and_the_new_one_is_named(
    earlier: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As a flag in both spellings, in a file, in a recorded run, and in the options of a deployment."""
    new, value = EARLIER[earlier]
    wanted = config_of(f"--fit.{new}", value)
    caplog.clear()
    assert config_of(f"--fit.{earlier}", value) == config_of(f"--fit.{earlier.replace('_', '-')}", value) == wanted
    assert f"--fit.{new.replace('_', '-')}" in caplog.text
    caplog.clear()
    assert config_of(file=write(tmp_path, f"[fit]\n{earlier} = {value}")) == wanted
    room, _, key = earlier.partition(".")
    assert f"fit.{room} is now called fit.{new.partition('.')[0]}" in caplog.text
    recorded = wanted.model_dump(mode="json")
    present = recorded["fit"].pop(new.partition(".")[0])
    recorded["fit"][room] = present
    assert RunConfig.model_validate(recorded) == wanted
    options = Options.model_validate({"fit": {room: {key: value} if key else value}})
    assert options.config() == wanted


def test_an_option_by_both_of_its_names_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path, "[fit]\nacross = 0.3\nxy_weight = 0.4")
    with pytest.raises(InputError, match=r"run\.toml: fit: across and xy_weight are the same option; leave out across"):
        config_of(file=file)


def test_a_new_name_wins_over_the_earlier_one_of_a_weaker_place(tmp_path: Path) -> None:
    file = write(tmp_path, "[fit]\nacross = 0.3\nroot_kick = 0.5")
    fit = config_of("--fit.xy-weight", "0.4", file=file).fit
    assert (fit.xy_weight, fit.initial_root_velocity) == (0.4, 0.5)
