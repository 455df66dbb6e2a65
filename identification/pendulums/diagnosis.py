"""Diagnosis of a release that the model does not follow: numbers of the rig file that would explain the misfit.

Each candidate is one additional unknown: a pendulum's mass or length, or an encoder's counts per revolution. One linear
step (score test) at the first horizon with residuals above noise gives the reduction of χ². A mass or a length also
changes the results of other tests: frequencies and the imbalance of the locked rig were measured, so k is proportional
to the total mass, and S_P compensates the change of the pendulums' moments. Candidates that explain as much as the best
one are reported together with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynamics.equations.parameters import Pendulum, RotorParameters
from identification.least_squares import Minimum
from identification.pendulums.friction import evidence
from identification.pendulums.release_problem import SUSPENSION, RecordedRelease

_RELATIVE_STEP = 1e-4  # step of a mass or length
_MIN_EXPLAINED_SHARE = 0.7  # smallest share of the excess of χ² that a cause explains
_COMPARABLE_SHARE = 0.9  # share of the best candidate's reduction of χ² above which another is reported with it
_MAX_ERROR = 0.05  # largest relative error of a balance, a rule or an encoder's counts
_LOCK_RAD = 0.02  # largest error of a locked pendulum's angle, which limits the error of its scale


@dataclass(frozen=True)
class SuspectNumber:
    """One number of the rig file that may be wrong.

    Attributes:
        mended: reduction of χ² by the corrected number.
        text: name of the number and its correction.
    """

    mended: float
    text: str


def likely_causes(release: RecordedRelease, minimum: Minimum, end_s: float) -> list[str]:
    """Return the numbers that would explain most of a fit's misfit, as text, the best first; empty without any.

    Args:
        release: release that the model does not follow.
        minimum, end_s: first fit with residuals above noise, and its horizon.
    """
    n = sum(len(c.time_s) for c in release.problem().cut(end_s))
    excess = minimum.cost - minimum.left - n  # the search ended before the minimum
    causes = candidates(release, minimum, end_s)
    if not causes or causes[0].mended < _MIN_EXPLAINED_SHARE * excess:
        return []
    return [c.text for c in causes if c.mended > _COMPARABLE_SHARE * causes[0].mended]


def candidates(release: RecordedRelease, minimum: Minimum, end_s: float) -> list[SuspectNumber]:
    """Return all candidate numbers with their reductions of χ², the largest first."""
    problem = release.problem()
    cut = problem.cut(end_s)
    sizes = (len(cut[0].time_s), len(cut[1].time_s))
    n = sum(sizes)
    weight = np.concatenate([c.weight for c in cut])
    base = problem.angles(minimum.theta, end_s)
    causes: list[SuspectNumber] = []

    def judge(column: np.ndarray, text: str, value: float | None, unit: str, most: float = 1.0) -> None:
        if not np.all(np.isfinite(column)) or not np.any(column):
            return
        found = evidence(minimum, (column * weight)[:, None], None, sizes)
        if abs(found.step[0]) < min(_MAX_ERROR, most):
            change = f"{100 * found.step[0]:+.2g} %"
            where = f" ({value * (1 + found.step[0]):.4g} {unit})" if value is not None else ""
            causes.append(SuspectNumber(found.mended, f"{text} {change}{where}"))

    for name, at in (("A", 0), ("B", 1)):
        own = release.knowledge.physics.a if at == 0 else release.knowledge.physics.b
        for what, unit, field in (("mass", "kg", "mass_kg"), ("length", "m", "length_m")):
            value = float(getattr(own, field))
            moved = _moved(release, minimum.theta, at, field)
            if moved is not None:
                angle = moved[0].problem().angles(moved[1], end_s)
                judge((angle - base) / _RELATIVE_STEP, f"pendulum {name}'s {what}", value, unit)
        scale, most = np.zeros(n), _LOCK_RAD / max(abs(float(release.locked_rad[at])), _LOCK_RAD)
        rows = slice(0, sizes[0]) if at == 0 else slice(sizes[0], n)
        scale[rows] = base[rows] - release.locked_rad[at]
        judge(scale, f"the scale of encoder {name} (counts_per_revolution)", None, "", most)
    return sorted(causes, key=lambda c: -c.mended)


def _moved(
    release: RecordedRelease, theta: np.ndarray, at: int, field: str
) -> tuple[RecordedRelease, np.ndarray] | None:
    """Return the release and θ with one pendulum's number changed and the measurements of other tests unchanged."""
    physics = release.knowledge.physics
    own: Pendulum = physics.a if at == 0 else physics.b
    other = replace(own, **{field: getattr(own, field) * (1 + _RELATIVE_STEP)})
    now: RotorParameters = replace(physics, a=other) if at == 0 else replace(physics, b=other)
    grown = now.total_mass_kg / physics.total_mass_kg
    suspension = theta[SUSPENSION].copy()
    suspension[:2] += np.log(grown)

    def moment(p: RotorParameters) -> float:
        return p.a.first_moment_kg_m - p.b.first_moment_kg_m  # locked at 0° and 180°

    imbalance = float(np.exp(suspension[4]))
    left = (imbalance + moment(physics)) * grown - moment(now)
    if left <= 0:
        return None
    suspension[4] = np.log(left)
    changed = theta.copy()
    changed[SUSPENSION] = suspension
    return release.laid_over(replace(release.knowledge, physics=now)), changed
