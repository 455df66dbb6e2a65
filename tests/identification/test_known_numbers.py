"""Derivatives of identified values by masses, lengths and zeros: by the formula, and by fits with changed numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from synthetic import Campaign

from identification import fit_release, fit_run_up_run, fit_spin_down_run
from identification.estimate import Estimate
from identification.joint import combine
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientFit
from identification.run_up.fit import run_up_estimate
from rig_configs.known import ZERO_A, ZERO_B, KnownSource, physical_numbers, with_number

ZERO_STD = float(np.radians(0.05))
STEP = 2e-4  # of a number


def knowledge(campaign: Campaign) -> Knowledge:
    true = campaign.truth.identified()
    found = {n: true[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    # k by ring-downs is proportional to the total mass
    share = {n: v / campaign.rig.physics.total_mass_kg for n, v in found.items() if n.startswith("k")}
    nominal = Knowledge.nominal(campaign.rig.physics).with_found(found, {n: 1e-4 * v for n, v in found.items()})
    return nominal.with_slopes(found, dict.fromkeys(("rotor.mass_kg", "pendulums.a.mass_kg"), share))


def refitted(known: Knowledge, number: str, fit: Callable[[Knowledge], TransientFit]) -> np.ndarray:
    """Relative change of c3, c4 without friction per relative change of a number, by two fits."""
    step = STEP * physical_numbers(known.physics)[number]
    up, down = (fit(known.moved(number, sign * step)).open_friction for sign in (1, -1))
    assert up is not None
    assert down is not None
    return np.log(up.given(np.zeros(4))[0] / down.given(np.zeros(4))[0]) / (2 * STEP)


@pytest.mark.parametrize("number", ["rotor.mass_kg", "pendulums.a.mass_kg", "pendulums.b.length_m"])
def test_a_release_goes_with_a_number_as_fits_with_it_changed_do(number: str) -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    known, run = knowledge(campaign), campaign.point("D")

    def fit(with_it: Knowledge) -> TransientFit:
        return fit_release(run, with_it, ZERO_STD)

    here = fit(known).open_friction
    assert here is not None
    slope = here.by_number[number] * physical_numbers(known.physics)[number]
    by = dataclasses.replace(here, values=slope).given(np.zeros(4))[0] / here.given(np.zeros(4))[0]
    assert by == pytest.approx(refitted(known, number, fit), rel=0.05, abs=0.03)


def test_a_spin_down_goes_with_a_pendulum_s_inertia() -> None:
    """c = J λ: the rate at which the speed decays is seen, so c is proportional to M and to R²."""
    campaign = Campaign(2, clock_rate_std=0.0)
    fit = fit_spin_down_run(campaign.spin_down(), knowledge(campaign))
    mass, length = (fit.by_number[f"pendulums.a.{n}"][0] for n in ("mass_kg", "length_m"))
    assert mass * campaign.rig.physics.a.mass_kg == pytest.approx(1.0, abs=0.15)
    assert length * campaign.rig.physics.a.length_m == pytest.approx(2.0, abs=0.2)


def test_a_run_up_goes_with_numbers_as_estimates_with_them_changed_do() -> None:
    campaign = Campaign(1, clock_rate_std=0.0)
    run, physics = campaign.run_up(), campaign.rig.physics
    fit = fit_run_up_run(run, setting="fast")
    found = run_up_estimate(run, fit, physics, (1e-3, 1e-3))
    for number in ("rotor.mass_kg", "pendulums.a.mass_kg", "pendulums.b.length_m"):
        value = physical_numbers(physics)[number]
        up, down = (
            run_up_estimate(run, fit, with_number(physics, number, value * (1 + s)), (1e-3, 1e-3)).values
            for s in (1e-5, -1e-5)
        )
        slope = (up - down) / (2e-5 * value)
        assert found.by_number[number] == pytest.approx(slope, rel=1e-4, abs=1e-8)
    for at, zero in enumerate((ZERO_A, ZERO_B)):
        up, down = (
            run_up_estimate(
                dataclasses.replace(run, angle_rad=run.angle_rad - s * np.eye(2)[at]), fit, physics, (1e-3, 1e-3)
            ).values
            for s in (1e-4, -1e-4)
        )
        assert found.by_number[zero] == pytest.approx((up - down) / 2e-4, rel=1e-3, abs=1e-9)


def test_a_source_is_one_error_in_all_tests_and_correlates_what_it_moves() -> None:
    def test_of(name: str, k: float) -> Estimate:
        own, by = np.array([[1.0]]), {"rotor.mass_kg": np.array([k / 7.0])}
        return Estimate(name, (name,), ("k1_N_per_m",), np.array([k]), own, {}, "", by)

    source = KnownSource("rotor.mass_kg", 0.007, "kg", {"rotor.mass_kg": 0.007})
    two = [test_of("a", 7000.0).with_sources([source]), test_of("b", 7000.5).with_sources([source])]
    found = combine(two)[0]
    assert found.shared[source.label] == pytest.approx([7.0], rel=1e-3)
    assert found.std["k1_N_per_m"] == pytest.approx(np.hypot(7.0, np.sqrt(0.5)), rel=1e-3)
    assert found.own_covariance == pytest.approx(np.array([[0.5]]), rel=0.02)
    assert two[0].with_sources(()).shared == {}
