"""All options of a run, from what a user gives and a file of options, over those of a preset. Light to import."""

from collections.abc import Mapping
from typing import Any

from hfb.config import RunConfig, preset
from hfb.io.toml_file import merged, to_record


def check_options(content: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return options with their current names.

    Args:
        content: some options, by section.
        source: where they come from, for errors.

    Raises:
        InputError: one is unknown or impossible.
    """
    return to_record(RunConfig, dict(content), source).model_dump(exclude_unset=True)


def complete_options(given: Mapping[str, Any], from_file: Mapping[str, Any]) -> RunConfig:
    """Return all options: those that are given win over the file's, these over the preset's.

    Args:
        given: checked options.
        from_file: checked options of a file.

    Raises:
        InputError: the options do not go together.
    """
    name = given.get("preset", from_file.get("preset", RunConfig().preset))
    return to_record(RunConfig, merged(merged(preset(name).model_dump(), from_file), given), "options")
