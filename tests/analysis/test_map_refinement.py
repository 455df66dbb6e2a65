"""Refinement at borders: as the full grid, but for islands that no evaluated point touches."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from analysis.maps.refinement import refined_grid
from dynamics import balanced_angles
from dynamics.stability.map_plane import SpeedStiffnessPlane
from dynamics.stability.stability_map import multipliers_at_points, stability_map_over
from rig_configs import load_rig

Array = NDArray[np.float64]
CORNERS = np.ones((3, 3), bool)


def signs(values: Array) -> NDArray[np.intp]:
    return np.where(np.isnan(values), 2, values < 0).astype(np.intp)


def field(waves: list[tuple[float, float, float]], level: float, x: Array, y: Array) -> Array:
    return level + sum((np.cos(kx * x + ky * y + phase) for kx, ky, phase in waves), np.zeros(np.shape(x)))


wave = st.tuples(st.floats(-25, 25), st.floats(-25, 25), st.floats(0, 6.3))


@settings(max_examples=150, deadline=None)
@given(
    waves=st.lists(wave, min_size=1, max_size=5),
    level=st.floats(-2, 2),
    columns=st.integers(1, 9),
    rows=st.integers(1, 9),
    levels=st.integers(0, 4),
    named=st.booleans(),
)
def test_only_islands_that_no_evaluated_point_touches_are_missed(
    waves: list[tuple[float, float, float]], level: float, columns: int, rows: int, levels: int, named: bool
) -> None:
    x, y = np.linspace(0, 1, (columns << levels) + 1), np.linspace(0, 1, (rows << levels) + 1)

    def evaluate(at_x: Array, at_y: Array) -> Array:
        found = field(waves, level, at_x, at_y)
        return np.where(signs(found) == 1, 1.0, 0.0) - 0.5 if named else found

    found = refined_grid(evaluate, x, y, levels, signs, interpolated=not named)
    true = evaluate(*np.meshgrid(x, y))
    assert np.array_equal(found.values[found.computed], true[found.computed])
    assert found.computed[:: 2**levels, :: 2**levels].all()
    patches, count = cast("tuple[NDArray[np.intp], int]", label(signs(found.values) != signs(true), CORNERS))
    for patch in (patches == n for n in range(1, count + 1)):
        assert not np.any(patch & found.computed)
        around = binary_dilation(patch, CORNERS)
        assert len({*signs(true)[around & ~patch].tolist()}) == 1  # an island in one class


def test_a_border_is_followed_out_of_cells_whose_corners_differ() -> None:
    """A tongue enters at one side between two points of the coarse grid and passes several of its cells."""
    x = y = np.linspace(0, 1, 8 * 16 + 1)

    def evaluate(at_x: Array, at_y: Array) -> Array:
        inside = (np.abs(at_y - 0.06 - 0.3 * at_x) < 0.02) | (at_x < 0.01)
        return np.where(inside, -1.0, 1.0)

    found = refined_grid(evaluate, x, y, 4, signs)
    assert np.array_equal(signs(found.values), signs(evaluate(*np.meshgrid(x, y))))
    assert found.computed.mean() < 0.3


def test_an_island_within_a_coarse_cell_is_missed() -> None:
    x = y = np.linspace(0, 1, 65)

    def evaluate(at_x: Array, at_y: Array) -> Array:
        return np.hypot(at_x - 0.56, at_y - 0.56) - 0.05

    assert np.all(refined_grid(evaluate, x, y, 3, signs).values > 0)
    assert np.any(refined_grid(evaluate, x, y, 2, signs).values < 0)


def test_sizes_that_do_not_halve_are_refused() -> None:
    with pytest.raises(ValueError, match="4 k"):
        refined_grid(lambda x, y: x + y, np.linspace(0, 1, 8), np.linspace(0, 1, 9), 2, signs)


def test_the_nominal_plane_is_as_on_the_full_grid_at_a_fraction_of_its_points() -> None:
    physics = load_rig("virtual").physics
    plane = SpeedStiffnessPlane(physics, balanced_angles(physics)[0])
    x, y = np.linspace(0.3, 7.0, 24 * 8 + 1), np.linspace(1.0, 16.0, 18 * 8 + 1)
    full = np.asarray(stability_map_over(plane, x, y, 1e-8).multiplier_max, np.float64) - 1

    def evaluate(at_x: Array, at_y: Array) -> Array:
        return np.asarray(multipliers_at_points(plane, at_x, at_y, 1e-8)[0], np.float64) - 1

    found = refined_grid(evaluate, x, y, 3, signs)
    assert np.array_equal(signs(found.values), signs(full))
    assert found.values[found.computed] == pytest.approx(full[found.computed], abs=3e-8)
    assert found.computed.mean() < 0.2
