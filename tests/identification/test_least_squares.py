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
    assert found.theta == pytest.approx(0.0, abs=1e-2)


def test_an_iteration_follows_a_curved_valley() -> None:
    def valley(theta: Array) -> tuple[Array, Array]:  # Rosenbrock's, ten times as steep
        x, y = theta
        return np.array([100 * (y - x**2), 1 - x]), np.array([[-200 * x, 100.0], [-1.0, 0.0]])

    found = minimise(valley, np.array([-1.2, 1.0]), 80)
    assert found.converged
    assert found.theta == pytest.approx(1.0, abs=1e-2)


def test_an_unknown_that_acts_by_its_square_is_found() -> None:
    """The column of the Jacobian is small near 0: Marquardt's scaling lets it jump, and holds what is determined."""

    def folded(theta: Array) -> tuple[Array, Array]:  # a = t² and b = t are measured well; all have priors
        t, a, b = theta
        rows = np.array([[-2e4 * t, 1e4, 0.0], [-1e4, 0.0, 1e4], *np.eye(3)])
        return np.array([1e4 * (a - t**2), 1e4 * (b - t), t - 1.0, a - 0.3, b + 0.5]), rows

    found = minimise(folded, np.array([0.0, 0.3, 0.5]), 40, reach=np.ones(3))
    (t,) = [root.real for root in np.roots([4.0, 0.0, 2.8, -1.0]) if abs(root.imag) < 1e-9]  # of χ²' along a = t²
    assert found.converged
    assert found.theta == pytest.approx([t, t**2, t], abs=3e-3)
