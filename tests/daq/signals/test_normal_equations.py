"""Small normal equations against numpy's linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from daq.signals.normal_equations import solve


@pytest.mark.parametrize("unknowns", [1, 2, 4])
def test_solution_variance_and_determinant_are_those_of_linear_algebra(unknowns: int) -> None:
    rng = np.random.default_rng(unknowns)
    design = rng.standard_normal((3, 5, 12, unknowns))
    across, right = np.swapaxes(design, 2, 3) @ design, rng.standard_normal((3, 5, unknowns))
    prior = np.column_stack([np.zeros(3), rng.uniform(0.1, 10.0, (3, unknowns - 1))])
    fit, variance, log_determinant = solve(across, right, prior, 1e-13)
    precision = across + np.stack([np.diag(row) for row in prior])[:, None]
    covariance = np.linalg.inv(precision)
    np.testing.assert_allclose(fit, (covariance @ right[..., None])[..., 0], rtol=1e-9)
    np.testing.assert_allclose(variance, covariance[..., 0, 0], rtol=1e-9)
    np.testing.assert_allclose(log_determinant, np.linalg.slogdet(precision)[1], rtol=1e-9)


def test_equal_shapes_leave_the_sum_of_their_amplitudes() -> None:
    shape = np.linspace(0.0, 1.0, 20)
    design = np.column_stack([np.ones(20), shape, shape])
    right = design.T @ (3.0 + 2.0 * shape)
    prior = np.array([[0.0, 1e-30, 1e-30]])
    fit, variance, _ = solve((design.T @ design)[None, None], right[None, None], prior, 1e-13)
    assert fit[0, 0, 0] == pytest.approx(3.0, abs=1e-6)
    assert fit[0, 0, 1] + fit[0, 0, 2] == pytest.approx(2.0, abs=1e-6)
    assert 0.0 < variance[0, 0] < 1.0
