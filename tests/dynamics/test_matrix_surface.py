"""Matrices over a rectangle from few of them: exact to rounding where they are smooth, refused where they are not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dynamics.stability.floquet.matrix_surface import MatrixSurface, chebyshev_points, fit_surface, lagrange_slopes

Array = NDArray[np.floating]
U, V = (0.5, 3.0), (1.0, 4.0)


def turning(u: Array, v: Array, finer: bool, off: float = 0.0) -> Array:
    """Two by two matrices that turn with the phase u v and decay with u; `off` is left out by the finer ones."""
    phase, size = u * v, np.exp(-0.3 * u)
    rows = [[np.cos(phase), np.sin(phase)], [-np.sin(phase), np.cos(phase) + (0.0 if finer else off)]]
    return np.moveaxis(np.array(rows) * size, -1, 0)


def at(surface: MatrixSurface, u: Array, v: Array) -> Array:
    return np.einsum("pv,pu,vuij->pij", surface.weights_v(v), surface.weights_u(u), surface.nodes)


def spread(count: int = 200) -> tuple[Array, Array]:
    random = np.random.default_rng(5)
    return random.uniform(*U, count), random.uniform(*V, count)


def fitted(phases: tuple[float, float] = (5.0, 4.5), off: float = 0.0) -> MatrixSurface:
    surface = fit_surface(lambda u, v, finer: turning(u, v, finer, off), U, V, phases, 1e-14)
    assert surface is not None
    return surface


def test_smooth_matrices_come_back_to_rounding() -> None:
    surface, (u, v) = fitted(), spread()
    apart = np.linalg.norm(at(surface, u, v) - turning(u, v, False), axis=(1, 2))
    assert np.max(apart) <= surface.error <= 1e-12


@pytest.mark.parametrize("n", [1, 2, 9])
def test_slopes_are_those_of_the_polynomial_through_the_nodes(n: int) -> None:
    """Ends, nodes and all between."""
    factors = np.random.default_rng(n).normal(size=n)
    nodes = np.polynomial.polynomial.polyval(chebyshev_points(n, U), factors)
    u = np.concatenate([np.linspace(*U, 37), chebyshev_points(n, U)])
    expected = np.polynomial.polynomial.polyval(u, np.polynomial.polynomial.polyder(factors))
    assert lagrange_slopes(n, U, u) @ nodes == pytest.approx(expected, rel=1e-10, abs=1e-10)


def test_too_few_nodes_are_noticed_and_more_are_taken() -> None:
    surface, (u, v) = fitted((0.1, 0.1)), spread()
    assert min(surface.nodes.shape[:2]) > 10
    apart = np.linalg.norm(at(surface, u, v) - turning(u, v, False), axis=(1, 2))
    assert np.max(apart) <= surface.error <= 1e-12


def test_what_the_nodes_are_off_by_is_in_the_error() -> None:
    """More accurate matrices at points between the nodes show it."""
    surface, (u, v) = fitted(off=1e-7), spread()
    apart = np.linalg.norm(at(surface, u, v) - turning(u, v, True), axis=(1, 2))
    assert 1e-8 < np.max(apart) <= surface.error


def test_a_kink_is_refused() -> None:
    def bent(u: Array, v: Array, finer: bool) -> Array:
        return turning(u, v, finer) * np.abs(u - 1.7)[:, None, None]

    assert fit_surface(bent, U, V, (5.0, 4.5), 1e-14) is None


def test_what_is_not_a_number_is_refused() -> None:
    def partly(u: Array, v: Array, finer: bool) -> Array:
        return np.where((v > 3.9)[:, None, None], np.nan, turning(u, v, finer))

    assert fit_surface(partly, U, V, (5.0, 4.5), 1e-14) is None


@pytest.mark.parametrize("line", ["u", "v"])
def test_a_line_needs_one_node_across(line: str) -> None:
    u_range, v_range = ((2.0, 2.0), V) if line == "u" else (U, (2.0, 2.0))
    surface = fit_surface(turning, u_range, v_range, (0.0, 3.0) if line == "u" else (2.5, 0.0), 1e-14)
    assert surface is not None
    assert min(surface.nodes.shape[:2]) == 1
    u, v = (np.full(50, 2.0), spread(50)[1]) if line == "u" else (spread(50)[0], np.full(50, 2.0))
    assert np.max(np.abs(at(surface, u, v) - turning(u, v, False))) <= surface.error
