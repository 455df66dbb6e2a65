"""One thread for linear algebra: these problems are too small to share, and waiting for each other is what threads do.

On a machine whose processors are busy, a fit of 30 ms took over a second with OpenBLAS's own threads.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

THREADS = max(1, min(4, os.cpu_count() or 1))
"""Motions that are integrated side by side."""
_P = ParamSpec("_P")
_R = TypeVar("_R")


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()  # looks through the loaded libraries: milliseconds, once


def on_one_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """The same function with every BLAS held to one thread while it runs."""

    @functools.wraps(function)
    def held(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return held
