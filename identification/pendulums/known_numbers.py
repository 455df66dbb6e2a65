# pyright: strict
"""How a transient's answer goes with the masses, lengths and angles that its fit takes as known.

At a minimum of rᵀr the normal equations hold, Jᵀr = 0. A known number p that is assumed to be h larger changes r by
(∂r/∂p) h, the knowledge of the suspension included, and moves the minimum by −(JᵀJ)⁻¹Jᵀ (∂r/∂p) h. Source:
docs/theory/uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq.signals.threads import THREADS
from identification.least_squares import Minimum
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientProblem
from rig_configs.known import ZERO_A, ZERO_B, physical_numbers

Array = NDArray[np.float64]

_STEP = 1e-4  # of a number
_STEP_SI = 1e-6  # of one that is 0
_LEAST_OWN = 1e-6  # least eigenvalue of what is left, in units of the variances


def by_physical_numbers(
    problem: TransientProblem,
    minimum: Minimum,
    end_s: float,
    knowledge: Knowledge,
    made: Callable[[Knowledge], TransientProblem],
    wanted: Sequence[int],
) -> dict[str, Array]:
    """Derivatives of some of θ by each physical number.

    Args:
        problem: whose minimum it is.
        minimum: at the last instant `end_s`.
        knowledge: the problem's.
        made: the same problem with other knowledge.
        wanted: places in θ, m of them.
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
    with ThreadPoolExecutor(THREADS) as pool:
        found = {name: by for name, by in zip(once, pool.map(answer, once), strict=True) if by is not None}
    if "rotor.mass_kg" in found and "imbalance.mass_kg" in names:
        found["imbalance.mass_kg"] = found["rotor.mass_kg"]  # S_P is found by itself: both act through the total mass
    return found


def answer_to(minimum: Minimum, change: Array, wanted: Sequence[int]) -> Array:
    """How some of θ answer to a change of the residual, shape (m,)."""
    return -(minimum.covariance[list(wanted)] @ (minimum.jacobian.T @ change))


def knowing(covariance: Array, by_number: Mapping[str, Array], std: Mapping[str, float]) -> Array:
    """A covariance without what some known numbers have brought into it.

    Where friction is bounded from below a fit's covariance may hold less of it than its slopes say; then it stays.

    Args:
        covariance: shape (m, m), with these numbers' part.
        by_number: derivatives by the known numbers, shape (m,) each.
        std: standard uncertainty of each number whose part it holds, as the fit took it.
    """
    own = covariance.copy()
    for name, deviation in std.items():
        shift = deviation * by_number.get(name, np.zeros(len(own)))
        own -= np.outer(shift, shift)
    unit = np.sqrt(np.diag(covariance))
    sound = float(np.linalg.eigvalsh(own / np.outer(unit, unit))[0]) > _LEAST_OWN
    return own if sound else covariance


def zeros_std(zero_std_rad: float) -> dict[str, float]:
    """Standard uncertainty of both encoders' zeros, by number."""
    return {ZERO_A: zero_std_rad, ZERO_B: zero_std_rad}
