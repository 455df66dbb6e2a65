"""Plain arrays are enough for every fit of a run."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import Campaign

from daq import Run
from identification import Knowledge, fit_release, fit_run_up_run, fit_spin_down_run

ZERO_STD_RAD = float(np.radians(0.05))


def known(campaign: Campaign) -> Knowledge:
    true = campaign.truth.identified()
    found = {n: true[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    return Knowledge.nominal(campaign.rig.physics).with_found(found, {n: 1e-3 * v for n, v in found.items()})


def of_arrays(run: Run, *released_s: float) -> Run:
    return Run.of_arrays(
        run.test,
        x=(run.x_time_s, run.x_m),
        y=(run.y_time_s.tolist(), run.y_m.tolist()),
        angles=(run.angle_time_s, run.angle_rad),
        marks=(run.mark_time_s, run.mark_phase_rad),
        released_s=released_s,
    )


def test_fits_of_arrays_are_those_of_the_log() -> None:
    campaign = Campaign(3, clock_rate_std=0.0)
    release, spin_down, run_up = campaign.point("D"), campaign.spin_down(), campaign.run_up()
    a, b = release.releases
    found = fit_release(of_arrays(release, a.time_s, b.time_s), known(campaign), ZERO_STD_RAD)
    assert found.values == fit_release(release, known(campaign), ZERO_STD_RAD).values
    assert fit_spin_down_run(of_arrays(spin_down), known(campaign)).values["c3_Nms_per_rad"] == pytest.approx(
        campaign.truth.a.damping_Nms_per_rad, rel=0.01
    )
    assert fit_run_up_run(of_arrays(run_up)).values == fit_run_up_run(run_up).values


def test_arrays_that_do_not_fit_are_refused() -> None:
    t = np.arange(3.0)
    with pytest.raises(ValueError, match=r"angles: expected values of shape \(3, 2\) for the times, got \(3,\)"):
        Run.of_arrays("spin-down", angles=(t, t))
    with pytest.raises(ValueError, match="x: expected values"):
        Run.of_arrays("ring-down-x", x=(t, t[:2]))
    with pytest.raises(ValueError, match="time"):
        Run.of_arrays("ring-down-x", x=(t[::-1], t))
    with pytest.raises(ValueError, match="date"):
        Run.of_arrays("ring-down-x", x=(np.array(["2026-01-01", "2026-01-02"], "M8[s]"), t[:2]))
