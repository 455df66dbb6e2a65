"""Levenberg–Marquardt where one straight step is not enough."""

import numpy as np
import pytest
from numpy.typing import NDArray

from identification.least_squares import minimise

Array = NDArray[np.float64]


def test_steps_that_are_too_long_do_not_end_an_iteration() -> None:
    def bending(theta: Array) -> tuple[Array, Array]:  # the step from 3 is refused at the first five dampings
        return np.arctan(theta), np.diag(1 / (1 + theta**2))

    found = minimise(bending, np.array([3.0]))
    assert found.converged
    assert found.theta == pytest.approx(0.0, abs=1e-3)


def test_an_iteration_follows_a_curved_valley() -> None:
    def valley(theta: Array) -> tuple[Array, Array]:  # Rosenbrock's, ten times as steep
        x, y = theta
        return np.array([100 * (y - x**2), 1 - x]), np.array([[-200 * x, 100.0], [-1.0, 0.0]])

    found = minimise(valley, np.array([-1.2, 1.0]), 80)
    assert found.converged
    assert found.theta == pytest.approx(1.0, abs=1e-3)
