"""The run-time type checker of the tests: beartype, with int accepted where float is asked (as in PEP 484)."""

from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf, beartype

_checked = beartype(conf=BeartypeConf(is_pep484_tower=True))


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that checks its arguments.

    The check is made at the first call: a test process imports five thousand functions and calls a few hundred.

    Args:
        function: what jaxtyping calls with a function's arguments, or with its arguments and result.
    """
    check: Callable[..., Any] | None = None

    def checks(*args: Any, **kwargs: Any) -> Any:
        nonlocal check
        if check is None:
            check = _checked(function)
        return check(*args, **kwargs)

    return checks
