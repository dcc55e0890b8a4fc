"""Options of a run from four sources: flag over --config file over preset over default.

The flags are made from the records in hfb/config.py, one per key (``--fit.subframes 8``). argparse, since it costs
nothing to import: `hfb --help` has to answer at once.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from hfb.config import OWN_NETWORKS, RENAMED_FIT_OPTIONS, Floor, InitConfig, RunConfig, preset
from hfb.errors import InputError
from hfb.io.run_options import check_options, complete_options
from hfb.io.toml_file import merged, read_toml

_log = logging.getLogger(__name__)
CONFIG_PREFIX = "config:"
"""Of the parsed options that are keys of the configuration."""

_DEFAULT_PRESET = RunConfig().preset
_UNITS = {"_px": "PX", "_m": "M", "_deg": "DEG", "_s": "S", "seconds": "S", "fps": "FPS"}
_NEED_WEIGHTS = {"matting": ("bgmv2", "rvm"), "init": OWN_NETWORKS}


def add_config_flags(parser: argparse.ArgumentParser) -> None:
    """Declare one flag per key of the configuration; only flags that the user gives are set.

    Args:
        parser: of the command.
    """
    group = parser.add_argument_group(
        "options of the method", f"defaults are those of --preset {_DEFAULT_PRESET}; a flag wins over --config"
    )
    _add_short_flags(group)
    shown = preset(_DEFAULT_PRESET)
    for name, field, default in _keys(shown):
        described = (field.description or "").replace("%", "%%")
        flag = f"--{name.replace('_', '-')}"
        group.add_argument(
            flag,
            dest=CONFIG_PREFIX + name,
            default=argparse.SUPPRESS,
            metavar=placeholder(name, field),
            help=described if default is None else f"{described} [{_shown(default)}]".strip(),
        )
        if "_" in name:  # as the file writes it
            group.add_argument(
                f"--{name}", dest=CONFIG_PREFIX + name, default=argparse.SUPPRESS, help=argparse.SUPPRESS
            )
        for old, new in RENAMED_FIT_OPTIONS.items():
            if name == f"fit.{new}" or name.startswith(f"fit.{new}."):
                earlier = name.replace(new, old, 1)
                spellings = sorted({f"--{earlier}", f"--{earlier.replace('_', '-')}"})
                group.add_argument(
                    *spellings,
                    dest=CONFIG_PREFIX + name,
                    action=_EarlierName,
                    default=argparse.SUPPRESS,
                    help=argparse.SUPPRESS,
                )


class _EarlierName(argparse.Action):
    """Sets the key of a renamed flag, with a warning that gives the new name."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        key = self.dest.removeprefix(CONFIG_PREFIX)
        _log.warning("the flag %s is now called --%s; use the new name", option, key.replace("_", "-"))
        setattr(namespace, self.dest, values)


def _add_short_flags(group: argparse._ArgumentGroup) -> None:
    """Declare short flags for both ends: `--init`, `--matting`, and the files of their networks."""
    short: tuple[tuple[str, str, str], ...] = (
        ("init", "FILE|auto|mediapipe|matte|metro|keypoints", "another system's result, or how to find a first body"),
        ("init-weights", "FILE", "as --init.weights"),
        ("matting", "network|known-background|bgmv2|rvm", "how the person is cut out of the picture [network]"),
        ("matting-weights", "FILE", "as --matting.weights"),
    )
    for name, metavar, described in short:
        group.add_argument(f"--{name}", metavar=metavar, action=_Short, default=argparse.SUPPRESS, help=described)
    group.add_argument(
        "--weights",
        metavar="FILE",
        default=argparse.SUPPRESS,
        help="of the network that --matting or --init names, where only one of them needs a file",
    )


class _Short(argparse.Action):
    """Sets the key of a short flag."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        room, _, key = self.option_strings[0].removeprefix("--").partition("-")
        if room == "init" and not key and values not in get_args(InitConfig.model_fields["method"].annotation):
            setattr(namespace, f"{CONFIG_PREFIX}init.file", values)
            values = "file"
        setattr(namespace, f"{CONFIG_PREFIX}{room}.{key or 'method'}", values)


def run_config(args: argparse.Namespace) -> RunConfig:
    """Return the configuration from flags, --config file and preset.

    Args:
        args: the parsed options.

    Raises:
        InputError: an unknown key or an impossible value, named with where it came from.
    """
    path: Path | None = args.config
    from_file = check_options(read_toml(path), str(path)) if path else {}
    from_flags = _nest({key: value for key, value in vars(args).items() if key.startswith(CONFIG_PREFIX)})
    if "weights" in args:
        from_flags = merged(from_flags, {_room_of_weights(merged(from_file, from_flags)): {"weights": args.weights}})
    from_flags = check_options(from_flags, "options")
    return complete_options(from_flags, from_file)


def _room_of_weights(chosen: Mapping[str, Any]) -> str:
    """Return which part of the configuration --weights belongs to.

    Raises:
        InputError: no method uses it, or both do.
    """
    methods = {room: chosen.get(room, {}).get("method") for room in _NEED_WEIGHTS}
    rooms = [room for room, method in methods.items() if method in _NEED_WEIGHTS[room]]
    if len(rooms) != 1:
        said = "both --matting and --init" if rooms else "neither --matting bgmv2|rvm nor --init metro|keypoints"
        raise InputError(f"--weights: {said} ask for a file; use --matting-weights and --init-weights")
    return rooms[0]


def _keys(record: BaseModel, prefix: str = "") -> Iterator[tuple[str, FieldInfo, Any]]:
    for name, field in type(record).model_fields.items():
        value = getattr(record, name)
        if isinstance(value, BaseModel):
            yield from _keys(value, f"{prefix}{name}.")
        else:
            yield prefix + name, field, value


def placeholder(name: str, field: FieldInfo) -> str:
    """Return what stands for a flag's value: its words, its unit, or its kind.

    Args:
        name: of the option.
        field: of the record.
    """
    if field.annotation == Floor | None:
        return "estimate|X,Y,Z,D"
    kind = _bare(field.annotation)
    if get_origin(kind) is tuple:
        return "NAME,..." if get_origin(_bare(get_args(kind)[0])) is Literal else "JSON"
    if get_origin(kind) is Literal:
        return "|".join(map(str, get_args(kind)))
    unit = next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), None)
    return unit or {int: "N", float: "X", bool: "true|false", Path: "FILE", str: "NAME"}[kind]


def _bare(annotation: Any) -> Any:
    """Return a type without its bounds and without None."""
    if get_origin(annotation) in (Annotated, Union, UnionType):
        return _bare(get_args(annotation)[0])
    return annotation


def _shown(default: Any) -> str:
    if isinstance(default, tuple):
        if all(isinstance(one, str) for one in default):
            return ",".join(default) or "none"
        return json.dumps([one.model_dump(exclude_defaults=True) for one in default]).replace("%", "%%")
    return str(default).lower() if isinstance(default, bool) else str(default)


def _nest(flags: Mapping[str, str]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for key, text in flags.items():
        *path, name = key.removeprefix(CONFIG_PREFIX).split(".")
        inner = content
        for part in path:
            inner = inner.setdefault(part, {})
        inner[name] = _parse(key.removeprefix(CONFIG_PREFIX), text)
    return content


def _parse(key: str, text: str) -> Any:
    """Parse a flag's text: pydantic reads numbers and names; a list of records, such as fit.stages, is JSON."""
    if not text.startswith(("[", "{")):
        return text
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"options: {key} is not valid JSON: {error}") from error
