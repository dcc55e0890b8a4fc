"""What `--methods` understands."""

import subprocess
import sys
from pathlib import Path

import pytest

from hfb.config import FitConfig, MultiFrame, RunConfig, Weights, preset
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import METHOD_NAMES, MethodSpec, method_spec


def changed(spec: MethodSpec, base: RunConfig) -> dict[str, object]:
    """The entries of the fit that differ from a preset's."""
    before, after = base.fit.model_dump(), spec.config.fit.model_dump()
    return {name: after[name] for name in before if before[name] != after[name]}


def test_every_plain_name_is_a_method() -> None:
    for name in METHOD_NAMES:
        if "=" not in name:
            spec = method_spec(name)
            assert spec.name == name
            assert spec.oracles == ()
    assert method_spec("best").config == preset("best")
    assert method_spec("paper").config == preset("paper")


@pytest.mark.parametrize("base", ["best", "paper"])
@pytest.mark.parametrize("weight", sorted(Weights.model_fields))
def test_leaving_out_a_term_changes_its_weight_alone(base: str, weight: str) -> None:
    spec = method_spec(f"{base}-no-{weight}")
    whole = preset("best" if base == "best" else "paper")
    assert getattr(spec.config.fit.weights, weight) == 0
    restored = spec.config.fit.weights.model_copy(update={weight: getattr(whole.fit.weights, weight)})
    assert spec.config.fit.model_copy(update={"weights": restored}) == whole.fit


@pytest.mark.parametrize(
    ("name", "base", "difference"),
    [
        ("best-dibr", "best", {"silhouette": "dibr"}),
        ("best-axis-angle", "best", {"rotation": "axis-angle"}),
        ("best-no-kick", "best", {"initial_root_velocity": 0.0}),
        ("best-no-several", "best", {"multi_frame": MultiFrame().model_dump()}),
        ("best-degree1", "best", {"degree": 1}),
        ("best-degree2", "best", {"degree": 2}),
        ("paper-coverage", "paper", {"silhouette": "coverage"}),
        ("best-degree2-dibr", "best", {"degree": 2, "silhouette": "dibr"}),
    ],
)
def test_ablations(name: str, base: str, difference: dict[str, object]) -> None:
    assert changed(method_spec(name), preset("best" if base == "best" else "paper")) == difference


@pytest.mark.parametrize("which", ["pose", "motion"])
def test_priors_count_by_content(which: str, tmp_path: Path) -> None:
    (tmp_path / "options.toml").write_text(f'[prior]\n{which} = "{tmp_path / "prior"}"\n')
    (tmp_path / "prior").write_bytes(b"one")
    first = method_spec(f"mine={tmp_path / 'options.toml'}")
    assert first.files() == [tmp_path / "prior"]
    (tmp_path / "prior").write_bytes(b"two")
    assert method_spec(f"mine={tmp_path / 'options.toml'}") != first


def test_without_the_pyramid_the_iterations_stay() -> None:
    (stage,) = method_spec("best-no-pyramid").config.fit.stages
    assert stage.iterations == sum(one.iterations for one in preset("best").fit.stages)
    assert stage.size_px == 256


def test_of_two_variants_that_begin_alike_the_longer_one_is_meant() -> None:
    assert changed(method_spec("best-no-matte-again"), preset("best")).keys() == {"matte_again"}
    assert changed(method_spec("best-no-matte"), preset("best")).keys() == {"weights"}


def test_frames_and_oracles() -> None:
    spec = method_spec("best-no-image-frames@true-matte@true-start")
    assert spec.frames_alone
    assert spec.oracles == ("true-matte", "true-start")
    assert changed(spec, preset("best")).keys() == {"weights", "matte_again"}
    assert not spec.config.fit.matte_again
    assert method_spec("sfb@true-matte").oracles == ("true-matte",)


def test_oracles_of_real_video() -> None:
    assert method_spec("static@true-front").oracles == ("true-front",)
    assert [method_spec(name).kind for name in ("oracle-middle", "oracle-floor")] == ["middle", "floor"]


@pytest.mark.parametrize(
    "name", ["bset", "", "best-no-nothing", "best-degree9", "static-no-image", "best-", "oracle-x"]
)
def test_an_unknown_name_is_answered_with_all_names(name: str) -> None:
    with pytest.raises(InputError, match="there is no method") as caught:
        method_spec(name)
    assert all(known in str(caught.value) for known in METHOD_NAMES)


def test_only_a_fit_can_be_told_a_height() -> None:
    assert method_spec("best-frames@true-height").oracles == ("true-height",)
    for name in ("static@true-height", "oracle-matte@true-height"):
        with pytest.raises(InputError, match="only a fit can be told"):
            method_spec(name)


def test_an_unknown_oracle() -> None:
    with pytest.raises(InputError, match="@true-matte, @true-start, @true-height, @true-front"):
        method_spec("best@true-mat")


def test_own_options(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('preset = "paper"\nseed = 3\n[fit]\ndegree = 4\n[fit.weights]\nimage = 7.0\n')
    spec = method_spec(f"mine={file}")
    assert (spec.name, spec.kind, spec.config.seed) == ("mine", "fit", 3)
    expected = preset("paper").fit.weights.model_copy(update={"image": 7.0})
    assert changed(spec, preset("paper")) == {"degree": 4, "weights": expected.model_dump()}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[fit]\ndegre = 3\n", "did you mean fit.degree"),
        ('[matting]\nmethod = "known-background"\n', "matting is the same for every method"),
        ("[fit]\nsubframes = 1\n", "subframes"),
    ],
)
def test_own_options_that_are_wrong(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        method_spec(f"mine={file}")


def test_a_spec_changes_with_the_content_of_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "poses"
    folder.mkdir()
    (folder / "case_0001.npz").write_bytes(b"one")
    chains = tmp_path / "chains.toml"
    chains.write_text('[wham]\nposes = "poses"\n')
    first = method_spec("wham", chains)
    assert first == method_spec("wham", chains)
    assert first.files() == [folder / "case_0001.npz"]
    (folder / "case_0001.npz").write_bytes(b"two")
    assert method_spec("wham", chains) != first
    assert MethodSpec.model_validate_json(first.model_dump_json()) == first


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[best]\nposes = "p"\n', "best is a method already"),
        ('[a]\nposes = "p"\nestimator = "matte"\n', "one of them"),
        ('[a]\ndeblurrer = "d.pt"\n', "estimator"),
        ('[a]\nestimator = "e.pt"\n', "pose = 0"),
        ('[a]\nposes = "p"\npictures = "q"\n', "leave them out"),
        ('[a]\nestimator = "matte"\ndeblurer = "x"\n', "did you mean deblurrer"),
        ('["a b"]\nestimator = "matte"\n', "no name of a method"),
        ('[a]\nestimator = "matte"\n[a.deblurrer_layout]\ntimes = [0.5, 0.1]\n', "increase"),
        ('[a]\nestimator = "e.pt"\nestimator_layout = {pose = 0}\n', "cannot be read"),
    ],
)
def test_chains_that_are_wrong(tmp_path: Path, text: str, message: str) -> None:
    chains = tmp_path / "chains.toml"
    chains.write_text(text)
    with pytest.raises(InputError, match=message):
        method_spec("a", chains)


def test_no_method_keeps_what_it_does_not_use() -> None:
    assert method_spec("static").config.fit == FitConfig()


@pytest.mark.integration
def test_naming_methods_is_cheap() -> None:
    module = "hfb.evaluation.baselines.method_spec"
    code = f"import sys, {module}; print([m for m in ('torch', 'numpy', 'numba') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
