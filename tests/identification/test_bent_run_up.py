"""Run-up of a rig with an amplitude-dependent suspension, with the terms from ring-downs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial, reduce

import numpy as np
import pytest

from benchmarks.worlds.recording import record
from benchmarks.worlds.world import Effects, World, draw_world, with_effect
from dynamics.equations.speed_history import SpeedHistory
from identification.run_up.bent_oscillator import BentDirection, bent_response, forcing
from identification.run_up.bent_passage import BentPassage, KnownSuspension
from identification.run_up.fit import fit_run_up_run
from identification.run_up.forced_oscillator import Excitation, responses_at
from identification.run_up.result import run_up_estimate
from identification.run_up.slow_roll import bow_answer, turning
from tests.effort import thorough

OWN = (18.0, 0.02)
TIMES = np.linspace(0.5, 9.5, 901)
SPREAD = np.full(len(TIMES), 1e-6)
DRIVE = Excitation.from_history(SpeedHistory.ramp(8.0, 40.0, 10.0), 0.0, 10.0)


def response(
    terms: tuple[float, float],
    b: complex,
    f: complex = 1e-4 + 5e-5j,
    own: tuple[float, float] = OWN,
    bow: complex | None = None,
):
    return bent_response(
        SPREAD, turning(DRIVE, TIMES, SPREAD), DRIVE, forcing(DRIVE), BentDirection(own, terms, b, f, bow)
    )


def drawn(seed: int, effects: list[str]) -> World:
    return draw_world(seed, None, reduce(lambda sum_of, one: with_effect(one, sum_of), effects, Effects()))


def true_terms(world: World) -> np.ndarray:
    return np.r_[world.mechanics.hardening_per_m2, world.mechanics.quadratic_s_per_m]


def known_of(world: World) -> KnownSuspension:
    """Possible result of ring-downs, with terms that are 0.3 % off."""
    m, physics, true = world.mechanics, world.rig.physics, true_terms(world)
    w1, w2 = (float(np.sqrt(k / m.mass_kg)) for k in m.stiffness_N_per_m)
    amplitude = complex(physics.imbalance_moment_kg_m / physics.total_mass_kg)
    return KnownSuspension(1.003 * true, 0.005 * true, (w1, w2), world.zeta, world.axis_rad, amplitude)


def test_without_terms_it_is_the_linear_response() -> None:
    b, f = 3e-4 + 1e-4j, 1e-4 + 5e-5j
    found = response((0.0, 0.0), b, f)
    (linear,) = responses_at(TIMES, SPREAD, DRIVE, [OWN])
    shown = found.motion - (f * found.by_free).real
    other = (b * linear.h).real  # both but for a free oscillation, which each begins otherwise
    basis = np.column_stack([linear.decay.real, -linear.decay.imag])
    rest = shown - other
    rest = rest - basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]
    assert np.max(np.abs(rest)) < 1e-5 * np.max(np.abs(other))
    assert np.max(np.abs(found.by_free - linear.decay)) < 1e-5


@pytest.mark.parametrize("bow", [None, 1e-4 - 5e-5j])
def test_derivatives(bow: complex | None) -> None:
    terms, b, f = (5e3, 1.0), 3e-4 + 1e-4j, 1e-4 + 5e-5j
    own = partial(response, bow=bow)
    found = own(terms, b, f)
    w, z = OWN
    pairs = {
        "omega": (found.by_omega, lambda s: own(terms, b, f, (w * np.exp(s), z)), 1e-5),
        "zeta": (found.by_zeta, lambda s: own(terms, b, f, (w, z * np.exp(s))), 1e-4),
        "real": (found.by_drive.real, lambda s: own(terms, b + s, f), 1e-8),
        "imaginary": (-found.by_drive.imag, lambda s: own(terms, b + 1j * s, f), 1e-8),
        "free": (-found.by_free.imag, lambda s: own(terms, b, f + 1j * s), 1e-8),
        "H": (found.by_terms[0], lambda s: own((terms[0] + s, terms[1]), b, f), 1.0),
        "Q": (found.by_terms[1], lambda s: own((terms[0], terms[1] + s), b, f), 1e-3),
    }
    if bow is None:
        assert found.by_bow is None
    else:
        assert found.by_bow is not None
        pairs["bow"] = (found.by_bow.real, lambda s: response(terms, b, f, bow=bow + s), 1e-8)
        pairs["bow across"] = (-found.by_bow.imag, lambda s: response(terms, b, f, bow=bow + 1j * s), 1e-8)
    for name, (slope, moved, h) in pairs.items():
        difference = (moved(h).motion - moved(-h).motion) / (2 * h)
        assert np.max(np.abs(slope - difference)) < 1e-3 * np.max(np.abs(difference)), name


def test_a_bow_without_terms_is_the_linear_answer() -> None:
    w0 = 1e-4 - 5e-5j
    instants = TIMES, SPREAD
    (linear,) = responses_at(*instants, DRIVE, [OWN])
    shown = response((0.0, 0.0), 3e-4, bow=w0).motion - response((0.0, 0.0), 3e-4).motion
    other = (w0 * bow_answer(linear, turning(DRIVE, *instants), *OWN).h).real  # both but for a free oscillation
    basis = np.column_stack([linear.decay.real, -linear.decay.imag])
    rest = shown - other
    rest = rest - basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]
    assert np.max(np.abs(rest)) < 1e-4 * np.max(np.abs(other))


@pytest.mark.parametrize(
    "effects",
    [
        pytest.param(["quadratic"], marks=thorough),
        pytest.param(["cubic=0.03"], marks=thorough),
        ["quadratic", "bow"],
        pytest.param(["cubic", "bow"], marks=thorough),
        ["cubic", "phase_step", "speed_noise"],
    ],
)
def test_values_at_zero_amplitude(effects: list[str]) -> None:
    """Without the terms ζ2 is 180 standard deviations off, or the passage is not followed at all; a bow that is added
    to a bent passage's motion passes for run-out, and S_P is 360 off; a noisy phase's derivatives pass for both.
    """
    world = drawn(1000, effects)
    physics, true = world.rig.physics, true_terms(world)
    run = record(world, 1000, "run-up")
    fit = fit_run_up_run(run, known=known_of(world))
    assert fit.settled
    assert fit.chi2_per_dof < 1.05
    assert [w for w in fit.warnings if not w.startswith(("bow:", "the rotor's phase is read in steps"))] == []
    assert ("bow" in fit.model) == ("bow" in effects)
    estimate = run_up_estimate(run, fit, physics, world.rig.roles.gain_stds)
    for name in estimate.names:
        assert abs(estimate.value(name) - world.truth[name]) < 4 * estimate.std[name], name
    for own in fit.terms:
        at = np.array([own.direction - 1, own.direction + 1])
        gain = world.gain[own.direction - 1] ** np.array([-2.0, -1.0])  # as the sensor shows it
        std = np.sqrt(np.diag(own.covariance)[2:])
        assert np.all(np.abs(own.values - true[at] * gain) <= 4 * std)
    shown = [name for name in estimate.with_terms if np.any(estimate.with_terms[name])]
    assert len(shown) == 2


def test_the_gains_ratio_is_found_with_all_else() -> None:
    """A ratio taken from the amplitudes and held made a bow and a run-out of 55 µm of what sensors turned by 4.6° show,
    put ζ2 five standard deviations off, and moved it by seven when sensor y showed 0.3 % more.
    """
    world = drawn(1001, ["cubic=0.03", "turned"])
    run, known, gain = record(world, 1001, "run-up"), known_of(world), 1.003
    more = replace(known, terms=known.terms / np.array([1.0, gain**2, 1.0, gain]))
    fits = fit_run_up_run(run, known=known), fit_run_up_run(replace(run, y_m=gain * run.y_m), known=more)
    for fit in fits:
        assert fit.settled
        assert fit.warnings == []
    for name in ("f1_Hz", "zeta1", "f2_Hz", "zeta2"):
        assert abs(fits[1].values[name] - fits[0].values[name]) < 0.02 * fits[0].std[name], name
    for name in ("zeta1", "zeta2"):
        assert abs(fits[0].values[name] - world.truth[name]) < 3 * fits[0].std[name], name


def test_derivatives_of_what_a_sensor_sees_by_terms_and_ratio() -> None:
    passage = BentPassage.of(DRIVE, 3e-4)
    terms, c = np.array([5e3, 4e3, 1.0, 2.0]), np.array([3e-4, 1e-4, 1e-4, 5e-5, 0.0, 0.0])

    def sensed(axis: int, terms: np.ndarray, ratio: float):
        return passage.sensed(DRIVE, axis, 0.3, [OWN, (25.0, 0.03)], terms, ratio, (TIMES, SPREAD), c)

    def shown(axis: int, terms: np.ndarray, ratio: float) -> np.ndarray:
        seen = sensed(axis, terms, ratio)
        share = ((np.cos(0.3), np.sin(0.3)), (-np.sin(0.3), np.cos(0.3)))[axis]
        return sum(s * (complex(3e-4, 1e-4) * t * w).real for s, t, w in zip(share, (1, -1j), seen.whole, strict=True))

    for axis in range(2):
        found, h = sensed(axis, terms, 1.1), 1e-4
        difference = (shown(axis, terms, 1.1 * np.exp(h)) - shown(axis, terms, 1.1 * np.exp(-h))) / (2 * h)
        assert np.max(np.abs(found.by_ratio - difference)) < 1e-3 * np.max(np.abs(difference))
        for i in range(4):
            step = np.zeros(4)
            step[i] = 1e-4 * terms[i]
            difference = (shown(axis, terms + step, 1.1) - shown(axis, terms - step, 1.1)) / (2 * step[i])
            assert np.max(np.abs(found.by_terms[:, i] - difference)) < 1e-3 * np.max(np.abs(difference))
