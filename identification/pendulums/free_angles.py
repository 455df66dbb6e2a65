"""Encoder readings of two free pendulums and their derivatives, for least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.equations.kernels import FA, FB, rates
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import fastest_rate
from dynamics.motions.sensitivities import packed_derivatives
from identification.pendulums.frictional_motion import frictional_motion, frictional_rates
from identification.pendulums.suspension_knowledge import NAMES, Knowledge
from identification.pendulums.variational import PARAMETER_COLUMNS, free_motion
from identification.samples import Averages
from identification.work import spend

_OUTPUT_S = 0.004
_ELEMENTS_PER_STEP = 15  # work of a step with its derivatives (identification.work): 1.5 µs
_DRY_COST = 4  # the same with dry friction, over that without
_STEP_SHARE = 0.08  # step over the inverse of the fastest rate; errors: a few 1e-6 rad, 2e-4 of a derivative


@dataclass(frozen=True)
class FreeMotion:
    """Free motion at equidistant instants.

    Attributes:
        time_s: shape (n,).
        states: shape (n, 8).
        derivatives: derivatives by the start state (8) and by ln c3, ln c4, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P (7),
            shape (n, 8, 15). With dry friction also by its torques M_A, M_B and contact parts F_A, F_B, shape
            (n, 8, 19). Shape (n, 8, 0) if derivatives were not requested.
        start_rates: ẏ at the start, shape (8,).
    """

    time_s: np.ndarray
    states: np.ndarray
    derivatives: np.ndarray
    start_rates: np.ndarray

    def angle(self, pendulum: int, blocks: Averages) -> tuple[np.ndarray, np.ndarray]:
        """Return block means of one pendulum's angle (n,) and their derivatives (n, 15 or 19).

        The means are cubic Hermite interpolations plus half the samples' variance of time times the second derivative.
        """
        step = self.time_s[1] - self.time_s[0]
        i = np.clip(((blocks.time_s - self.time_s[0]) / step).astype(np.int64), 0, len(self.time_s) - 2)
        r = (blocks.time_s - self.time_s[i]) / step
        v = 0.5 * blocks.spread_s2 / step**2
        weights = (
            (1 + 2 * r) * (1 - r) ** 2 + v * (12 * r - 6),
            step * (r * (1 - r) ** 2 + v * (6 * r - 4)),
            r * r * (3 - 2 * r) - v * (12 * r - 6),
            step * (r * r * (r - 1) + v * (6 * r - 2)),
        )
        parts = ((i, 2 + pendulum), (i, 6 + pendulum), (i + 1, 2 + pendulum), (i + 1, 6 + pendulum))
        angle = sum(w * self.states[at, row] for w, (at, row) in zip(weights, parts, strict=True))
        slope = sum(w[:, None] * self.derivatives[at, row] for w, (at, row) in zip(weights, parts, strict=True))
        return np.asarray(angle), np.asarray(slope)


def laid_over(knowledge: Knowledge, damping: np.ndarray, suspension: np.ndarray) -> RotorParameters:
    """Return the parameters with given ln c3, ln c4 and logarithms of k1, k2, ζ1, ζ2 and, if given, S_P."""
    values = dict(zip(NAMES, np.exp(suspension).tolist(), strict=False))
    c3, c4 = np.exp(damping).tolist()
    return knowledge.physics.with_values(c3_Nms_per_rad=c3, c4_Nms_per_rad=c4, **values)


def log_suspension(physics: RotorParameters) -> np.ndarray:
    """Return the logarithms of k1, k2, ζ1, ζ2, S_P, shape (5,)."""
    p = physics
    return np.log([p.k1_N_per_m, p.k2_N_per_m, p.zeta1, p.zeta2, p.imbalance_moment_kg_m])


def swing(
    physics: RotorParameters,
    history: SpeedHistory,
    start: np.ndarray,
    start_s: float,
    first_s: float,
    last_s: float,
    dry: np.ndarray | None = None,
    slopes: bool = True,
) -> FreeMotion | None:
    """Integrate the motion of two free pendulums.

    Args:
        physics: parameters.
        history: rotor phase.
        start: state at `start_s`, shape (8,).
        start_s: start of the integration, s.
        first_s: first instant of the output, not before `start_s`, s.
        last_s: the output ends after this instant, s.
        dry: friction torques M_A, M_B (N m) and contact parts F_A, F_B (torque per φ̇², kg m²). None selects the
            friction of the parameters; without any there are no derivatives by friction.
        slopes: whether derivatives are computed.
    Returns:
        The motion, or None if it cannot be integrated, as for a distant trial of a minimiser.
    """
    if not start_s <= first_s or not np.all(np.isfinite(start)):
        return None
    speed = float(np.max(np.abs(history.phase(np.linspace(start_s, last_s, 16))[:, 1])))
    step = _STEP_SHARE / fastest_rate(physics, speed + float(np.max(np.abs(start[6:]))) * 0.5)
    step = max(step, (last_s - start_s) / 400_000)
    count = int(np.ceil((last_s - first_s) / _OUTPUT_S)) + 2
    times = np.asarray(first_s + _OUTPUT_S * np.arange(count), np.float64)
    packed = physics.packed()
    if dry is None and np.any(packed[[FA, FB]]):
        dry = np.r_[0.0, 0.0, packed[[FA, FB]]]
    phase = history.phase(start_s)[0]
    spend(_ELEMENTS_PER_STEP * (last_s - start_s) / step * (1 if dry is None else _DRY_COST))
    if dry is None:
        rate, (psi, omega, alpha) = np.empty(8), phase
        rates(start, psi, omega, alpha, packed, 1.0, 1.0, rate)
        states, raw = free_motion(start, start_s, times, step, history.knots_s, history.coefficients, packed, slopes)
    else:
        packed[[FA, FB]] = dry[2:]
        rate = frictional_rates(start, phase, packed, dry[:2])
        states, raw = frictional_motion(
            start, start_s, times, step, history.knots_s, history.coefficients, packed, dry[:2], slopes
        )
    if not np.all(np.isfinite(states)):
        return None
    if not slopes:
        return FreeMotion(times, states, np.zeros((len(times), 8, 0)), rate)
    derivatives = raw.copy()
    derivatives[:, :, 8:15] = raw[:, :, 8:15] @ _chain(physics)
    return FreeMotion(times, states, derivatives, rate)


def _chain(physics: RotorParameters) -> np.ndarray:
    """Return ∂(packed parameters)/∂(ln c3, ln c4, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P), shape (7, 7)."""
    by, values = packed_derivatives(physics), physics.identified()
    names = ("c3_Nms_per_rad", "c4_Nms_per_rad", *NAMES)
    columns = list(PARAMETER_COLUMNS)
    return np.column_stack([by[n][columns] * values[n] for n in names])


def both_angles(
    motion: FreeMotion,
    blocks: tuple[Averages, Averages],
    start_by: np.ndarray,
    log_by: np.ndarray,
    dry_by: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return block means (n,) of both encoders and their derivatives (n, p) by the p parameters of a fit.

    The derivatives are 0 for a motion without derivatives.

    Args:
        motion: free motion.
        blocks: blocks of both encoders.
        start_by: derivative of the start state by the parameters, shape (8, p).
        log_by: derivative of (ln c3, ln c4, ln k1 …) by the parameters, shape (7, p).
        dry_by: derivative of (M_A, M_B, F_A, F_B) by the parameters, shape (4, p), for a motion with dry friction; None
            for 0.
    """
    columns = motion.derivatives.shape[2]
    chain = np.zeros((columns, start_by.shape[1]))
    if columns:
        chain[:8], chain[8:15] = start_by, log_by
    if columns and dry_by is not None:
        chain[15:] = dry_by
    pairs = [motion.angle(i, channel) for i, channel in enumerate(blocks)]
    return np.concatenate([a for a, _ in pairs]), np.concatenate([d @ chain for _, d in pairs])
