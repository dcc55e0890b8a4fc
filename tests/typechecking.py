"""The run-time type checks of the tests: jaxtyping's shapes, and beartype with int accepted where float is asked.

A check says the same whenever types, shapes and whole numbers are the same, and a fit calls each function thousands of
times with the same: it would spend half of its time in checks. Here each combination is checked once.
"""

import functools
import inspect
import threading
from collections.abc import Callable, Hashable
from enum import Enum
from types import FunctionType, NoneType
from typing import Any

import jaxtyping
import numpy as np
import torch
from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))

_MANY_ITEMS = 16
_MANY_COMBINATIONS = 10_000
_TUPLE_OF_ANY_LENGTH = ", ...]"
_jaxtyped = jaxtyping.jaxtyped
_last = threading.local()


class _Unlike(Exception):
    """Of many or unlike items a check looks at one by chance, another time at another."""


def _shape(value: Any) -> Hashable:
    return type(value), tuple(value.shape), value.dtype


def _itself(value: Any) -> Hashable:
    return type(value), value


def _each(value: Any) -> Hashable:
    if len(value) > _MANY_ITEMS:
        raise _Unlike
    return type(value), *map(_trait, value)


def _alike(value: Any) -> Hashable:
    # Data nested in data may be of any depth, and costs more to describe than to check.
    if len(value) > _MANY_ITEMS or any(isinstance(one, list | dict | set | frozenset) for one in value):
        raise _Unlike
    if len(traits := set(map(_trait, value))) > 1:
        raise _Unlike
    return type(value), *traits


def _entries(value: Any) -> Hashable:
    return type(value), _alike(value.keys()), _alike(value.values())


def _trait_of(kind: type) -> Callable[[Any], Hashable]:
    if issubclass(kind, (torch.Tensor, np.ndarray)):
        return _shape
    if issubclass(kind, (int, str, bytes, NoneType, type, Enum)):  # a length, or one of Literal
        return _itself
    if kind is tuple:
        return _each
    if kind in (list, set, frozenset):
        return _alike
    return _entries if issubclass(kind, dict) else type


_TRAITS: dict[type, Callable[[Any], Hashable]] = {}


def _trait(value: Any) -> Hashable:
    """What a check looks at in a value."""
    kind = type(value)
    if kind not in _TRAITS:
        _TRAITS[kind] = _trait_of(kind)
    return _TRAITS[kind](value)


def _trait_or_none(value: Any) -> Hashable:
    try:
        trait = _trait(value)
        hash(trait)
    except (_Unlike, TypeError):  # the shapes of tensors without content hold no numbers
        return None
    return trait


def _jaxtyped_once(function: Any = None, *, typechecker: Any) -> Any:
    """Jaxtyping's decorator, which checks each combination of what is given and returned once.

    What checks is made at the first call: a test process imports five thousand functions and calls a few hundred.

    Args:
        function: what the import hook decorates.
        typechecker: `checked`.
    """
    if function is None:
        return functools.partial(_jaxtyped_once, typechecker=typechecker)
    if not isinstance(function, FunctionType) or inspect.isgeneratorfunction(function):
        return _jaxtyped(function, typechecker=typechecker)

    @functools.wraps(function)
    def returned(*_args: Any, **_kwargs: Any) -> Any:
        return _last.result

    @functools.cache
    def checks() -> Callable[..., Any]:
        return _jaxtyped(typechecker(function), typechecker=None)

    @functools.cache
    def checks_result() -> Callable[..., Any]:
        return _jaxtyped(typechecker(returned), typechecker=None)

    seen: dict[Hashable, set[Hashable]] = {}
    by_chance = any(_TUPLE_OF_ANY_LENGTH in str(hint) for hint in function.__annotations__.values())

    @functools.wraps(function)
    def once(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        given = None if by_chance else _trait_or_none((args, *kwargs, *kwargs.values()))
        results = seen.get(given)
        if results is None:
            result = checks()(*args, **kwargs)
            if given is not None and len(seen) < _MANY_COMBINATIONS:
                seen[given] = {_trait_or_none(result)} - {None}
            return result
        result = function(*args, **kwargs)
        trait = _trait_or_none(result)
        if trait not in results:
            _last.result = result
            checks_result()(*args, **kwargs)
            results |= {trait} - {None}
        return result

    return once


jaxtyping.jaxtyped = _jaxtyped_once  # for the import hook, which decorates with it
