"""Sphinx directives that write reference pages from the code: commands from argparse, options from `hfb.config`."""

import argparse
import importlib
import inspect
from collections.abc import Iterator
from typing import Any

from docutils import nodes
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from hfb.config import preset
from hfb.flows.cli.cli import command_line

_METHOD_OPTIONS = "options of the method"


class Commands(SphinxDirective):
    """One section per command of `hfb`, with its usage and its own options."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        self.env.note_reread()
        text = "\n".join(line for name, parser in _commands() for line in _command_page(name, parser))
        return self.parse_text_to_nodes(text, allow_section_headings=True)


class Options(SphinxDirective):
    """One table per section of the configuration, with the values of both presets."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        self.env.note_reread()
        return self.parse_text_to_nodes("\n".join(_option_pages()), allow_section_headings=True)


class ModuleDocstring(SphinxDirective):
    """The docstring of a module as it is written: its first paragraph, then the rest word by word."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return both parts."""
        text = inspect.getdoc(importlib.import_module(self.arguments[0])) or ""
        first, _, rest = text.partition("\n\n")
        return [nodes.paragraph(text=first), nodes.literal_block(rest, rest, language="text")]


def _commands() -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in command_line()._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.items()


def _command_page(name: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    groups = [group for group in parser._action_groups if not (group.title or "").startswith(_METHOD_OPTIONS)]
    own = [action for group in groups for action in group._group_actions if action.help != argparse.SUPPRESS]
    positional = [action for action in own if not action.option_strings]
    named = [one for one in own if one.option_strings and not {"--help", "--help-all"} & {*one.option_strings}]
    takes = " ".join(_positional_name(action) for action in positional)
    yield from (f"## hfb {name}", "", f"{parser.description}.", "", "```text", f"hfb {name} [options] {takes}".rstrip())
    yield from ("```", "")
    if len(groups) < len(parser._action_groups):
        yield from ("It also takes every [option of the method](options.md).", "")
    yield from ("| argument | meaning |", "|---|---|")
    formatter = parser._get_formatter()
    for action in positional + named:
        shown = _positional_name(action) if not action.option_strings else _flag(action)
        yield f"| `{_cell(shown)}` | {_cell(formatter._expand_help(action) if action.help else '')} |"
    yield ""


def _positional_name(action: argparse.Action) -> str:
    if action.choices and not action.metavar:
        return "{" + ",".join(map(str, action.choices)) + "}"
    name = str(action.metavar or action.dest)
    return {"+": f"{name} [{name} ...]", "?": f"[{name}]"}.get(str(action.nargs), name)


def _flag(action: argparse.Action) -> str:
    flag = max(action.option_strings, key=len)
    if action.nargs == 0:
        return flag
    value = "|".join(map(str, action.choices)) if action.choices and not action.metavar else action.metavar
    return f"{flag} {value or action.dest.upper()}"


def _option_pages() -> Iterator[str]:
    best, paper = preset("best"), preset("paper")
    loose = [(name, field) for name, field in type(best).model_fields.items() if not _is_section(best, name)]
    yield from _table("general", "Options of the whole run", loose, best, paper, "")
    for name in type(best).model_fields:
        if _is_section(best, name):
            yield from _section(name, getattr(best, name), getattr(paper, name))


def _section(path: str, best: BaseModel, paper: BaseModel) -> Iterator[str]:
    fields = [(name, field) for name, field in type(best).model_fields.items() if not _is_section(best, name)]
    yield from _table(path, (type(best).__doc__ or "").strip().splitlines()[0], fields, best, paper, f"{path}.")
    for name in type(best).model_fields:
        if _is_section(best, name):
            yield from _section(f"{path}.{name}", getattr(best, name), getattr(paper, name))


def _table(
    title: str, summary: str, fields: list[tuple[str, FieldInfo]], best: BaseModel, paper: BaseModel, prefix: str
) -> Iterator[str]:
    yield from (f"## {title}", "", f"{summary.rstrip('.')}.", "", "| option | `best` | `paper` | meaning |")
    yield "|---|---|---|---|"
    for name, field in fields:
        values = [_value(getattr(record, name)) for record in (best, paper)]
        flag = f"--{prefix}{name}".replace("_", "-")
        yield f"| `{flag}` | {values[0]} | {values[1]} | {_cell(field.description or '')} |"
    yield ""


def _is_section(record: BaseModel, name: str) -> bool:
    return isinstance(getattr(record, name), BaseModel)


def _value(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, tuple):
        if value and isinstance(value[0], BaseModel):
            return "<br>".join(_cell(", ".join(f"{k} {v}" for k, v in one)) for one in value)
        return f"`{','.join(map(str, value)) or 'none'}`"
    return f"`{_cell(str(value).lower() if isinstance(value, bool) else str(value))}`"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("hfb-commands", Commands)
    app.add_directive("hfb-options", Options)
    app.add_directive("hfb-docstring", ModuleDocstring)
    return {"parallel_read_safe": True}
