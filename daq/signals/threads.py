"""One thread for linear algebra: these problems are so small that threads mainly wait for each other.

On a computer with busy processors, a fit of 30 ms took over a second with OpenBLAS's own threads.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

from threadpoolctl import ThreadpoolController

THREADS = max(1, min(4, os.cpu_count() or 1))
"""Number of motions that are integrated in parallel."""
_P = ParamSpec("_P")
_R = TypeVar("_R")


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()  # searches the loaded libraries: milliseconds, once


def on_one_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the same function, with every BLAS limited to one thread while it runs."""

    @functools.wraps(function)
    def limited(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with cast("Any", _libraries()).limit(limits=1, user_api="blas"):  # threadpoolctl has no types
            return function(*args, **kwargs)

    return limited
