"""Options of a call in Python: the command line's names as keyword arguments, checked by the same records."""

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from hfb.api.given_images import path_of
from hfb.config import InitConfig, MattingConfig, PriorConfig, RunConfig
from hfb.errors import InputError
from hfb.io.run_options import check_options, complete_options
from hfb.io.toml_file import merged, read_toml

_OF_FRAMES = ("fit", "camera", "exposure", "body", "init", "matting", "prior")
_SHORT = {"init_weights": "init.weights", "matting_weights": "matting.weights"}
_METHODS: Mapping[str, tuple[type[InitConfig | MattingConfig | PriorConfig], str, str]] = {
    "init": (InitConfig, "method", "file"),
    "matting": (MattingConfig, "method", "method"),
    "prior": (PriorConfig, "kind", "pose"),
}
"""Section -> its record, the entry that a known word sets, and the one that any other word or a path sets."""


def config_of(options: Mapping[str, object], file: str | Path | None = None, *, clip: bool = False) -> RunConfig:
    """Return all options of a fit.

    Args:
        options: by name: ``preset``, ``seed``, an entry of any section by its own name (``height_m``), or a section
            as a mapping (``fit={"subframes": 4}``); dotted names as on the command line are understood, too.
        file: a TOML file of options, over which the others win.
        clip: whether options of clips count.

    Raises:
        InputError: a name is unknown or means several options, or a value is impossible.
    """
    given: dict[str, Any] = {}
    sections = (*_OF_FRAMES, "video") if clip else _OF_FRAMES
    for name, value in options.items():
        given = merged(given, _nested(_full_name(name, sections), value))
    from_file = check_options(read_toml(path_of(file)), str(file)) if file is not None else {}
    return complete_options(check_options(given, "options"), from_file)


def name_parameters(sentence: str) -> str:
    """Return a sentence for the command line with the name in Python behind every option: ``--init (init=...) FILE``.

    Args:
        sentence: of a result's warning or remark.
    """

    def named(flag: re.Match[str]) -> str:
        name = flag[1].replace("-", "_")
        section, _, entry = name.partition(".")
        if not entry and section in ("background", *_METHODS):
            return f"{flag[0]} ({section}=...)"
        try:
            known = _full_name(entry or section, _OF_FRAMES) == name
        except InputError:
            known = False
        if known:
            return f"{flag[0]} ({entry}=...)"
        return f"{flag[0]} ({section}={{{entry!r}: ...}})" if section in _OF_FRAMES and entry else flag[0]

    return re.sub(r"--([a-z][a-z0-9-]*(?:\.[a-z][a-z0-9-]*)*)", named, sentence)


def _nested(name: str, value: object) -> dict[str, Any]:
    """Return an option within its section."""
    if name in _METHODS and isinstance(value, str | Path):
        record, of_word, of_file = _METHODS[name]
        known = isinstance(value, str) and value in get_args(record.model_fields[of_word].annotation)
        if name == "init" and not known:
            return {name: {"method": "file", of_file: value}}
        return {name: {of_word if known else of_file: value}}
    if name == "body" and isinstance(value, str | Path):
        return {name: {"model": value}}
    for part in reversed(name.split(".")):
        value = {part: value}
    return value if isinstance(value, dict) else {}


def _full_name(name: str, sections: Sequence[str]) -> str:
    """Return the dotted name of an option: of several of one name, the fit's."""
    own = {"preset", "seed", *sections}
    if name in own or name.partition(".")[0] in sections:
        return name
    if name in _SHORT:
        return _SHORT[name]
    entries = {section: list(type(getattr(RunConfig(), section)).model_fields) for section in sections}
    found = [section for section, names in entries.items() if name in names]
    if found[:1] == ["fit"] or len(found) == 1:
        return f"{found[0]}.{name}"
    if found:
        raise InputError(f"the option {name} is one of {' and '.join(found)}: say which, such as {found[0]}=...")
    known = [*own, *_SHORT, *(entry for names in entries.values() for entry in names)]
    close = difflib.get_close_matches(name, known, n=2)
    raise InputError(f"unknown option {name}" + (f"; did you mean {' or '.join(close)}?" if close else ""))
