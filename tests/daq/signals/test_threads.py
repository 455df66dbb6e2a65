"""Fits limit the linear algebra to one thread, and restore the threads afterwards."""

from __future__ import annotations

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from daq.signals.threads import on_one_thread


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_blas_has_one_thread_inside_and_its_own_outside() -> None:
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        assert on_one_thread(blas_threads)() <= {1}  # the BLAS of macOS cannot be limited
        assert blas_threads() == before <= {2}


def test_an_error_gives_the_threads_back() -> None:
    def fails() -> None:
        raise ValueError("no fit")

    with threadpool_limits(2, user_api="blas"):
        with pytest.raises(ValueError, match="no fit"):
            on_one_thread(fails)()
        assert blas_threads() <= {2}
