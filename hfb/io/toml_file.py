"""TOML into frozen records, with errors that name the entry and the fix."""

import difflib
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from hfb.errors import InputError
from hfb.io.safe_folder import check_readable

RecordT = TypeVar("RecordT", bound=BaseModel)

_BYTE_LIMIT = 1 << 20
_LONGEST_NAME = 32  # parts; what the parser does with a.b.c... grows with the square of their number
_SHOWN = 80


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: the file.

    Raises:
        InputError: the file is missing or no TOML.
    """
    try:
        check_readable(path)
        if path.stat().st_size > _BYTE_LIMIT:
            raise InputError(f"{path} is too large for a TOML file of options; give another file")
        text = path.read_text(encoding="utf-8-sig")  # editors under Windows begin it with a mark
        if any(part.count(".") > _LONGEST_NAME for part in re.split(r"[=,{}\[\]\n]", text)):
            raise InputError(f"{path} has a name of more than {_LONGEST_NAME} parts; no option has")
        return tomllib.loads(text)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a TOML file: it is not text in UTF-8") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except RecursionError as error:
        raise InputError(f"{path} is not valid TOML: brackets within brackets without end") from error
    except ValueError as error:  # TOMLDecodeError, and numbers of thousands of digits
        raise InputError(f"{path} is not valid TOML: {str(error)[:_SHOWN]}") from error


def to_record(record: type[RecordT], content: dict[str, Any], source: str) -> RecordT:
    """Validate plain content and build a record.

    Args:
        record: class of the result.
        content: plain values.
        source: source of the content, for errors.

    Raises:
        InputError: an entry is unknown or impossible; the sentence names the first one.
    """
    try:
        return record.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{source}: {_sentence(error.errors()[0], record)}") from error


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Replace entries of plain content, at any depth.

    Args:
        base: content.
        over: entries that replace those of the base.
    """
    content = dict(base)
    for key, value in over.items():
        old = content.get(key)
        content[key] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return content


def _sentence(error: ErrorDetails, record: type[BaseModel]) -> str:
    name = ".".join(str(part) for part in error["loc"])[:_SHOWN]
    if error["type"] == "extra_forbidden":
        known = _names(record)
        close = difflib.get_close_matches(name, known, n=1) or [k for k in known if k.endswith("." + name)][:1]
        return f"unknown option {name}" + (f"; did you mean {close[0]}?" if close else "")
    reason = error["msg"].removeprefix("Value error, ")
    if not name:
        return reason
    value = error["input"]
    return f"{name}: {reason}" + ("" if isinstance(value, dict) else f" (given: {_in_short(value)})")


def _in_short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _names(record: type[BaseModel], prefix: str = "") -> list[str]:
    names = []
    for name, field in record.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            names += _names(inner, f"{prefix}{name}.")
        else:
            names.append(prefix + name)
    return names
