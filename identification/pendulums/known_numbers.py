"""Derivatives of a transient's result by the masses, lengths and angles that its fit takes as known.

At a minimum of rᵀr the normal equations hold, Jᵀr = 0. A known number p that is assumed larger by h changes r,
including the prior rows of the suspension, by (∂r/∂p) h. It moves the minimum by −(JᵀJ)⁻¹Jᵀ (∂r/∂p) h.
Source: docs/theory/uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq.signals.threads import THREADS
from identification.least_squares import Minimum
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientProblem
from rig_basics.arrays import Array
from rig_basics.thread_pool import ThreadPool
from rig_configs.known import ZERO_A, ZERO_B, physical_numbers

_STEP = 1e-4  # relative step of a number
_STEP_SI = 1e-6  # step of a number that is 0, in its unit
_LEAST_OWN = 1e-6  # smallest eigenvalue of the remaining covariance, in units of the variances


def by_physical_numbers(
    problem: TransientProblem,
    minimum: Minimum,
    end_s: float,
    knowledge: Knowledge,
    made: Callable[[Knowledge], TransientProblem],
    wanted: Sequence[int],
) -> dict[str, Array]:
    """Return derivatives of components of θ by each physical number.

    Args:
        problem: least-squares problem.
        minimum: minimum of the problem for data up to `end_s`.
        end_s: last instant of the data, s.
        knowledge: prior knowledge of the problem.
        made: creates the same problem with other prior knowledge.
        wanted: m indices in θ.
    Returns:
        Number → derivative, shape (m,), per unit of the number.
    """
    base, values = made(knowledge), physical_numbers(knowledge.physics)

    def answer(name: str) -> Array | None:
        step = _STEP * values.get(name, 0.0) or _STEP_SI
        other = made(knowledge.moved(name, step))
        moved = replace(other, prior=problem.prior + other.prior - base.prior, prior_std=problem.prior_std)
        change = moved.residual(minimum.theta, end_s) - minimum.residual
        return answer_to(minimum, change / step, wanted) if np.all(np.isfinite(change)) else None

    names = list(knowledge.numbers)
    once = [n for n in names if not (n == "imbalance.mass_kg" and "rotor.mass_kg" in names)]
    with ThreadPool(THREADS) as pool:
        found = {name: by for name, by in zip(once, pool.map(answer, once), strict=True) if by is not None}
    if "rotor.mass_kg" in found and "imbalance.mass_kg" in names:
        found["imbalance.mass_kg"] = found["rotor.mass_kg"]  # S_P is estimated: both masses act through the total mass
    return found


def answer_to(minimum: Minimum, change: Array, wanted: Sequence[int]) -> Array:
    """Return the change of components of θ for a change of the residual, shape (m,)."""
    return -(minimum.covariance[list(wanted)] @ (minimum.jacobian.T @ change))


def knowing(covariance: Array, by_number: Mapping[str, Array], std: Mapping[str, float]) -> Array:
    """Return a covariance without the part of some known numbers.

    If friction is bounded from below, the covariance of a fit may contain less of that part than its derivatives give.
    The covariance is then returned unchanged.

    Args:
        covariance: shape (m, m), with the part of the numbers.
        by_number: number → derivative, shape (m,).
        std: number → standard uncertainty in the fit, for the numbers whose part is removed.
    """
    own = covariance.copy()
    for name, deviation in std.items():
        shift = deviation * by_number.get(name, np.zeros(len(own)))
        own -= np.outer(shift, shift)
    unit = np.sqrt(np.diag(covariance))
    sound = float(np.linalg.eigvalsh(own / np.outer(unit, unit))[0]) > _LEAST_OWN
    return own if sound else covariance


def zeros_std(zero_std_rad: float) -> dict[str, float]:
    """Return the standard uncertainty of both encoders' zeros by number, rad."""
    return {ZERO_A: zero_std_rad, ZERO_B: zero_std_rad}
