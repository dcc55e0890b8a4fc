"""Documents: short where they must be, links that resolve, commands that parse, pictures that are current."""

import argparse
import importlib.util
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from PIL import Image
from pydantic import BaseModel

import hfb
from hfb.config import preset
from hfb.flows.cli.cli import command_line
from tests.documents import ROOT, anchors, code_blocks, documents, hfb_commands, links, prose

_README = ROOT / "README.md"
_EXPERIMENTS = ROOT / "docs" / "experiments"
_MOST_WORDS = 40


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_sizes() -> None:
    assert len(_README.read_text().splitlines()) <= 150
    assert (ROOT / "ARCHITECTURE.md").stat().st_size <= 12 << 10


def test_the_readme_begins_with_demo_and_test() -> None:
    commands = [line.split("#")[0].strip() for _, code in code_blocks(_README, "bash") for line in code.splitlines()]
    assert commands[:2] == ["make demo", "make test"]


@pytest.mark.parametrize("name", ["README.md", "ARCHITECTURE.md"])
def test_no_sentence_is_long(name: str) -> None:
    sentences = [one for text in prose(ROOT / name) for one in re.split(r"(?<=[.!?])\s+", text)]
    assert [one for one in sentences if len(re.findall(r"\w[\w'.-]*", one)) > _MOST_WORDS] == []


@pytest.mark.parametrize("path", documents(), ids=_name)
def test_links_resolve(path: Path) -> None:
    broken = []
    for target in links(path):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = (path.parent / file).resolve() if file else path
        if not there.is_file() or (anchor and there.suffix == ".md" and anchor not in anchors(there)):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("path", [path for path in documents() if any(hfb_commands(path))], ids=_name)
def test_commands_parse(path: Path) -> None:
    for words in hfb_commands(path):
        _, unknown = command_line().parse_known_args(words)
        assert unknown == [], words


def test_examples_of_the_help_parse() -> None:
    commands = next(
        action.choices for action in command_line()._actions if action.dest == argparse.SUPPRESS and action.choices
    )
    lines = [line for command in commands.values() for line in command.examples]
    assert len(lines) > 8
    for line in lines:
        assert command_line().parse_known_args(line.split()[1:])[1] == []


def test_nobody_is_sent_to_a_package_index_for_hfb() -> None:
    """The name there is not ours: whoever installed by it would run a stranger's program."""
    sources = [path for room in ("hfb", "tasks", "flows", "infra", "tests") for path in (ROOT / room).rglob("*.py")]
    told = re.compile(r"install\s+['\"]?hfb(?![-\w])")
    assert [path for path in [*documents(), *sources] if told.search(path.read_text())] == []


def test_options_in_documents_exist() -> None:
    """Keys such as `fit.degree` or `--video.average`; CHANGELOG and experiments name those of their day."""
    known = set(_option_keys(preset("best")))
    sections = "|".join(sorted({key.split(".")[0] for key in known if "." in key}))
    pattern = re.compile(rf"`(?:--)?((?:{sections})(?:\.[a-z][a-z_-]*)+)(?<!\.npy)(?<!\.yml)[ `]")
    pages = [path for path in documents() if path.name != "CHANGELOG.md" and path.parent != _EXPERIMENTS]
    named = {(_name(path), key.replace("-", "_")) for path in pages for key in pattern.findall(path.read_text())}
    assert named
    assert [one for one in sorted(named) if one[1] not in known] == []


def _option_keys(record: BaseModel, prefix: str = "") -> Iterator[str]:
    for name in type(record).model_fields:
        value = getattr(record, name)
        yield f"{prefix}{name}"
        if isinstance(value, BaseModel):
            yield from _option_keys(value, f"{prefix}{name}.")


def test_figures_of_the_readme_are_those_of_the_results() -> None:
    results = [_cells(line) for line in (ROOT / "docs" / "results.md").read_text().splitlines()]
    rows = [_cells(line) for line in _README.read_text().splitlines() if re.match(r"\| .*\d+ / \d+ \|", line)]
    assert len(rows) >= 3
    for name, *figures in rows:
        (there,) = [row for row in results if row[:1] == [name]]
        assert set(figures) <= {part for cell in there for part in (cell, cell.rpartition("-> ")[2])}, name


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")] if line.startswith("|") else []


def test_experiments_are_indexed() -> None:
    index = (_EXPERIMENTS / "index.md").read_text()
    months = [path for path in _EXPERIMENTS.glob("*.md") if path.stem != "index"]
    entries = {
        f"{path.name}#{anchor}" for path in months for anchor in anchors(path) if re.match(r"\d{4}-\d\d-", anchor)
    }
    assert entries
    assert {target for target in links(_EXPERIMENTS / "index.md") if "#" in target} == entries
    assert len(re.findall(r"^\| \d{4}-", index, re.MULTILINE)) == len(entries)


def test_lines_of_experiments_are_short() -> None:
    """Rows of tables cannot be broken."""
    lines = [line for path in _EXPERIMENTS.glob("*.md") for line in path.read_text().splitlines()]
    assert [line for line in lines if len(line) > 99 and not line.lstrip().startswith("|")] == []


def test_the_picture_of_the_rooms_is_current() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    drawn = _script("rooms").draw_rooms(project)
    assert (ROOT / "docs" / "images" / "rooms.svg").read_text() == drawn, "run `python docs/images/rooms.py`"


def test_the_moving_picture_moves_and_is_small() -> None:
    path = ROOT / "docs" / "images" / "moving.webp"
    assert path.stat().st_size <= _script("moving").LARGEST_BYTES
    with Image.open(path) as image:
        assert image.n_frames > 8


def _script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "images" / f"{name}.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _parts_of_check() -> list[str]:
    (line,) = re.findall(r"^check: (.+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    return line.split()


def test_hooks_run_what_check_runs() -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    (local,) = hooks
    assert local["repo"] == "local"
    assert [hook["entry"] for hook in local["hooks"]] == [f"make {part}" for part in _parts_of_check()]
    assert all(hook["language"] == "system" and not hook["pass_filenames"] for hook in local["hooks"])


def test_the_workflow_runs_ci() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    (job,) = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == ["bash .ci/run"]
    assert (ROOT / ".ci" / "run").read_text().rstrip().splitlines()[-2:] == ["make check", "make test"]
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
    versions = [one.rpartition(" ")[2] for one in classifiers if re.search(r":: 3\.\d+$", one)]
    assert job["strategy"]["matrix"]["python"] == versions


def test_the_citation_names_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == hfb.__version__
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
