"""Inputs and options of a run, stored with its record: `hfb rerun` reads nothing else."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

from hfb.config import Record, RunConfig
from hfb.errors import InputError
from hfb.io.toml_file import to_record
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.inputs.inputs import input_files

RECIPE = "recipe.json"
"""Name of the artifact."""

COMMAND_TAG = "hfb.command"
_LIMIT_BYTES = 64 << 20
Command = Literal["fit", "video"]
RecordT = TypeVar("RecordT", bound=Record)


class GivenFile(Record):
    """A file as the user provided it."""

    path: Path
    sha256: str
    bytes: int


class Recipe(Record):
    """A run's inputs, options and results.

    Attributes:
        config: the configuration, as plain content.
        inputs: the command's record of its inputs, as plain content.
        options: further arguments of the command.
        files: the files of the inputs by role.
        results: sha256 of the files that were made, by the name they were published under.
        code: `hfb.tasks.core.environment.code_version` then.
        lacks: why a command cannot repeat the run, such as images that were no files.
    """

    format: Literal[1] = 1
    command: Command
    config: dict[str, Any]
    inputs: dict[str, Any]
    options: dict[str, Any]
    files: dict[str, GivenFile]
    results: dict[str, str]
    code: str
    lacks: tuple[str, ...] = ()


def recipe(
    command: Command,
    config: RunConfig,
    inputs: Record,
    results: Mapping[str, FileHandle],
    *,
    code: str,
    lacks: tuple[str, ...] = (),
) -> Recipe:
    """Return the recipe of a run that has just finished.

    Args:
        command: which made the run.
        config: all its options.
        inputs: a record of handles, such as `hfb.tasks.inputs.inputs.Inputs`.
        results: files of the result, without those that differ from run to run, such as timings.
        code: `hfb.tasks.core.environment.code_version()`.
        lacks: see `Recipe`.
    """
    files = {
        role: GivenFile(path=file.path, sha256=file.sha256, bytes=file.path.stat().st_size)
        for role, file in input_files(inputs).items()
    }
    options_then = config.model_dump(mode="json")
    return Recipe(
        command=command,
        config=_replace_paths(options_then, _absolute(options_then, {str(file.path) for file in files.values()})),
        inputs=inputs.model_dump(mode="json"),
        options={},
        files=files,
        results={name: file.sha256 for name, file in results.items()},
        code=code,
        lacks=lacks,
    )


def read_recipe(path: Path, run: str) -> Recipe:
    """Read a downloaded recipe.

    Args:
        path: the file.
        run: its title, for messages.

    Raises:
        InputError: it is damaged, or of another version of hfb.
    """
    try:
        if path.stat().st_size > _LIMIT_BYTES:
            raise ValueError("too large")
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"the recipe of run {run} is damaged ({error}); repeat the run's own command") from None
    return to_recipe(content, run)


def to_recipe(content: object, run: str) -> Recipe:
    """Return a recipe of plain content; arguments and errors as of `read_recipe`.

    Args:
        content: of the file.
        run: its title, for messages.
    """
    if not isinstance(content, dict) or content.get("format") != 1:
        raise InputError(f"the recipe of run {run} is of another version of hfb: check that version out to repeat it")
    return to_record(Recipe, content, f"the recipe of run {run}")


def recipe_config(recipe: Recipe, places: Mapping[str, Path], run: str) -> RunConfig:
    """Return the run's options, with the current place of every file that they name.

    Args:
        recipe: of the run.
        places: sha256 -> the file.
        run: its title, for messages.

    Raises:
        InputError: this version of hfb does not know one of them.
    """
    try:
        return to_record(RunConfig, _replace_paths(recipe.config, _now(recipe, places)), f"the options of run {run}")
    except InputError as error:
        raise InputError(f"{error}; it was made by hfb {recipe.code}: check that version out to repeat it") from None


def recipe_inputs(kind: type[RecordT], recipe: Recipe, places: Mapping[str, Path], run: str) -> RecordT:
    """Return the command's inputs, with the current place of every file.

    Args:
        kind: the record of the command's inputs.
        recipe: of the run.
        places: sha256 -> the file.
        run: its title, for messages.

    Raises:
        InputError: this version of hfb takes other inputs.
    """
    return to_record(kind, _replace_paths(recipe.inputs, _now(recipe, places)), f"the inputs of run {run}")


def places_of_paths(recipe: Recipe) -> dict[str, str]:
    """Return path -> sha256 of every file; a path that stands for two files, one of them hidden, is left out.

    Args:
        recipe: of the run.
    """
    found: dict[str, set[str]] = {}
    for file in recipe.files.values():
        found.setdefault(str(file.path), set()).add(file.sha256)
    return {path: several.pop() for path, several in found.items() if len(several) == 1}


def _now(recipe: Recipe, places: Mapping[str, Path]) -> dict[str, str]:
    """Return old path -> current path, and a handle's sha256 -> the current path's."""
    paths = {path: str(places[sha256]) for path, sha256 in places_of_paths(recipe).items() if sha256 in places}
    return paths | {sha256: str(place) for sha256, place in places.items()}


def _absolute(content: Any, paths: Collection[str]) -> dict[str, str]:
    """Return every relative path in plain content that names one of the files -> its absolute path."""
    if isinstance(content, dict | list):
        inner = content.values() if isinstance(content, dict) else content
        return {name: path for one in inner for name, path in _absolute(one, paths).items()}
    whole = str(Path(content).resolve()) if isinstance(content, str) and content else ""
    return {content: whole} if whole in paths else {}


def _replace_paths(content: Any, moved: Mapping[str, str]) -> Any:
    """Replace every moved path in plain content, in handles and options alike."""
    if isinstance(content, dict):
        there = {name: _replace_paths(value, moved) for name, value in content.items() if name != "sha256"}
        if "sha256" not in content:
            return there
        place = moved.get(content["sha256"], there.get("path"))  # a path may have been hidden
        return {**there, "sha256": content["sha256"], **({"path": place} if "path" in content else {})}
    if isinstance(content, list):
        return [_replace_paths(one, moved) for one in content]
    return moved.get(content, content) if isinstance(content, str) else content
