"""Ring-downs whose spring hardens and whose damping grows with speed, from SciPy's integration of the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from daq.signals.run import Run
from identification import IdentificationError, RingDownFit, equivalent_linear, fit_ring_down, fit_ring_down_runs
from identification.errors import FitFailed
from identification.mounting import as_mounted
from identification.ring_down.backbone import Rates, course
from identification.ring_down.exact_motion import exact_motion
from tests.effort import cases, thorough

RATE, PULL_M, NOISE_M, MASS_KG = 2000.0, 2.5e-3, 4e-6, 7.345
F, ZETA = (3.0, 11.6), (0.012, 0.006)
NAMES = ("f1_Hz", "zeta1", "f2_Hz", "zeta2")


def motion(f: float, zeta: float, start_m: float, t: np.ndarray, stiffness: float, damping: float) -> np.ndarray:
    """q̈ + 2ζω q̇ + d2 |q̇| q̇ + ω² (1 + κ q²) q = 0 released from rest; additions to k and ζ at 2.5 mm, relative."""
    w, cubic, drag = 2 * np.pi * f, stiffness / PULL_M**2, 0.75 * np.pi * damping * zeta / PULL_M

    def slope(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -2 * zeta * w * y[1] - drag * abs(y[1]) * y[1] - w * w * (1 + cubic * y[0] ** 2) * y[0]]

    return solve_ivp(slope, (0.0, t[-1]), [start_m, 0.0], "DOP853", t, rtol=1e-10, atol=1e-13).y[0]


def pluck(
    seed: int, axis: int, stiffness: float = 0.0, damping: float = 0.0, cross: float = 0.1, record_s: float = 5.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times, and sensors x and y turned by an angle, with 4 µm of noise and rounded to 0.4 µm."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(record_s * RATE)) / RATE
    starts = PULL_M * np.where(np.arange(2) == axis, 1.0, cross)
    own = np.column_stack([motion(F[i], ZETA[i], starts[i], t, stiffness, damping) for i in range(2)])
    b = np.radians(3.0)
    seen = own @ np.array([[np.cos(b), np.sin(b)], [-np.sin(b), np.cos(b)]]).T
    return t, 4e-7 * np.round((seen + NOISE_M * rng.normal(size=seen.shape)) / 4e-7)


def assert_true_at_zero(fit: RingDownFit, names: tuple[str, ...] = NAMES) -> None:
    for name, true in zip(NAMES, (F[0], ZETA[0], F[1], ZETA[1]), strict=True):
        if name in names:
            assert abs(fit.values[name] - true) < 4 * fit.std[name], name


@pytest.mark.parametrize(
    ("stiffness", "damping", "axis"),
    [
        (-0.01, 0.0, 1),
        (0.0, 0.5, 1),
        (0.03, 0.5, 0),
        *(
            pytest.param(*case, marks=thorough)
            for case in (
                (0.003, 0.0, 0),
                (0.003, 0.0, 1),
                (0.03, 0.0, 0),
                (0.03, 0.0, 1),
                (-0.01, 0.0, 0),
                (0.0, 0.5, 0),
                (0.03, 0.5, 1),
            )
        ),
    ],
)
def test_what_depends_on_amplitude_is_fitted_and_named(axis: int, stiffness: float, damping: float) -> None:
    t, signal = pluck(axis, axis, stiffness, damping)
    fit = fit_ring_down(t, signal, MASS_KG)
    assert_true_at_zero(fit)
    assert fit.verdict.startswith("adequate")
    (term,) = (one for one in fit.nonlinear if one.direction == axis + 1)
    assert term.kinds == (*(["frequency"] if stiffness else []), *(["damping"] if damping else []))
    assert abs(term.cubic_stiffness_per_m2 - stiffness / PULL_M**2) <= 4 * term.cubic_stiffness_std
    assert abs(term.zeta_slope_per_m - damping * ZETA[axis] / PULL_M) <= 4 * term.zeta_slope_std
    text = " ".join(fit.warnings)
    assert (f"direction {axis + 1} {'hardens' if stiffness > 0 else 'softens'}" in text) == bool(stiffness)
    assert (f"direction {axis + 1}'s damping grows with amplitude" in text) == bool(damping)
    assert "depends on amplitude" not in text
    assert f"direction {axis + 1}" in fit.model


def test_a_direction_that_hardly_moves_covers_the_term_that_it_cannot_show() -> None:
    """At 0.1 mm the damping ratio is 2 % above that at zero amplitude, which the motion there does not resolve."""
    for seed in range(cases(1, 3)):
        t, signal = pluck(seed, 1, 0.0, 0.5, cross=0.04)
        fit = fit_ring_down(t, signal)
        assert [one.direction for one in fit.nonlinear] == [2]
        assert_true_at_zero(fit)


def test_the_cheapest_setting_leaves_the_terms_out() -> None:
    t, signal = pluck(3, 0, 0.003)
    fit = fit_ring_down(t, signal, setting="fast")
    assert fit.nonlinear == []
    assert abs(fit.values["f1_Hz"] - F[0]) > 10 * fit_ring_down(t, signal).std["f1_Hz"]


def test_linear_motion_has_no_such_terms() -> None:
    for seed in range(cases(2, 6)):
        t, signal = pluck(seed, seed % 2)
        fit = fit_ring_down(t, signal)
        assert fit.nonlinear == []
        assert fit.warnings == []
        assert_true_at_zero(fit)


def test_a_line_next_to_a_mode_is_no_spring() -> None:
    t, signal = pluck(4, 1)
    line = 20e-6 * np.cos(2 * np.pi * (F[1] + 0.3) * t)
    fit = fit_ring_down(t, signal + np.column_stack([0.7 * line, line]))
    assert fit.nonlinear == []
    assert any("11.90 Hz" in w for w in fit.warnings)


def test_dry_friction_is_refused() -> None:
    """The amplitude also decreases linearly. ζ at zero amplitude would be a third too large."""
    t, w, friction = np.arange(10_000) / 1000, 2 * np.pi * 4.0, 5e-5
    level = np.maximum((1e-3 + friction) * np.exp(-0.01 * w * t) - friction, 0.0)
    signal = level * np.cos(w * t + 0.3) + 4e-6 * np.random.default_rng(0).normal(size=len(t))
    with pytest.raises(FitFailed, match="damping ratio falls with amplitude"):
        fit_ring_down(t, signal)


def test_directions_change_names_with_the_mounting() -> None:
    t, signal = pluck(5, 0, 0.01, 0.2)
    fit = fit_ring_down(t, signal)
    turned = as_mounted(fit, 90.0)
    assert [one.direction for one in fit.nonlinear] == [1]
    assert [one.direction for one in turned.nonlinear] == [2]
    assert "direction 2 hardens" in " ".join(turned.warnings)
    assert "direction 2 hardens" in turned.model
    assert equivalent_linear(turned, 2, 1e-3).f_Hz == equivalent_linear(fit, 1, 1e-3).f_Hz


def test_equivalent_linear_values_at_an_amplitude() -> None:
    """Frequency against the period of the undamped cubic oscillator, an elliptic integral."""
    stiffness, damping = 0.03, 0.5
    t, signal = pluck(6, 1, stiffness, damping)
    fit = fit_ring_down(t, signal, MASS_KG)
    at_zero, pulled = (equivalent_linear(fit, 2, a) for a in (0.0, PULL_M))
    assert at_zero.f_Hz == fit.values["f2_Hz"]
    assert at_zero.k_std == pytest.approx(fit.std["k2_N_per_m"])
    root = np.sqrt(1 + stiffness)  # period 4 K(m)/(ω sqrt(1 + κa²)), m = κa²/(2 (1 + κa²))
    exact = F[1] * root * np.pi / (2 * ellipk(stiffness / (2 * (1 + stiffness))))
    assert pulled.f_Hz == pytest.approx(exact, rel=2e-5)
    assert pulled.k_N_per_m == pytest.approx(MASS_KG * (2 * np.pi * exact) ** 2, rel=4e-5)
    assert pulled.zeta == pytest.approx(ZETA[1] * (1 + damping), rel=2e-3)
    assert 0 < pulled.f_std < 1e-4 * pulled.f_Hz
    assert 0 < pulled.zeta_std < 0.01 * pulled.zeta
    linear = equivalent_linear(fit, 1, PULL_M)
    assert linear.f_Hz == fit.values["f1_Hz"]
    assert linear.zeta_std == pytest.approx(fit.std["zeta1"])


def test_an_equivalent_that_is_not_there_is_refused() -> None:
    t, signal = pluck(7, 0)
    fit = fit_ring_down(t, signal[:, 0])
    with pytest.raises(IdentificationError, match="no direction 2"):
        equivalent_linear(fit, 2, 1e-3)
    with pytest.raises(IdentificationError, match="amplitude_m >= 0"):
        equivalent_linear(fit, 1, -1e-3)
    t, signal = pluck(7, 0, -0.01)
    softened = fit_ring_down(t, signal)
    with pytest.raises(IdentificationError, match="no stiffness left"):
        equivalent_linear(softened, 1, 0.1)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    f=st.floats(2.0, 12.0), zeta=st.floats(-1e-3, 0.1), hardening=st.floats(-0.002, 0.005), drag=st.floats(-2e-5, 0.01)
)
def test_the_averaged_course_is_that_of_its_equations(f: float, zeta: float, hardening: float, drag: float) -> None:
    """ȧ = −(ζ + S a/A) ω a and φ̇ = ω_d (1 + η (a/A)²), integrated; and derivatives against differences."""
    w, level, t = 2 * np.pi * f, 2.5, np.linspace(0.0, 2.0, 60)
    wave = w * np.sqrt(1 - zeta**2)
    rates = Rates(w, zeta, hardening, drag)

    def slope(_: float, y: np.ndarray) -> list[float]:
        size = level * np.exp(y[0])
        return [-(zeta + drag * size) * w, wave * (1 + hardening * size**2)]

    own = course(rates, 1e-3 * level, t)
    integrated = solve_ivp(slope, (0.0, 2.0), [0.0, 0.0], "DOP853", t, rtol=1e-11, atol=1e-12).y
    np.testing.assert_allclose(own.power.real, integrated[0], atol=1e-7)
    np.testing.assert_allclose(own.power.imag, integrated[1], atol=1e-6)
    for place, (name, step) in enumerate((("omega", 1e-6 * w), ("zeta", 1e-6), ("hardening", 1e-6), ("drag", 1e-6))):
        ends = [
            course(replace(rates, **{name: getattr(rates, name) + s}), 1e-3 * level, t).power for s in (-step, step)
        ]
        by = own.by[place] / (w if name == "omega" else 1.0)
        np.testing.assert_allclose((ends[1] - ends[0]) / (2 * step), by, rtol=1e-4, atol=1e-4 * np.max(np.abs(by)))


def test_the_integrated_motion_is_scipy_s() -> None:
    t = np.arange(8000) / RATE
    exact = motion(F[1], ZETA[1], PULL_M, t, 0.03, 0.5)
    w, hardening, drag = 2 * np.pi * F[1], 0.03 * 3 / 8 / 2.5**2, 0.5 * ZETA[1] / 2.5
    rates = Rates(w, ZETA[1], hardening, drag)
    rate = course(rates, PULL_M, np.zeros(1)).rate[0]
    start = complex(PULL_M, PULL_M * rate.real / rate.imag)  # at rest, but for the second order of its size
    for scale in (1.0, 4.0):
        level = abs(start)
        own = exact_motion(replace(rates), start / scale, scale, t)
        assert abs(own[0, 0] - PULL_M / scale) < 1e-12
        speed = own[1, 0] * scale
        shifted = solve_ivp(
            lambda _, y: [
                y[1],
                -2 * ZETA[1] * w * y[1]
                - 0.75 * np.pi * drag * 1e3 * abs(y[1]) * y[1]
                - w * w * (1 + 0.03 / PULL_M**2 * y[0] ** 2) * y[0],
            ],
            (0.0, t[-1]),
            [PULL_M, speed],
            "DOP853",
            t,
            rtol=1e-11,
            atol=1e-14,
        ).y[0]
        assert level > 0
        np.testing.assert_allclose(own[0] * scale, shifted, atol=2e-8)
    assert np.max(np.abs(exact - shifted)) < 1e-3 * PULL_M


def test_plucks_of_different_size_share_the_terms() -> None:
    """One along each direction: together they name both; the spring is known better than from one."""
    none = np.empty(0)
    runs = []
    for seed, axis, share in ((21, 0, 1.0), (22, 0, 0.5), (23, 1, 1.0)):
        t, signal = pluck(seed, axis, 0.01 * share**2, 0.2 * share)  # the same spring and damper, a smaller pull
        x, y = share * signal.T
        runs.append(Run(f"ring-down-{'xy'[axis]}", "", 0.0, t, x, t, y, none, none.reshape(0, 2), none, none))
    fit = fit_ring_down_runs(runs, MASS_KG)
    assert_true_at_zero(fit)
    assert fit.verdict.startswith("adequate")
    first, second = fit.nonlinear
    assert (first.direction, second.direction) == (1, 2)
    for term, zeta in ((first, ZETA[0]), (second, ZETA[1])):
        assert term.kinds == ("frequency", "damping")
        assert abs(term.cubic_stiffness_per_m2 - 0.01 / PULL_M**2) < 4 * term.cubic_stiffness_std
        assert abs(term.zeta_slope_per_m - 0.2 * zeta / PULL_M) < 4 * term.zeta_slope_std
    alone = fit_ring_down_runs(runs[:1], MASS_KG).nonlinear[0]
    assert alone.direction == 1
    assert first.cubic_stiffness_std < alone.cubic_stiffness_std
