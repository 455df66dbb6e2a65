"""Multipliers: every method against known values, each other and heyoka; every bound against the true error."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import PeriodicMatrix, along, rotating_frame, type_one
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.motions.integrate import locked_state
from dynamics.stability.floquet import METHODS, floquet_multipliers
from dynamics.stability.floquet.bounds import eigenvalues_with_bounds
from dynamics.stability.floquet.methods import span_rad
from dynamics.stability.floquet.multipliers import balanced
from dynamics.stability.floquet.neutral import without_neutral
from dynamics.stability.floquet.piecewise import sampled_at_ends
from dynamics.steady.singular_points import singular_points

KNOWN = {0.83: 1.361992, 1.6: 0.937055, 2.6: 0.974796, 3.3: 1.373347, 5.8: 0.978556}
RADIUS, IMBALANCE = 0.054, 0.12 * 0.02117


def rig(
    stiffness_ratio: float = 14.9,
    zeta: float | tuple[float, float] = 0.02,
    damping: float | tuple[float, float] = 0.001,
    moment: float = IMBALANCE,
    masses: tuple[float, float] = (0.075, 0.075),
) -> RotorParameters:
    """The nominal rig with some numbers changed."""
    zetas = zeta if isinstance(zeta, tuple) else (zeta, zeta)
    ca, cb = damping if isinstance(damping, tuple) else (damping, damping)
    k1 = (7.0 + 0.12 + sum(masses)) * (2 * math.pi * 3) ** 2
    a, b = Pendulum(masses[0], RADIUS, ca), Pendulum(masses[1], RADIUS, cb)
    return RotorParameters(7.0, 0.12, moment / 0.12, a, b, k1, stiffness_ratio * k1, *zetas)


def balanced_state(parameters: RotorParameters, speed_ratio: float) -> PeriodicMatrix:
    return type_one(parameters, *balanced_angles(parameters)[0], parameters.speed_rad_s(speed_ratio))


def largest(monodromy: np.ndarray) -> float:
    """Largest modulus over a revolution from a half-turn matrix."""
    return float(np.max(np.abs(np.linalg.eigvals(monodromy)))) ** 2


# --- the matrix along the motion ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("masses", "moment"), [((0.075, 0.075), IMBALANCE), ((0.075, 0.04), 0.003), ((7.0, 5.0), 0.2)])
def test_closed_form_is_the_kernels_jacobian(masses: tuple[float, float], moment: float) -> None:
    p = rig(zeta=(0.02, 0.3), damping=(0.001, 0.02), masses=masses, moment=moment)
    states = np.zeros((8, 8))
    states[:, 2:4] = balanced_angles(p)[0]
    speed = p.speed_rad_s(1.6)
    exact, sampled = balanced_state(p, 1.6), along(p, states, speed)
    assert exact.harmonics.shape == sampled.harmonics.shape == (3, 8, 8)
    scale = np.abs(exact.harmonics).max()
    assert np.abs(exact.harmonics - sampled.harmonics).max() < 1e-13 * scale
    assert np.array_equal(exact.turn, sampled.turn)


def test_half_a_revolution_gives_the_same_as_a_whole_one() -> None:
    half = balanced_state(rig(), 3.3)
    assert np.allclose(half.at(0.4 + np.pi), half.turn[:, None] * half.at(0.4) * half.turn, rtol=0, atol=1e-9)
    whole = dataclasses.replace(half, turn=None)
    a, b = floquet_multipliers(half, 1e-10), floquet_multipliers(whole, 1e-10)
    assert abs(a.largest - b.largest) < 1e-10
    assert (span_rad(half), span_rad(whole)) == (np.pi, 2 * np.pi)


@pytest.mark.parametrize("released", [(True, True), (True, False), (False, True), (False, False)])
def test_rotating_frame_and_space_frame_have_the_same_multipliers(released: tuple[bool, bool]) -> None:
    p = rig(stiffness_ratio=1.0, zeta=0.05)
    speed = p.speed_rad_s(0.8)
    point = singular_points(p, speed, released)[-1]
    start = locked_state(p, speed, 0.0, *point.theta_rad)
    still = rotating_frame(p, start, speed, released)
    orbit = np.array([locked_state(p, speed, phase, *point.theta_rad) for phase in np.arange(16) * np.pi / 8])
    moving = along(p, orbit, speed, released)
    n = 4 + 2 * sum(released)
    assert still.constant
    assert (still.dimension, moving.dimension) == (n, n)
    a, b = floquet_multipliers(still), floquet_multipliers(moving, method="explicit")
    assert a.method == "autonomous"
    assert abs(a.largest - b.largest) < 1e-8
    if not moving.constant:
        assert moving.seen_from_rotor is not None
        assert np.allclose(moving.seen_from_rotor.harmonics, still.harmonics, rtol=0, atol=1e-7)


def test_an_anisotropic_rig_is_not_constant_in_any_frame() -> None:
    assert balanced_state(rig(stiffness_ratio=1.0), 1.6).seen_from_rotor is not None
    assert balanced_state(rig(stiffness_ratio=1.0 + 1e-9), 1.6).seen_from_rotor is None
    assert balanced_state(rig(stiffness_ratio=1.0, zeta=(0.02, 0.03)), 1.6).seen_from_rotor is None


def test_a_motion_without_the_half_turn_symmetry_gets_the_whole_revolution() -> None:
    p = rig()
    states = np.zeros((16, 8))
    states[:, 2] = 0.3 * np.sin(2 * np.pi * np.arange(16) / 16)  # order 1 in an angle
    matrix = along(p, states, 50.0)
    assert matrix.turn is None
    assert np.any(np.abs(matrix.harmonics[1][:4, :4]) == 0)  # position rows hold no harmonic
    falling = along(dataclasses.replace(p, gravity_m_per_s2=9.81), np.zeros((8, 8)), 50.0)
    assert falling.turn is None


@pytest.mark.parametrize(
    "broken",
    [
        lambda: PeriodicMatrix(np.ones((2, 2), complex), 1.0, None),
        lambda: PeriodicMatrix(np.ones((1, 2, 2), complex), 0.0, None),
        lambda: PeriodicMatrix(np.full((1, 2, 2), np.nan + 0j), 1.0, None),
        lambda: type_one(dataclasses.replace(rig(), pivot_shift_m=1e-3), 1.0, 2.0, 50.0),
        lambda: type_one(dataclasses.replace(rig(), gravity_m_per_s2=9.8), 1.0, 2.0, 50.0),
        lambda: along(rig(), np.zeros((7, 8)), 50.0),
        lambda: rotating_frame(rig(), np.zeros(8), 50.0),
        lambda: floquet_multipliers(balanced_state(rig(), 1.6), accuracy=1e-15),
        lambda: floquet_multipliers(balanced_state(rig(), 1.6), accuracy=math.nan),
        lambda: floquet_multipliers(balanced_state(rig(), 1.6), method="euler"),
        lambda: floquet_multipliers(balanced_state(rig(), 1.6), method="autonomous"),
    ],
)
def test_what_is_outside_the_domain_is_refused(broken) -> None:
    with pytest.raises(OutsideDomain, match=r"must|needs|not finite|rotating frame"):
        broken()


# --- the contract of every method --------------------------------------------------------------------------------

ENOUGH = {"piecewise": 256, "chebyshev": 3, "hill": 16, "single pass": 32}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize(("speed_ratio", "value"), KNOWN.items())
def test_every_method_gives_the_known_value(name: str, speed_ratio: float, value: float) -> None:
    matrix = balanced_state(rig(), speed_ratio)
    method = METHODS[name]
    monodromy = method.monodromy(matrix, ENOUGH.get(name, 64))
    assert monodromy.shape == (8, 8)
    assert largest(monodromy) == pytest.approx(value, abs=1e-4 if name == "piecewise" else 6e-7)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("speed_ratio", [0.83, 3.3])
def test_every_method_serves_through_the_one_verb(name: str, speed_ratio: float) -> None:
    accuracy = 1e-5 if name == "piecewise" else 1e-7
    matrix = balanced_state(rig(), speed_ratio)
    found = floquet_multipliers(matrix, accuracy, name)
    truth = largest(METHODS["implicit"].monodromy(matrix, 64))
    assert found.method == name
    assert "requested" in found.why
    assert abs(found.largest - truth) <= found.error_estimate <= accuracy * max(1, truth)
    assert np.all(np.diff(np.abs(found.values)) <= 0)


@pytest.mark.parametrize(
    ("name", "steps"), [("explicit", 12), ("magnus", 24), ("commutator-free", 48), ("implicit", 6), ("piecewise", 64)]
)
def test_methods_converge_at_their_order(name: str, steps: int) -> None:
    method = METHODS[name]
    matrix = balanced_state(rig(zeta=0.01), 0.83)
    truth = METHODS["chebyshev"].monodromy(matrix, 4)
    error = [np.linalg.norm(method.monodromy(matrix, n) - truth) for n in (steps, 2 * steps)]
    assert math.log2(error[0] / error[1]) == pytest.approx(method.ORDER, abs=0.8)


@pytest.mark.parametrize("name", ["chebyshev", "hill", "single pass"])
def test_the_checking_methods_reach_rounding(name: str) -> None:
    matrix = balanced_state(rig(), 2.6)
    few = {"chebyshev": 2, "hill": 24, "single pass": 64}[name]
    truth = METHODS["implicit"].monodromy(matrix, 64)
    assert np.abs(METHODS[name].monodromy(matrix, few) / truth - 1)[np.abs(truth) > 1e-3].max() < 1e-8
    assert largest(METHODS[name].monodromy(matrix, few)) == pytest.approx(largest(truth), abs=1e-11)


def test_sampling_at_interval_ends_or_in_the_middle_gives_the_same_multipliers() -> None:
    matrix = balanced_state(rig(), 3.3)
    middle, end = METHODS["piecewise"].monodromy(matrix, 50), sampled_at_ends(matrix, 50)
    assert np.abs(middle - end).max() > 1e-3
    values = [np.sort_complex(np.linalg.eigvals(m) ** 2) for m in (middle, end)]
    assert np.allclose(*values, rtol=0, atol=1e-10)


def test_against_heyoka() -> None:
    hy = pytest.importorskip("heyoka")
    names = hy.make_vars(*[f"y{i}" for i in range(8)])
    for p, speed_ratio in ((rig(), 0.83), (rig(zeta=(0.1, 0.0)), 3.3), (rig(stiffness_ratio=2.0), 5.8)):
        matrix = balanced_state(p, speed_ratio)
        h = matrix.harmonics / matrix.speed_rad_s
        waves = [(hy.cos(k * hy.time), hy.sin(k * hy.time)) for k in range(1, 3)]
        system = []
        for i in range(8):
            rate = hy.expression(0.0)
            for j in range(8):
                entry = hy.expression(float(h[0, i, j].real))
                for (c, s), part in zip(waves, h[1:, i, j], strict=True):
                    if part != 0:
                        entry += float(part.real) * c - float(part.imag) * s
                rate += entry * names[j]
            system.append((names[i], rate))
        run = hy.taylor_adaptive(system, [0.0] * 8, tol=1e-17, compact_mode=True)
        monodromy = np.empty((8, 8))
        for j in range(8):
            run.time = 0.0
            run.state[:] = np.eye(8)[j]
            run.propagate_until(np.pi)
            monodromy[:, j] = matrix.turn * run.state
        found = floquet_multipliers(matrix, 1e-10)
        assert abs(found.largest - largest(monodromy)) <= min(1e-10, found.error_estimate + 1e-13)


# --- the bound ---------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-2, 1e-4, 1e-6, 1e-9]))
@example(299, 1e-2)  # 14 and 28 steps agree by chance
@example(482065, 1e-4)  # 12 and 24 steps do, at 1.9 rad a step
@example(2910, 1e-6)  # and at 0.6 rad a step, with modes that decay within one
def test_the_bound_holds_in_random_draws(seed: int, accuracy: float) -> None:
    random = np.random.default_rng(seed)
    c = 10 ** random.uniform(-8, 1.7) * random.integers(0, 2)
    heavy = 10 ** random.uniform(-3, 0.8)
    p = rig(
        stiffness_ratio=10 ** random.uniform(-1, 2),
        zeta=tuple(random.uniform(0, 2, 2) * random.integers(0, 2, 2) ** 2),
        damping=(c, c * random.uniform(0, 1)),
        masses=(0.075, heavy) if heavy > 0.03 else (heavy, heavy),
        moment=random.uniform(1.001, 1.9) * RADIUS * min(heavy, 0.075)
        if heavy <= 0.03
        else random.uniform(abs(heavy - 0.075) * 1.0001, heavy + 0.0749) * RADIUS,
    )
    matrix = balanced_state(p, 10 ** random.uniform(-0.8, 1.5))
    found = floquet_multipliers(matrix, accuracy)
    truth = largest(METHODS["implicit"].monodromy(balanced(matrix), 600))
    assert abs(found.largest - truth) <= found.error_estimate + 1e-11 * max(1, truth)
    assert found.error_estimate <= accuracy * max(1, found.largest)
    assert np.all(np.isfinite(found.values))


@given(st.integers(0, 2**32 - 1), st.floats(-12, -3), st.floats(-14, 0))
@example(0, -3.25, -1.25)  # first-order moves of a third of the gap
def test_eigenvalue_bounds_hold_for_separate_and_merging_pairs(seed: int, size: float, split: float) -> None:
    random = np.random.default_rng(seed)
    n = 5
    core = np.diag(random.uniform(-1, 1, n))
    core[1, 1], core[0, 1] = core[0, 0] + 10**split, 1.0  # a Jordan block but for the split
    basis = np.eye(n) + 0.3 * random.standard_normal((n, n))
    matrix = basis @ core @ np.linalg.inv(basis)
    change = 10**size * random.standard_normal((n, n))
    values, bounds = eigenvalues_with_bounds(matrix, change, 4.0)
    truth = np.linalg.eigvals(matrix + change)
    moved = np.abs(values[:, None] - truth[None, :]).min(axis=1)
    assert np.all(moved <= bounds + 1e-15)


def test_a_separate_eigenvalue_is_bounded_tightly() -> None:
    matrix = np.array([[1.0, 5.0], [0.0, 0.5]])
    change = np.array([[1e-6, 0.0], [0.0, 0.0]])
    _, bounds = eigenvalues_with_bounds(matrix, change, 4.0)
    assert bounds[0] == pytest.approx(1e-6, rel=1e-3)
    assert bounds[1] < 1e-9


# --- the corners of the domain -----------------------------------------------------------------------------------

SMALLEST = RADIUS * 1e-9
CORNERS = {
    "no suspension damping, slow": (rig(zeta=0.0), 0.01),
    "no damping at all": (rig(zeta=0.0, damping=0.0), 1.6),
    "over-damped": (rig(zeta=2.0), 0.3),
    "stiff pendulums": (rig(damping=50.0), 1.6),
    "stiff pendulums, slow": (rig(damping=50.0), 0.01),
    "one stiff, one free": (rig(damping=(50.0, 0.0)), 3.3),
    "weightless pendulums, stiff": (rig(damping=50.0, masses=(1e-9, 1e-9), moment=SMALLEST), 1.6),
    "weightless pendulums, slow": (rig(masses=(1e-9, 1e-9), moment=SMALLEST), 0.01),
    "pendulums as heavy as the disk": (rig(masses=(7.0, 7.0)), 0.83),
    "very soft": (rig(stiffness_ratio=1e-2), 1.6),
    "very stiff": (rig(stiffness_ratio=1e4), 0.83),
    "very stiff, slow": (rig(stiffness_ratio=1e4), 0.1),
    "very fast": (rig(), 100.0),
    "hardly any imbalance": (rig(moment=1e-12 * IMBALANCE), 1.6),
    "isotropic": (rig(stiffness_ratio=1.0), 1.6),
    "isotropic, stiff": (rig(stiffness_ratio=1.0, damping=(50.0, 1e-8)), 0.01),
}


@pytest.mark.parametrize("name", CORNERS)
def test_corners_against_an_independent_method(name: str) -> None:
    matrix = balanced_state(*CORNERS[name])
    found = floquet_multipliers(matrix, 1e-8)
    fast = np.abs(np.linalg.eigvals(matrix.at(0.0)).imag).max() / matrix.speed_rad_s
    matrix = balanced(matrix)  # a reference in SI units would lose digits
    if found.method == "implicit":
        truth = largest(METHODS["chebyshev"].monodromy(matrix, max(3, math.ceil(fast / 2))))
    else:
        truth = largest(METHODS["implicit"].monodromy(matrix, max(40, math.ceil(12 * fast))))
    assert abs(found.largest - truth) <= found.error_estimate + 2e-10
    assert found.error_estimate <= 1e-8 * max(1, found.largest)
    assert found.why


def test_the_slowest_undamped_stiffest_suspension() -> None:
    """160 000 cycles of the second mode in half a revolution."""
    matrix = balanced_state(rig(stiffness_ratio=1e4, zeta=0.0), 1e-3)
    found = floquet_multipliers(matrix, 1e-8)
    assert found.method == "magnus"
    assert found.largest == pytest.approx(1.0, abs=1e-8)  # nothing damps the disk; its pendulums only weakly


# S_A − S_B = S_P to the last bit
OPPOSED = dataclasses.replace(rig(masses=(0.075, 0.0375)), imbalance_mass_kg=0.0375, imbalance_radius_m=RADIUS)


@pytest.mark.parametrize("speed_ratio", [0.1, 1.6, 5.0])
@pytest.mark.parametrize(
    ("parameters", "damped", "ones"),
    [
        (rig(moment=2 * 0.075 * RADIUS), True, 1),
        (rig(moment=2 * 0.075 * RADIUS, damping=0.0), False, 2),
        (rig(moment=0.0), True, 1),
        (rig(moment=0.0, damping=0.0), False, 2),
        (OPPOSED, True, 1),
    ],
)
def test_on_the_borders_of_balance_a_multiplier_is_exactly_one(
    parameters: RotorParameters, damped: bool, ones: int, speed_ratio: float
) -> None:
    matrix = balanced_state(parameters, speed_ratio)
    rest, taken = without_neutral(matrix)
    assert taken == ones
    assert rest.dimension == 8 - ones
    found = floquet_multipliers(matrix, 1e-10)
    assert np.count_nonzero(found.values == 1.0) >= ones
    whole = np.linalg.eigvals(METHODS["implicit"].monodromy(matrix, 200)) ** 2
    assert np.sort(np.abs(whole)) == pytest.approx(np.sort(np.abs(found.values)), abs=1e-8 if damped else 1e-4)


def test_one_rounding_off_the_border_is_served() -> None:
    border = 2 * 0.075 * RADIUS
    for moment in (np.nextafter(border, 0), np.nextafter(border, 1)):
        p = rig(moment=float(moment))
        assert floquet_multipliers(balanced_state(p, 1.6)).largest == pytest.approx(1.0, abs=1e-7)


def test_two_resolutions_do_not_agree_by_chance() -> None:
    """Found in a draw: long commutator-free steps resonated with the second mode, 6e-9 off under a bound of 3e-9."""
    p = rig(9045.858008763107, (0.4704100650689856, 0.0008983197395219152), 8.176480983150571e-07)
    found = floquet_multipliers(balanced_state(p, 0.01115391601363389), 1e-8)
    assert abs(found.largest - 1.0004075284045584) <= found.error_estimate  # Radau IIA in 80 bits


def test_growth_beyond_floating_point_is_refused_and_called_unstable() -> None:
    growing = np.zeros((2, 2, 2), complex)
    growing[0] = np.diag([900.0, -1.0])
    growing[1, 0, 1] = 0.5
    for matrix in (PeriodicMatrix(growing, 1.0, None), PeriodicMatrix(growing[:1], 1.0, None)):
        with pytest.raises(NotConverged, match="unstable"):
            floquet_multipliers(matrix)


def test_an_accuracy_out_of_reach_is_refused_with_the_bound_it_reached() -> None:
    with pytest.raises(NotConverged, match=r"error bound .* wanted 1e-13|wanted accuracy 1e-13|accuracy 1e-13"):
        floquet_multipliers(balanced_state(rig(zeta=0.0, damping=1e-7), 0.01), 1e-13)


def test_scalar_equation_with_a_known_answer() -> None:
    """y' = (a + b cos ψ) y over 2π: exp(2π a/ω), independent of b."""
    h = np.array([[[-0.3 + 0j]], [[2.0 - 1.5j]]])
    for speed in (0.5, 3.0):
        found = floquet_multipliers(PeriodicMatrix(h, speed, None), 1e-11)
        assert found.largest == pytest.approx(math.exp(-0.6 * math.pi / speed), abs=1e-11)
