"""Results of pure functions kept for a while: a fit asks for the same responses again and again."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Hashable
from dataclasses import fields, is_dataclass
from functools import lru_cache, wraps
from operator import attrgetter
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")

LAST = 8
"""Dataclasses that are known without reading them anew."""
_LAST: dict[int, tuple[Any, Hashable]] = {}
_LOCK = threading.Lock()


def remembered(size: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Keep a function's last ``size`` results by the contents of its arguments: numbers, arrays, dataclasses of them.

    Numbers that are equal are the same, whatever their type.
    Arrays of a result are made read-only, as callers share them, and so are those of a dataclass that is asked for. For
    functions that cost far more than reading their arguments, some 80 us for a whole rig.
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
        self._contents = tuple(map(_contents, args)), tuple(kwargs), tuple(map(_contents, kwargs.values()))
        self._hash = hash(self._contents)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self._contents == other._contents


def _contents(argument: Any) -> Hashable:
    """What an argument holds. That of a dataclass is read once: a rig is asked for several responses one by one."""
    if not is_dataclass(argument):
        return _read(argument, freeze=False)
    if (known := _LAST.get(id(argument))) is not None:
        return known[1]
    contents = _read(argument, freeze=True)
    with _LOCK:
        _LAST[id(argument)] = argument, contents  # held, so that its id stays its own
        if len(_LAST) > LAST:
            del _LAST[next(iter(_LAST))]
    return contents


def _read(value: Any, freeze: bool) -> Hashable:
    """A value's contents; with ``freeze`` its arrays are made read-only, so that what was read of them stays true."""
    kind = type(value)
    if kind is np.ndarray:
        if freeze:
            value.flags.writeable = False
        return value.dtype.str, value.shape, value.tobytes()
    if kind in _PLAIN:
        plain: Hashable = value
        return plain
    if kind is tuple:
        return tuple([_read(one, freeze) for one in value])
    if kind not in _FIELDS:
        names = [f.name for f in fields(kind)] if is_dataclass(kind) else []
        _FIELDS[kind] = attrgetter(*names, "__class__") if names else None
    if (held := _FIELDS[kind]) is not None:
        return tuple([_read(one, freeze) for one in held(value)])
    return value if kind is type else pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


_PLAIN = {float, int, bool, str, bytes, type(None)}
_FIELDS: dict[type, attrgetter[Any] | None] = {}
"""What reads all fields of a dataclass, and its class, at once; None of what is no dataclass."""


def _read_only(result: T) -> T:
    for part in [getattr(result, f.name) for f in fields(result)] if is_dataclass(result) else [result]:
        if isinstance(part, np.ndarray):
            part.flags.writeable = False
    return result
