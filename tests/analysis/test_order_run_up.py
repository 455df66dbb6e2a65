"""Order vectors through run-ups whose vectors are known: exact motions of one resonance, and vectors made up."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.signal import lfilter

from analysis import order_track
from analysis.quantities.order_maps import order_map, resampled_order_track
from analysis.quantities.slow_roll import slow_roll_vector, without_slow_roll
from tests.effort import cases

RATE_HZ = 2000.0


def run_up(
    f_Hz: float,
    zeta: float,
    noise_m: float,
    seed: int,
    *,
    from_rpm: float = 60.0,
    rpm_per_s: float = 10.0,
    s: float = 60.0,
):
    """Times, displacements, phases, vectors of order 1: q̈ + 2ζω0 q̇ + ω0² q = e (ω² − iω̇) e^{iψ}, from its modes."""
    t = np.arange(int(s * RATE_HZ)) / RATE_HZ
    speed, quickens = from_rpm * np.pi / 30, rpm_per_s * np.pi / 30

    def psi(at):
        return 0.3 + speed * at + 0.5 * quickens * at**2

    def force(at):
        return 350e-6 * ((speed + quickens * at) ** 2 - 1j * quickens) * np.exp(1j * psi(at))

    w0 = 2 * np.pi * f_Hz
    mode = -zeta * w0 + 1j * w0 * np.sqrt(1 - zeta**2)
    q = np.zeros(len(t), complex)
    for root, share in ((mode, 1 / (mode - np.conj(mode))), (np.conj(mode), 1 / (np.conj(mode) - mode))):
        step = np.exp(root / RATE_HZ)
        middle = force(t[:-1] + 0.5 / RATE_HZ)
        grown = (force(t[:-1]) * step + 4 * middle * np.exp(0.5 * root / RATE_HZ) + force(t[1:])) / (6 * RATE_HZ)
        q += share * lfilter([1], [1, -step], np.concatenate([[force(t[:1])[0] / (1j * speed - root)], grown]))
    vector = q * np.exp(-1j * psi(t))
    x = q.real + 2e-4 + (5e-5 * np.exp(1j * (2 * psi(t) + 1))).real
    return t, x + noise_m * np.random.default_rng(seed).standard_normal(len(t)), psi(t), vector


def errors(track, t, vector):
    truth = np.interp(track.time_s, t, vector.real) + 1j * np.interp(track.time_s, t, vector.imag)
    return track.amplitude_m[:, 0] - truth, truth


@pytest.mark.parametrize(("f_Hz", "zeta", "start"), [(3.0, 0.02, 60.0), (11.6, 0.02, 300.0), (6.0, 0.1, 100.0)])
def test_vectors_through_a_resonance_within_a_percent_and_a_degree(f_Hz, zeta, start) -> None:
    t, x, psi, vector = run_up(f_Hz, zeta, 10e-6, 1, from_rpm=start)
    track = order_track(t, x, psi)
    off, truth = errors(track, t, vector)
    large = np.abs(truth) > 0.3 * np.abs(truth).max()
    assert large.sum() > 10
    assert np.abs(np.abs(truth + off) / np.abs(truth) - 1)[large].max() < 0.01
    assert np.abs(np.degrees(np.angle((truth + off) / truth)))[large].max() < 1.0


@pytest.mark.parametrize(("f_Hz", "zeta", "noise"), [(3.0, 0.02, 10e-6), (3.0, 0.05, 50e-6), (11.6, 0.02, 2e-6)])
def test_stated_deviations_cover(f_Hz, zeta, noise) -> None:
    inside = []
    seeds = cases(2, 6)
    for seed in range(seeds):
        t, x, psi, vector = run_up(f_Hz, zeta, noise, seed, from_rpm=60.0 if f_Hz < 5 else 300.0)
        track = order_track(t, x, psi)
        off, _ = errors(track, t, vector)
        z = np.stack([off.real, off.imag]) / track.std_m[:, 0]
        inside.append(np.mean(np.abs(z) < 1.96))
        assert np.abs(z).max() < 6
    wider = (6 / seeds) ** 0.5
    assert 0.95 - 0.02 * wider < np.mean(inside) < 0.95 + 0.025 * wider


def test_a_constant_vector_is_found_as_well_as_by_least_squares() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(20000) / RATE_HZ
    psi = 31.0 * t
    x = (1e-3 * np.exp(1j * (psi + 0.4))).real
    off = [
        order_track(t, x + 1e-5 * rng.standard_normal(len(t)), psi).amplitude_m[25, 0] - 1e-3 * np.exp(0.4j)
        for _ in range(30)
    ]
    whole = 1e-5 * np.sqrt(2 / len(t))
    assert np.sqrt(np.mean(np.abs(off) ** 2) / 2) < 4 * whole  # a window of four turns has seven times


def test_noise_that_is_larger_near_the_order_widens() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(60000) / RATE_HZ
    psi = 30.0 * t + 0.5 * t**2
    slow = lfilter([1], [1, -0.97], rng.standard_normal(len(t))) * 5e-6
    x = (2e-4 * np.exp(1j * psi)).real + slow
    track = order_track(t, x, psi)
    z = np.abs(track.amplitude_m[:, 0] - 2e-4) / track.std_m[:, 0]
    assert np.mean(z < 2.45) > 0.85  # 95 % of a circle


def test_resampling_agrees_where_the_speed_rises_slowly_and_smears_where_it_does_not() -> None:
    t, x, psi, vector = run_up(6.0, 0.02, 10e-6, 1, from_rpm=100.0)
    usual, ours = resampled_order_track(t, x, psi), order_track(t, x, psi)
    off, truth = errors(usual, t, vector)
    late = usual.time_s > 45
    assert np.abs(off)[late].max() < 0.01 * np.abs(truth)[late].max()
    off_ours, _ = errors(ours, t, vector)
    assert np.abs(off).max() > 5 * np.abs(off_ours).max()


def test_an_order_map_shows_an_order_at_its_place() -> None:
    t = np.arange(60000) / RATE_HZ
    psi = 20.0 * t + 1.0 * t**2
    x = (1e-3 * np.exp(1j * (psi + 0.5))).real + (3e-4 * np.exp(1j * (2.5 * psi - 1))).real
    found = order_map(t, x, psi, revolutions=8)
    one, other = (int(np.argmin(np.abs(found.order - order))) for order in (1.0, 2.5))
    assert found.vectors_m[:, one] == pytest.approx(np.full(len(found.time_s), 1e-3 * np.exp(0.5j)), rel=5e-3)
    assert found.vectors_m[:, other] == pytest.approx(np.full(len(found.time_s), 3e-4 * np.exp(-1j)), rel=5e-3)
    quiet = (np.abs(found.order - 1) > 0.4) & (np.abs(found.order - 2.5) > 0.4)
    assert found.amplitude_m[:, quiet].max() < 5e-6
    assert found.speed_rad_s == pytest.approx(20.0 + 2.0 * found.time_s, rel=1e-2)


def test_slow_roll_is_taken_off() -> None:
    t, x, psi, vector = run_up(11.6, 0.02, 2e-6, 3, from_rpm=100.0)
    bow = 8e-5 * np.exp(0.7j)
    track = order_track(t, x + (bow * np.exp(1j * psi)).real, psi)
    slow, std = slow_roll_vector(track, below_rad_s=130 * np.pi / 30)
    early = vector[t < 3].mean()
    assert abs(slow - bow - early) < 1e-6 + 4 * std
    late = errors(without_slow_roll(track, bow), t, vector)[0]
    assert np.abs(late).max() < 2e-5
    with pytest.raises(ValueError, match="slow roll"):
        slow_roll_vector(track, below_rad_s=1.0)


@settings(max_examples=15, deadline=None)
@given(lost=st.floats(0.0, 0.6), angle=st.floats(-3.1, 3.1), backward=st.booleans(), seed=st.integers(0, 1000))
def test_lost_samples_and_a_rotor_that_turns_back(lost: float, angle: float, backward: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 12, 9000))
    psi = (-1 if backward else 1) * (25.0 * t + 0.4 * t**2)
    x = (1e-3 * np.exp(1j * (psi + angle))).real + 1e-6 * rng.standard_normal(len(t))
    x[rng.random(len(t)) < lost] = np.nan
    track = order_track(t, x, psi)
    assert np.abs(track.amplitude_m[:, 0] - 1e-3 * np.exp(1j * angle)).max() < 1e-6
    assert np.all(track.speed_rad_s > 0)


def test_what_cannot_be_tracked_is_refused() -> None:
    t = np.arange(4000) / RATE_HZ
    with pytest.raises(ValueError, match="revolutions"):
        order_track(t, np.sin(t), 0.0 * t)
    with pytest.raises(ValueError, match="repeat the time before"):
        order_track(np.repeat(t[::2], 2), np.sin(t), 40 * t)
    with pytest.raises(ValueError, match="at least 1"):
        order_track(t, np.sin(t), 40 * t, orders=(0,))
    with pytest.raises(ValueError, match="alike"):
        order_map(t, t[:-1], t)
    with pytest.raises(ValueError, match="whole revolutions"):
        order_map(t, np.sin(t), 10 * t, revolutions=8)
