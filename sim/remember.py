"""Results of pure functions kept for a while: a fit asks for the same responses again and again."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")

LAST = 8
"""Dataclasses that are known without reading them anew."""
_LAST: dict[int, tuple[Any, bytes]] = {}
_LOCK = threading.Lock()


def remembered(size: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Keep a function's last ``size`` results by the contents of its arguments: numbers, arrays, dataclasses of them.

    Arrays of a result are made read-only, as callers share them, and so are those of a dataclass that is asked for. For
    functions that cost far more than reading their arguments, some 100 us for a whole rig.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @lru_cache(maxsize=size)
        def kept(call: _Call) -> T:
            return _read_only(function(*call.args, **call.kwargs))

        @wraps(function)
        def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
            return kept(_Call(args, kwargs))

        return wrapper

    return decorate


class _Call:
    """Arguments that compare by their contents."""

    __slots__ = ("_contents", "_hash", "args", "kwargs")

    def __init__(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        self.args, self.kwargs = args, kwargs
        self._contents = tuple(map(_contents, (*args, kwargs) if kwargs else args))
        self._hash = hash(self._contents)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self._contents == other._contents


def _contents(argument: Any) -> bytes:
    """What an argument holds. That of a dataclass is read once: a rig is asked for several responses one by one."""
    if not is_dataclass(argument):
        return pickle.dumps(argument, protocol=pickle.HIGHEST_PROTOCOL)
    if (known := _LAST.get(id(argument))) is not None:
        return known[1]
    contents = pickle.dumps(argument, protocol=pickle.HIGHEST_PROTOCOL)
    _freeze(argument)
    with _LOCK:
        _LAST[id(argument)] = argument, contents  # held, so that its id stays its own
        if len(_LAST) > LAST:
            del _LAST[next(iter(_LAST))]
    return contents


def _freeze(value: Any) -> None:
    """Make the arrays in a dataclass read-only: it is frozen, and what was read of it has to stay true."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, tuple):
        for one in value:
            _freeze(one)
    else:
        for name in _fields(type(value)):
            _freeze(getattr(value, name))


_FIELDS: dict[type, tuple[str, ...]] = {}
"""Names of a class's fields, none of what is no dataclass: `dataclasses.fields` takes longer than a freeze."""


def _fields(kind: type) -> tuple[str, ...]:
    if kind not in _FIELDS:
        _FIELDS[kind] = tuple(f.name for f in fields(kind)) if is_dataclass(kind) else ()
    return _FIELDS[kind]


def _read_only(result: T) -> T:
    for part in [getattr(result, f.name) for f in fields(result)] if is_dataclass(result) else [result]:
        if isinstance(part, np.ndarray):
            part.flags.writeable = False
    return result
