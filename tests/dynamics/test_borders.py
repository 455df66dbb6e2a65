"""Borders of stability: every branch found, followed round tips and corners, and exact at each point."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from benchmarks.lines_on_maps import compare
from benchmarks.stability_borders import against_scipy
from dynamics.equations.balancing import balanced_angles
from dynamics.errors import OutsideDomain
from dynamics.stability.border_cells import KnownPoints, Lattice, border_cells
from dynamics.stability.border_crossings import crossings_of
from dynamics.stability.border_following import SHORTEST, FollowedBorder, follow
from dynamics.stability.borders import FLUTTER, Borders, stability_borders
from dynamics.stability.map_plane import SpeedStiffnessPlane, multiplier_at
from dynamics.stability.stability_map import stability_map
from tests.dynamics.nominal import rig
from tests.effort import thorough

Array = NDArray[np.floating]


def silent(share: float) -> None:
    assert 0 <= share <= 1


def length(line: FollowedBorder) -> float:
    return float(np.sum(np.abs(np.diff(np.array(line.points)))))


def area_on_the_left(points: list[complex]) -> float:
    z = np.array(points)
    return float(np.sum(z[:-1].real * z[1:].imag - z[:-1].imag * z[1:].real) / 2)


def test_an_island_is_followed_once_round_with_what_is_stable_on_the_left() -> None:
    line = follow(lambda z: abs(z - (0.5 + 0.5j)) - 0.2, 0.7 + 0.5j)
    assert line.closed
    assert line.points[0] == line.points[-1]
    assert length(line) == pytest.approx(2 * math.pi * 0.2, rel=1e-3)
    assert area_on_the_left(line.points) == pytest.approx(math.pi * 0.04, rel=1e-3)
    assert max(abs(abs(z - (0.5 + 0.5j)) - 0.2) for z in line.points) < 1e-12
    hole = follow(lambda z: 0.2 - abs(z - (0.5 + 0.5j)), 0.7 + 0.5j)
    assert area_on_the_left(hole.points) == pytest.approx(-math.pi * 0.04, rel=1e-3)


def test_a_line_is_followed_both_ways_to_the_sides() -> None:
    line = follow(lambda z: z.imag - 0.3 - 0.2 * z.real, 0.5 + 0.4j)
    assert not line.closed
    assert line.points[0] == pytest.approx(1 + 0.5j, abs=1e-12)  # stable below: from right to left
    assert line.points[-1] == pytest.approx(0.3j, abs=1e-12)


def tongue(z: complex) -> float:
    """Unstable in a tongue 1e-4 wide that reaches from the left side to x = 0.8, where it ends round."""
    return 1e-4 * (0.8 - z.real) - 100 * (z.imag - 0.5 - 0.1 * math.sin(3 * z.real)) ** 2


def test_a_thin_tongue_is_followed_round_its_tip() -> None:
    middle = 0.5 + 0.1 * math.sin(1.2)
    line = follow(tongue, 0.4 + 1j * (middle + math.sqrt(1e-6 * 0.4)))
    assert not line.closed
    assert max(z.real for z in line.points) == pytest.approx(0.8, abs=1e-5)
    assert [z.real for z in (line.points[0], line.points[-1])] == pytest.approx([0, 0], abs=1e-12)
    assert abs(line.points[0] - line.points[-1]) == pytest.approx(2 * math.sqrt(1e-6 * 0.8), rel=1e-6)


def test_corners_are_turned_where_they_are() -> None:
    """Where two multipliers leave the circle the border has a corner."""
    line = follow(lambda z: max(z.real - 0.6, z.imag - 0.7), 0.2 + 0.7j)
    corner = min(abs(z - (0.6 + 0.7j)) for z in line.points)
    assert corner <= 2 * SHORTEST
    assert length(line) == pytest.approx(0.6 + 0.7, abs=1e-5)


def test_the_grid_finds_what_is_small_and_measures_what_is_stable() -> None:
    def excess(x: Array, y: Array) -> Array:
        island = np.hypot(x - 2.0, y - 3.0) - 0.9
        return np.minimum(island, np.hypot(x - 3.71, y - 4.03) - 0.021)

    lattice = Lattice((0.0, 4.0), (2.0, 5.0), 40 << 4, 30 << 4)
    known = KnownPoints(lattice, excess)
    cells = border_cells(known, 40, 30, 4, silent)
    crossings = crossings_of(lattice, cells, excess)
    x, y = lattice.x(crossings.columns), lattice.y(crossings.rows)
    assert np.max(np.abs(excess(x, y))) < 1e-12
    assert np.count_nonzero(x > 3) >= 8
    share = cells.clear_stable + crossings.stable_share.sum() / (lattice.columns * lattice.rows)
    assert share * 12 == pytest.approx(math.pi * (0.81 + 0.021**2), rel=1e-4)
    assert len(known) < 0.2 * lattice.columns * lattice.rows


def test_nothing_stable_and_nothing_unstable_have_no_borders() -> None:
    for level in (1.0, -1.0):

        def excess(x: Array, y: Array, level: float = level) -> Array:
            return np.full(len(x), level) + 0.1 * np.sin(x + y)

        lattice = Lattice((0.0, 1.0), (0.0, 1.0), 32, 32)
        cells = border_cells(KnownPoints(lattice, excess), 8, 8, 2, silent)
        assert len(cells.i) == len(crossings_of(lattice, cells, excess).columns) == 0
        assert cells.clear_stable == pytest.approx(float(level < 0))


def borders_of(
    zeta: float, x_range: tuple[float, float], y_range: tuple[float, float]
) -> tuple[SpeedStiffnessPlane, Borders]:
    parameters = rig(zeta=zeta)
    plane = SpeedStiffnessPlane(parameters, balanced_angles(parameters)[0])
    return plane, stability_borders(plane, x_range, y_range, levels=1, progress=silent)


def test_the_thin_band_above_the_second_resonance_is_found() -> None:
    """At ζ = 0.1 the unstable wedge is split by a stable band a tenth of Ω wide."""
    plane, found = borders_of(0.1, (3.0, 6.0), (10.0, 16.0))
    x = np.linspace(3.0, 6.0, 301)
    stable = np.array([multiplier_at(plane, float(at), 15.7, 1e-8)[0] < 1 for at in x])
    changes = np.flatnonzero(stable[1:] != stable[:-1])
    on_line: list[float] = []
    for branch in found.branches:
        above = branch.y - 15.7
        for i in np.flatnonzero((above[:-1] < 0) != (above[1:] < 0)):
            share = above[i] / (above[i] - above[i + 1])
            on_line.append(float(branch.x[i] + share * (branch.x[i + 1] - branch.x[i])))
    assert len(changes) == len(on_line) == 3
    assert sorted(on_line) == pytest.approx((x[changes] + x[changes + 1]) / 2, abs=0.0051)


def test_points_of_a_border_are_exact_and_contain_how_stability_is_lost() -> None:
    plane, found = borders_of(0.02, (1.0, 4.0), (6.0, 16.0))
    assert found.bare == ()
    for branch in found.branches:
        assert set(branch.kind) == {FLUTTER}
        assert np.max(np.abs(np.abs(branch.multiplier) - 1)) < 1e-11
        assert np.all(branch.multiplier.imag >= 0)
        assert branch.off <= 1e-11
        for i in range(0, len(branch.x), len(branch.x) // 12):
            assert multiplier_at(plane, float(branch.x[i]), float(branch.y[i]), 1e-11)[0] == pytest.approx(1, abs=2e-11)
            if 0 < i < len(branch.x) - 1:
                way = complex(branch.x[i + 1] - branch.x[i - 1], branch.y[i + 1] - branch.y[i - 1])
                left = 1e-4j * way / abs(way)
                inside = multiplier_at(plane, float(branch.x[i]) + left.real, float(branch.y[i]) + left.imag, 1e-11)[0]
                assert inside < 1


@pytest.mark.parametrize("zeta", [0.005, pytest.param(0.1, marks=thorough)])
def test_multipliers_along_borders_are_those_that_scipy_finds(zeta: float) -> None:
    """Over a whole revolution, by equations written independently."""
    parameters = rig(zeta=zeta)
    _, found = borders_of(zeta, (1.2, 4.6), (8.0, 16.0))
    checked = against_scipy(parameters, found.branches, 211)
    assert checked.points > 30
    assert checked.modulus < 2e-11
    assert checked.multiplier < 5e-10
    assert checked.off_in_speed < 1e-10
    assert (checked.wrong_sides, checked.wrong_kinds) == (0, 0)


def test_straight_lines_between_points_show_on_a_map_as_fine_as_their_spacing() -> None:
    """Where a tongue is level two borders end within a row of a map of 4000 × 3000: longer lines miss it by pitches."""
    parameters = rig(zeta=0.005)
    plane = SpeedStiffnessPlane(parameters, balanced_angles(parameters)[0])
    pitches, corner = (6.7 / 3999, 15 / 2999), (1.4, 15.6)
    spans = [(low, low + 119 * pitch) for low, pitch in zip(corner, pitches, strict=True)]
    found = stability_borders(plane, *spans, first=(24, 24), levels=1, spacing=1 / 119)
    x, y = (np.linspace(*span, 120) for span in spans)
    stable = stability_map(parameters, x, y).multiplier_max < 1
    for shift in (0.0, 1.2):  # pitches
        lines = [(b.x + shift * pitches[0], b.y) for b in found.branches]
        rows = compare(stable[1:-1], x, y[1:-1], lines)
        columns = compare(stable[:, 1:-1].T, y, x[1:-1], [(b, a) for a, b in lines])
        assert rows.changes > 100
        assert columns.changes > 4
        exact = max(rows.worst_pitches, columns.worst_pitches) <= 0.5 and rows.unseen == columns.unseen == []
        assert exact == (shift == 0.0)


def test_a_branch_has_points_as_dense_as_wanted() -> None:
    _, found = borders_of(0.1, (3.0, 6.0), (10.0, 16.0))
    for branch in found.branches:
        for spacing in (1 / 4000, 1 / 30_000):
            dense = branch.at_spacing(spacing)
            apart = np.hypot(np.diff(dense.x) / 3.0, np.diff(dense.y) / 6.0)
            assert np.max(apart) <= spacing
            assert (dense.x[0], dense.y[-1]) == (branch.x[0], branch.y[-1])
        with pytest.raises(OutsideDomain, match="spacing"):
            branch.at_spacing(0.0)


CELL = np.array([1 / 32, 1 / 24])  # of the first grid below


def cells_with_a_border(island: Callable[[Array, Array], NDArray[np.bool_]], levels: int = 1) -> int:
    """Of a grid over something stable within an island alone, by the same distance everywhere: nothing hints at it."""

    def excess(x: Array, y: Array) -> Array:
        return np.where(island(x, y), -1.0, 1.0)

    lattice = Lattice((0.0, 1.0), (0.0, 1.0), 32 << levels, 24 << levels)
    return len(border_cells(KnownPoints(lattice, excess), 32, 24, levels, silent).i)


@given(x=st.floats(0.03, 0.97), y=st.floats(0.03, 0.97), size=st.floats(1.01, 2.0))
def test_an_island_as_large_as_a_cell_of_the_first_grid_is_never_missed(x: float, y: float, size: float) -> None:
    wide, high = CELL * size / 2
    assert cells_with_a_border(lambda a, b: (np.abs(a - x) < wide) & (np.abs(b - y) < high)) >= 4


@given(at=st.floats(0.05, 0.95), lean=st.floats(-0.4, 0.4))
def test_a_band_as_wide_as_a_cell_of_the_first_grid_is_never_missed(at: float, lean: float) -> None:
    half = 0.51 * CELL[0]
    assert cells_with_a_border(lambda a, b: np.abs(a - at - lean * (b - 0.5)) < half) >= 20


def test_an_island_between_the_points_of_the_first_grid_is_missed_as_documented() -> None:
    x, y = 10.5 * CELL[0], 7.5 * CELL[1]
    wide, high = 0.45 * CELL
    assert cells_with_a_border(lambda a, b: (np.abs(a - x) < wide) & (np.abs(b - y) < high), levels=3) == 0


def test_a_band_hardly_wider_than_the_stated_resolution_is_found() -> None:
    """The stable band at ζ = 0.1, Ω = 4.39 … 4.54, in a range of more than a hundred times its width."""
    parameters = rig(zeta=0.1)
    plane = SpeedStiffnessPlane(parameters, balanced_angles(parameters)[0])
    found = stability_borders(plane, (0.3, 24.3), (15.9, 16.0), spacing=1 / 500)
    assert found.complete_to == (1 / 192, 1 / 144)
    assert 1.0 < (4.5448 - 4.3929) / 24.0 / found.complete_to[0] < 1.3
    tops = sorted(float(branch.x[end]) for branch in found.branches for end in (0, -1) if branch.y[end] == 16.0)
    assert tops == pytest.approx([1.06024, 2.97965, 4.39294, 4.54483, 5.2015], abs=1e-4)


def test_where_balance_ends_nothing_is_claimed() -> None:
    """No borders are looked for in a strip where no balanced state exists."""
    from dynamics.stability.map_plane import RigPlane
    from tests.dynamics.test_map_planes import damped_and_unbalanced

    found = stability_borders(RigPlane(damped_and_unbalanced), (0.05, 0.075), (5e-4, 2e-3), levels=0, progress=silent)
    assert found.bare
    assert max(u[1] for u, _ in found.bare) == pytest.approx(0.075)
    assert min(u[0] for u, _ in found.bare) == pytest.approx(0.0675, abs=0.0005)


@pytest.mark.parametrize("more", [{"spacing": 0.0}, {"spacing": math.inf}, {"first": (0, 72)}])
def test_no_spacing_and_no_grid_are_refused(more: dict[str, Any]) -> None:
    plane = SpeedStiffnessPlane(rig(), balanced_angles(rig())[0])
    with pytest.raises(OutsideDomain, match=r"spacing|first grid"):
        stability_borders(plane, (1.0, 2.0), (1.0, 4.0), **more)


@pytest.mark.parametrize(("x_range", "levels"), [((2.0, 1.0), 1), ((1.0, math.inf), 1), ((1.0, 2.0), 9)])
def test_ranges_and_levels_outside_are_refused(x_range: tuple[float, float], levels: int) -> None:
    plane = SpeedStiffnessPlane(rig(), balanced_angles(rig())[0])
    with pytest.raises(OutsideDomain, match=r"ranges|levels"):
        stability_borders(plane, x_range, (1.0, 4.0), levels=levels)


def test_changed_damping_changes_the_stable_share() -> None:
    shares = [borders_of(zeta, (1.0, 4.0), (4.0, 12.0))[1].stable_share for zeta in (0.005, 0.02)]
    nominal = rig()
    assert dataclasses.replace(nominal, zeta1=0.005) != nominal
    assert shares[0] < shares[1] - 0.01
