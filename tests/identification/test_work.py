"""Bound of a fit's work: counted by least squares, repeatable, and not handled as one failed attempt."""

from __future__ import annotations

import numpy as np
import pytest

from identification.errors import FitFailed, IdentificationError, OutOfWork
from identification.least_squares import minimise
from identification.work import ELEMENT_S, bounded_work, spend, tried
from rig_basics.arrays import Array

ROWS = 50


def line(theta: Array) -> tuple[Array, Array]:
    """Residual and Jacobian of a straight line."""
    columns = np.column_stack([np.ones(ROWS), np.linspace(0, 1, ROWS)])
    return columns @ theta - 1.0, columns


def test_every_evaluation_of_least_squares_counts_its_elements() -> None:
    with bounded_work("line") as spent:
        found = minimise(line, np.zeros(2))
        assert spent() == pytest.approx(found.iterations * 2 * ROWS * ELEMENT_S)


def search() -> None:
    """A search that goes on after every failed attempt, each of which costs 0.1 s of work."""
    for number in range(1_000_000):
        try:
            tried(f"start {number}")
            spend(0.1 / ELEMENT_S)
            raise FitFailed("a misfit")
        except IdentificationError:
            continue


def test_a_search_ends_at_its_bound_with_what_it_tried_and_repeats() -> None:
    shown: list[str] = []
    ends: list[OutOfWork] = []
    for _ in range(2):
        with (
            pytest.raises(OutOfWork, match=r"^line: .* start 0; start 1; [0-9]+ more; start ") as caught,
            bounded_work("line", shown.append, limit_s=3.0),
        ):
            search()
        ends.append(caught.value)
    assert ends[0].tried == ends[1].tried
    assert len(ends[0].tried) == 30
    assert 0 < len(shown) < 2 * len(ends[0].tried)  # not the first ones, which take no time
    assert shown[-1] == f"line: {ends[1].tried[-1]}"


def test_an_enclosed_fit_has_a_bound_of_its_own() -> None:
    with bounded_work("outer", limit_s=1.0) as outer:
        with pytest.raises(OutOfWork, match="inner"), bounded_work("inner", limit_s=0.5):
            spend(0.6 / ELEMENT_S)
        assert outer() == 0.0


def test_without_a_bound_nothing_is_counted_and_nothing_ends() -> None:
    spend(1e30)
    tried("anything")
