"""Reading of JSON files of unknown origin: limited in size, with errors that name the file."""

import json
import math
from pathlib import Path
from typing import Any, NoReturn

from hfb.errors import InputError
from hfb.io.safe_folder import read_head

JSON_LIMIT_BYTES = 32 << 20
"""Python takes some twenty times as much for nested lists."""

_DEEPEST = 32


def read_json(path: Path, fix: str = "make the result again", root: Path | None = None) -> Any:
    """Read a JSON file; every number in it is finite.

    Args:
        path: the file.
        fix: ends the sentence of an error.
        root: the folder below which no link is followed; by default the file's own.

    Raises:
        InputError: it is missing, a link, no plain file, too large, no JSON or nested without end.
    """
    root = path.parent if root is None else root
    try:
        data = read_head(root, *path.relative_to(root).parts, size=JSON_LIMIT_BYTES + 1)
        if len(data) > JSON_LIMIT_BYTES:
            raise InputError(f"{path} has over {JSON_LIMIT_BYTES >> 20} MB, far more than hfb writes: {fix}")
        content = json.loads(data, parse_constant=_not_finite, parse_float=_finite)
        _check_depth(content)
        return content
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path} is missing: {fix}") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): {fix}") from None
    except RecursionError:
        raise InputError(f"{path} is damaged (brackets within brackets without end): {fix}") from None
    except (ValueError, MemoryError) as error:
        raise InputError(f"{path} is damaged ({str(error)[:80] or type(error).__name__}): {fix}") from None


def _check_depth(content: Any) -> None:
    """Raise RecursionError where it is nested deeper than any file of hfb, since recursive readers would fail."""
    level = [content]
    for _ in range(_DEEPEST):
        parents = (one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list))
        level = [child for parent in parents for child in parent if isinstance(child, dict | list)]
        if not level:
            return
    raise RecursionError


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _not_finite(text[:20])


def _not_finite(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a finite number")
