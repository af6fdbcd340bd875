"""Results of pure functions kept for a while: a fit asks for the same responses again and again."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")


def remembered(size: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Keep a function's last ``size`` results by the contents of its arguments: numbers, arrays, dataclasses of them.

    Arrays of a result are made read-only, as callers share them. For functions that cost far more than reading
    their arguments, some 50 us for a whole rig.
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
        self._contents = pickle.dumps((args, kwargs), protocol=pickle.HIGHEST_PROTOCOL)
        self._hash = hash(self._contents)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self._contents == other._contents


def _read_only(result: T) -> T:
    for part in [getattr(result, f.name) for f in fields(result)] if is_dataclass(result) else [result]:
        if isinstance(part, np.ndarray):
            part.flags.writeable = False
    return result
