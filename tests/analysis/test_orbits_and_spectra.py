"""Orbits, spectra, slip and amplification of motions that are known."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis import order_track
from analysis.quantities.amplification import amplification_factors, principal_axis
from analysis.quantities.orbits import forward_backward, orbit_ellipse, turned
from analysis.quantities.slip import slip_track
from analysis.quantities.spectra import amplitude_spectrum, full_spectrum, power_density
from tests.effort import THOROUGH

parts = st.complex_numbers(min_magnitude=1e-7, max_magnitude=1e-2, allow_nan=False)


@given(forward=parts, backward=parts)
def test_the_ellipse_is_that_of_its_points(forward: complex, backward: complex) -> None:
    x, y = forward + backward.conjugate(), -1j * (forward - backward.conjugate())
    ellipse = orbit_ellipse(x, y)
    px, py = ellipse.points(np.linspace(0, 2 * np.pi, 7201))
    assert px == pytest.approx((x * np.exp(1j * np.linspace(0, 2 * np.pi, 7201))).real, abs=1e-12)
    radius = np.hypot(px, py)
    assert radius.max() == pytest.approx(ellipse.major_m, rel=1e-5)
    assert radius.min() == pytest.approx(abs(ellipse.minor_m), abs=1e-3 * ellipse.major_m)
    far = np.argmax(radius)
    if ellipse.major_m - abs(ellipse.minor_m) > 1e-3 * ellipse.major_m:
        assert math.sin(math.atan2(py[far], px[far]) - ellipse.inclination_rad) == pytest.approx(0, abs=0.03)
    assert (ellipse.minor_m > 0) == (np.mean(px * np.gradient(py) - py * np.gradient(px)) > 0) or ellipse.minor_m == 0


def test_precession_and_its_doubt() -> None:
    assert orbit_ellipse(1e-3, -1e-3j).precession == "forward"  # y = Re(−i e^{iψ}) = sin ψ
    assert orbit_ellipse(1e-3, 1e-3j).precession == "backward"
    assert orbit_ellipse(1e-3, 2e-3).precession == "straight"
    assert orbit_ellipse(1e-3, -1e-5j, 1e-5, 1e-5).precession == "straight"


def test_turned_axes_see_the_same_orbit() -> None:
    x, y = np.array([1e-3 + 2e-4j]), np.array([-3e-4j])
    one, two = forward_backward(x, y), forward_backward(*turned(x, y, 0.7))
    assert np.abs(one) == pytest.approx(np.abs(two))
    assert np.angle(two[0] / one[0]) == pytest.approx([-0.7])


def signals(noise: float = 0.0):
    t = np.arange(80000) / 4000
    rng = np.random.default_rng(1)
    x = 1e-3 * np.cos(2 * np.pi * 12 * t) + 2e-4 * np.cos(2 * np.pi * 50 * t + 1)
    y = 1e-3 * np.sin(2 * np.pi * 12 * t) - 2e-4 * np.sin(2 * np.pi * 50 * t + 1)
    return t, x + noise * rng.standard_normal(len(t)), y + noise * rng.standard_normal(len(t))


def test_lines_have_their_amplitudes_and_the_density_its_variance() -> None:
    t, x, _ = signals(1e-5)
    lines = amplitude_spectrum(t, x, window_s=2.0)
    assert lines.values[np.argmin(np.abs(lines.frequency_Hz - 12))] == pytest.approx(1e-3, rel=2e-3)
    assert lines.values[np.argmin(np.abs(lines.frequency_Hz - 50))] == pytest.approx(2e-4, rel=5e-3)
    density = power_density(t, x, window_s=2.0)
    step = density.frequency_Hz[1]
    assert density.values.sum() * step == pytest.approx(np.var(x), rel=1e-2)
    white = density.values[density.frequency_Hz > 100].mean()
    assert white == pytest.approx(1e-10 / 2000, rel=0.03)


def test_a_full_spectrum_separates_forward_from_backward() -> None:
    t, x, y = signals(1e-6)
    found = full_spectrum(t, x, y, window_s=2.0)

    def at(frequency):
        return found.values[np.argmin(np.abs(found.frequency_Hz - frequency))]

    assert at(12) == pytest.approx(1e-3, rel=1e-3)
    assert at(-50) == pytest.approx(2e-4, rel=1e-3)
    assert at(-12) < 1e-6
    assert at(50) < 1e-6


def test_windows_with_gaps_are_left_out() -> None:
    t, x, _ = signals(1e-5)
    x[30000:34000] = np.nan
    holed = amplitude_spectrum(t, x, window_s=2.0)
    assert holed.averages == 16  # of 19
    assert holed.values[np.argmin(np.abs(holed.frequency_Hz - 12))] == pytest.approx(1e-3, rel=2e-3)
    with pytest.raises(ValueError, match="without a gap"):
        power_density(t, x, window_s=15.0)
    with pytest.raises(ValueError, match="alike"):
        power_density(t, x[:-1])


def test_slip_order() -> None:
    t = np.arange(4000) / 200
    psi = 40.0 * t
    angle = np.stack([0.3 + 0.02 * np.cos(psi), -0.25 * psi + 0.01 * np.sin(2 * psi)], axis=1)
    found = slip_track(t, angle + 1e-3 * np.random.default_rng(0).standard_normal(angle.shape), psi)
    assert np.abs(found.slip_order[:, 0] / found.std[:, 0]).max() < 5
    assert found.slip_order[:, 1] == pytest.approx(np.full(len(found.time_s), -0.25), abs=5e-4)
    assert found.speed_rad_s == pytest.approx(np.full(len(found.time_s), 40.0))
    with pytest.raises(ValueError, match="whole turns"):
        slip_track(t[:20], angle[:20], psi[:20])


def split_run_up(axis_rad: float, noise: float, seed: int = 0):
    """Two sensors whose axes are turned against two resonances, vectors of a slow run-up."""
    t = np.arange(180000) / 1500
    speed = 2 * np.pi * (3.0 + 0.1 * t)
    psi = 2 * np.pi * (3.0 * t + 0.05 * t**2)
    u, v = (
        350e-6 * speed**2 / ((2 * np.pi * f) ** 2 - speed**2 + 2j * zeta * 2 * np.pi * f * speed)
        for f, zeta in ((6.0, 0.05), (10.0, 0.03))
    )
    x, y = turned(u, -1j * v, -axis_rad)
    rng = np.random.default_rng(seed)
    return [order_track(t, (w * np.exp(1j * psi)).real + noise * rng.standard_normal(len(t)), psi) for w in (x, y)]


def test_amplification_on_principal_axes_is_the_same_however_the_sensors_are_turned() -> None:
    found = {}
    for degrees in (0.0, 44.0, *((-45.0, 20.0) if THOROUGH else ())):
        x, y = split_run_up(math.radians(degrees), 1e-5)
        axis = principal_axis(x, y)
        assert math.sin(2 * (axis - math.radians(degrees))) == pytest.approx(0, abs=0.02)
        pair = amplification_factors(x, y)
        found[degrees] = sorted((one.peak_rad_s, one.factor, one.std) for one in pair if one)
    for rows in found.values():
        assert len(rows) == 2
        for (at, factor, std), (at0, factor0, std0), zeta in zip(rows, found[0.0], (0.05, 0.03), strict=True):
            assert at == pytest.approx(at0, rel=3e-3)
            assert abs(factor - factor0) < 4 * math.hypot(std, std0)
            assert factor == pytest.approx(1 / (2 * zeta), rel=0.05)
