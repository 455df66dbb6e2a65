"""Start values of damping for the fit of a release, by the filter over the first two seconds from the locked orbit."""

from __future__ import annotations

import numpy as np

from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import locked_state
from identification.tracking.unscented import STATES, TALLY, filter_readings
from rig_basics.arrays import Array

_SPAN_S, _TICK_S = 2.0, 1e-3
_LN_C_STD = (1.2, 0.7, 0.5)


def damping_start(run: Run, physics: RotorParameters, history: SpeedHistory, release_s: float) -> Array | None:
    """Return ln c3, ln c4 from the encoders alone, shape (2,).

    Args:
        run: recording, whose angles after the release are used.
        physics: parameters; c3 and c4 may be wrong by a factor of ten.
        history: recorded speed.
        release_s: instant of the release, s.
    Returns:
        None if there are fewer than 100 samples or the filter refuses too many of them.
    """
    wanted = (run.angle_time_s > release_s) & (run.angle_time_s < release_s + _SPAN_S)
    time, angle = run.angle_time_s[wanted], run.angle_rad[wanted]
    if len(time) < 100:
        return None
    psi, speed, _ = history.phase(release_s)[0]
    before = (run.angle_time_s < release_s - 0.02) & (run.angle_time_s > release_s - 2.0)
    locked = np.nanmean(run.angle_rad[before], axis=0) if before.any() else angle[0]
    ln_c = np.log([m.damping_Nms_per_rad for m in (physics.a, physics.b)])
    begin = locked_state(physics, speed, psi, *locked)
    orbit = np.max(np.abs(begin[:2])) * 0.3 + 1e-5  # error of the imbalance up to 30 %
    spread = np.r_[orbit, orbit, 0.02, 0.02, orbit * speed, orbit * speed, 0.05, 0.05]
    noise = np.r_[np.zeros(4), np.full(2, (0.1 * orbit * speed) ** 2), 0.1, 0.1, 1e-3, 1e-3]
    n, ticks = 2 * len(time), np.repeat(time, 2)
    phases = history.phase(np.r_[release_s, ticks[:-1]])
    for ln_c_std in _LN_C_STD:  # each pass starts with the damping of the one before
        mean, cov = np.r_[begin, ln_c], np.diag(np.r_[spread, ln_c_std, ln_c_std] ** 2)
        tally, z = np.array([release_s, *np.zeros(TALLY - 1)]), np.empty(n)
        filter_readings(
            mean,
            cov,
            ticks,
            np.zeros(n),
            np.tile([2, 3], len(time)),
            angle.ravel(),
            np.full(n, run.angle_step_rad**2 / 12 + 1e-6),
            phases,
            np.ones((n, 2)),
            physics.packed(),
            noise,
            _TICK_S,
            8.0,
            -1.0,
            tally,
            z,
        )
        if not np.all(np.isfinite(mean)) or tally[1] > 0.3 * n:
            return None
        ln_c = np.clip(mean[STATES - 2 :], -14.0, 0.0)
    return ln_c
