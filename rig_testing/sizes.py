"""Memory of an object and of all that it refers to."""

from __future__ import annotations

import sys
from types import FunctionType, ModuleType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

_SHARED = (type, ModuleType, FunctionType)


def size_of(thing: object) -> int:
    """Return the bytes of an object and of all objects that it refers to, without classes and modules."""
    seen: set[int] = set()
    waiting, total = [thing], 0
    while waiting:
        each = waiting.pop()
        if id(each) in seen or isinstance(each, _SHARED):
            continue
        seen.add(id(each))
        total += sys.getsizeof(each, 0)
        if isinstance(each, np.ndarray):
            base = cast("NDArray[Any]", each).base
            waiting += [] if base is None else [base]
        elif isinstance(each, dict):
            waiting += cast("dict[object, object]", each).keys()
            waiting += cast("dict[object, object]", each).values()
        elif isinstance(each, list | tuple | set | frozenset) or type(each).__name__ == "deque":
            waiting += cast("list[object]", each)
        else:
            waiting += getattr(each, "__dict__", {}).values()
            for kind in type(each).__mro__:
                slots = getattr(kind, "__slots__", ())
                waiting += [
                    getattr(each, name)
                    for name in ([slots] if isinstance(slots, str) else slots)
                    if hasattr(each, name)
                ]
    return total
