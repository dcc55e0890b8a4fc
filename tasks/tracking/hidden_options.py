"""Options of a recorded run that held a secret: the record hides them, and a repetition needs them again."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from hfb.errors import InputError
from hfb.tasks.telemetry.secrets import HIDDEN
from hfb.tasks.tracking.recipe import Recipe, places_of_paths

_INPUTS = "inputs"
_OF_PICTURES = (_INPUTS, "camera", "exposure", "video")


def hidden_options(recipe: Recipe) -> tuple[str, ...]:
    """Return the options whose values a recipe hides, such as ``init.person``; files are identified by content instead.

    Args:
        recipe: of the run.
    """
    known = set(places_of_paths(recipe))
    content = {**recipe.config, _INPUTS: recipe.inputs}
    return tuple(".".join(keys) for keys in _hidden(content, known, ()))


def with_options(recipe: Recipe, options: Mapping[str, str], run: str) -> Recipe:
    """Return the recipe with its hidden options filled in.

    Args:
        recipe: of the run.
        options: option -> value.
        run: its title, for messages.

    Raises:
        InputError: one is missing, or one is given that the record does not hide.
    """
    hidden = hidden_options(recipe)
    if held := [name for name in options if name not in hidden]:
        raise InputError(f"a repetition keeps the options of run {run}: leave --option {held[0]} out")
    if missing := [name for name in hidden if name not in options]:
        again = " ".join(f"--option {name}=VALUE" for name in missing)
        raise InputError(f"run {run} had a secret in {', '.join(missing)}, which its record hides: give {again}")
    content: dict[str, Any] = {**recipe.config, _INPUTS: recipe.inputs}
    for name, value in options.items():
        content = _with(content, name.split("."), value)
    return recipe.model_copy(update={_INPUTS: content.pop(_INPUTS), "config": content})


def for_pictures(recipe: Recipe, run: str) -> Recipe:
    """Return the recipe without its hidden options, if the images do not depend on them.

    Args:
        recipe: of the run.
        run: its title, for messages.

    Raises:
        InputError: the images depend on a hidden option.
    """
    hidden = hidden_options(recipe)
    if needed := [name for name in hidden if name.split(".")[0] in _OF_PICTURES]:
        raise InputError(f"run {run} had a secret in {needed[0]}, which its record hides: make the result again")
    config = recipe.config
    for name in hidden:
        config = _without(config, name.split("."))
    return recipe.model_copy(update={"config": config})


def _hidden(content: Any, known: Collection[str], keys: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    if isinstance(content, dict):
        for name, value in content.items():
            if not (name == "path" and "sha256" in content):
                yield from _hidden(value, known, (*keys, name))
    elif isinstance(content, list):
        if any(True for one in content for _ in _hidden(one, known, keys)):
            yield keys
    elif isinstance(content, str) and HIDDEN in content and content not in known:
        yield keys


def _with(content: dict[str, Any], keys: list[str], value: str) -> dict[str, Any]:
    inner = _with(content[keys[0]], keys[1:], value) if len(keys) > 1 else value
    return {**content, keys[0]: inner}


def _without(content: dict[str, Any], keys: list[str]) -> dict[str, Any]:
    inner = {keys[0]: _without(content[keys[0]], keys[1:])} if len(keys) > 1 else {}
    return {name: value for name, value in content.items() if name != keys[0]} | inner
