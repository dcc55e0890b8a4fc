"""Parsers with two pages of help: `--help` shows what most runs need, `--help-all` every option."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from hfb.errors import InputError

SHELLS = ("bash", "zsh", "fish")
_USUAL_KEYS = (
    "--camera.focal-px",
    "--exposure.seconds",
    "--exposure.fps",
    "--fit.height-m",
    "--export.formats",
)
_RARE = (
    "--verbose",
    "--store",
    "--truth",
    "--window",
    "--wait",
    "--inputs",
    "--init-weights",
    "--matting-weights",
    "--weights",
    "--motions",
    "--backgrounds",
    "--textures",
    "--fill",
    "--easy",
    "--chains",
)
_FILES = ("FILE", "PLATE", "FRAME", "CLIP", "RESULT")


class Parser(argparse.ArgumentParser):
    """A parser whose errors are `InputError`, and whose `--help` leaves out what few runs need.

    Args:
        prog: how the command is called; None for the program's name.
        examples: command lines at the end of the help.
        **options: as of argparse.
    """

    def __init__(self, prog: str | None = None, *, examples: Iterable[str] = (), **options: Any) -> None:
        super().__init__(prog, allow_abbrev=False, **options)
        self.examples = tuple(examples)
        self.add_argument("--help-all", action=_HelpAll, nargs=0, help="show every option, and exit")

    def error(self, message: str) -> NoReturn:
        """Raise InputError.

        Args:
            message: of argparse.
        """
        raise InputError(f"{message}; see `{self.prog} --help`")

    def format_help(self) -> str:
        """Return the page of what most runs need."""
        return self._page([action for action in self._actions if not _is_rare(action)])

    def format_help_all(self) -> str:
        """Return the page of all options."""
        return self._page(self._actions)

    def _page(self, actions: list[argparse.Action]) -> str:
        if len(actions) == len(self._actions):  # nothing is left out: there is no other page
            actions = [action for action in actions if not isinstance(action, _HelpAll)]
        formatter = self.formatter_class(prog=f"{self.prog} [options]")
        formatter.add_usage(self.usage, [one for one in actions if one.required or not one.option_strings], [])
        formatter.add_text(self.description)
        for group in self._action_groups:
            formatter.start_section(group.title)
            formatter.add_text(group.description)
            formatter.add_arguments([action for action in group._group_actions if action in actions])
            formatter.end_section()
        examples = "".join(f"  {line}\n" for line in self.examples)
        return formatter.format_help() + (f"\nexamples:\n{examples}" if examples else "")


class _HelpAll(argparse.Action):
    """Prints the page of all options."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        assert isinstance(parser, Parser)
        print(parser.format_help_all(), end="")
        parser.exit()


class PrintCompletion(argparse.Action):
    """Prints the script by which a shell completes commands, options and files."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Print the script, and exit.

        Args:
            parser: of all commands.
            namespace: unused.
            values: the shell.
            option: unused.
        """
        import shtab

        for action in _every_action(parser):
            if action.metavar == "DIR":
                action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
            elif action.type is Path or str(action.metavar).startswith(_FILES):
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        print(shtab.complete(parser, shell=values))
        parser.exit()


def _every_action(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of all commands."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _every_action(command)


def _is_rare(action: argparse.Action) -> bool:
    flag = next(iter(action.option_strings), "")
    return flag in _RARE or ("." in flag and flag not in _USUAL_KEYS)
