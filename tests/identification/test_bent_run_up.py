"""A run-up of a rig whose suspension depends on the motion, with the terms that ring-downs know."""

from __future__ import annotations

from functools import partial, reduce

import numpy as np
import pytest

from benchmarks.worlds.recording import record
from benchmarks.worlds.world import Effects, draw_world, with_effect
from dynamics.equations.speed_history import SpeedHistory
from identification.run_up.bent_oscillator import bent_response, forcing
from identification.run_up.bent_passage import KnownSuspension
from identification.run_up.fit import fit_run_up_run
from identification.run_up.forced_oscillator import Drive, responses_at
from identification.run_up.result import run_up_estimate
from identification.run_up.slow_roll import bow_answer, turning

OWN = (18.0, 0.02)
TIMES = np.linspace(0.5, 9.5, 901)
SPREAD = np.full(len(TIMES), 1e-6)
DRIVE = Drive.from_history(SpeedHistory.ramp(8.0, 40.0, 10.0), 0.0, 10.0)


def response(
    terms: tuple[float, float], b: complex, f: complex = 1e-4 + 5e-5j, own: tuple[float, float] = OWN,
    bow: complex | None = None,
):  # fmt: skip
    return bent_response(SPREAD, turning(DRIVE, TIMES, SPREAD), DRIVE, forcing(DRIVE), own, terms, b, f, bow)


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
    [["quadratic"], ["cubic=0.03"], ["quadratic", "bow"], ["cubic", "bow"], ["cubic", "phase_step", "speed_noise"]],
)
def test_values_at_zero_amplitude(effects: list[str]) -> None:
    """Without the terms ζ2 is 180 standard deviations off, or the passage is not followed at all; a bow that is added
    to a bent passage's motion passes for run-out, and S_P is 360 off; a noisy phase's derivatives pass for both.
    """
    world = draw_world(1000, None, reduce(lambda sum_of, one: with_effect(one, sum_of), effects, Effects()))
    m, physics = world.mechanics, world.rig.physics
    true = np.r_[m.hardening_per_m2, m.quadratic_s_per_m]
    omegas = tuple(float(np.sqrt(k / m.mass_kg)) for k in m.stiffness_N_per_m)
    known = KnownSuspension(
        1.003 * true, 0.005 * true, (omegas[0], omegas[1]), world.zeta, world.axis_rad,
        complex(physics.imbalance_moment_kg_m / physics.total_mass_kg),
    )  # fmt: skip
    run = record(world, 1000, "run-up")
    fit = fit_run_up_run(run, known=known)
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
