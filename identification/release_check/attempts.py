"""Fit of one release with all parameters free, and the sequence of attempts before it counts as not followed.

The fit starts at the identified parameters. The rig may also have other masses and lengths of the pendulums, or dry
friction. If one release requires friction that no test has found, all releases of the rig are fitted with it: a fit of
the others without friction ends at parameters that are many standard deviations off.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.free_angles import laid_over
from identification.pendulums.friction import Friction
from identification.pendulums.opening_search import is_strained, opening_start
from identification.pendulums.release_problem import SUSPENSION, TORQUES, RecordedRelease, Shape
from identification.pendulums.release_search import Effort, Search, holding
from identification.pendulums.suspension_knowledge import NAMES, NOMINAL_SHARE
from identification.pendulums.transient import TransientProblem
from identification.pendulums.unknown_phase import angles_to_try, screened_starts
from identification.release_check.model import FittedRelease, fitted_with_numbers, opened
from rig_basics.arrays import Array
from rig_basics.ignoring import ignoring
from rig_configs.parameters_file import IdentifiedParameters

_log = logging.getLogger(__name__)

WIDE, _LEAST_SHARE = 10.0, 0.01  # widened prior of a parameter: factor on its standard deviation, and smallest share
DAMPING = ("c3_Nms_per_rad", "c4_Nms_per_rad")
FLICK_RAD_S = 12.0
_LONGEST_S = 8.0
_EXACT = 1e-7  # standard deviation of the logarithm of a parameter that was set
_NOMINAL: Mapping[str, float] = {**dict(zip(NAMES, NOMINAL_SHARE, strict=True)), **dict.fromkeys(DAMPING, 2.5)}
_FRICTION_SHARES = (0.003, 0.01, 0.03)  # start values of friction as shares of a flick's largest viscous torque
_MAX_NEGATIVE_STD = 2.0  # standard deviations below 0 up to which a friction torque is accepted


@dataclass(frozen=True)
class Attempts:
    """Start of the fits of releases.

    Attributes:
        identified: parameters with covariance.
        exact: names of parameters that were set.
    """

    identified: IdentifiedParameters
    exact: frozenset[str]

    def fitted(self, release: RecordedRelease) -> FittedRelease:
        """Fit a release with all parameters free.

        The attempts in order: narrow prior, wide prior, then other masses and lengths of the pendulums, locks that open
        later or earlier than the rig file allows, or dry friction, whichever leaves the smaller residual per reading.

        Raises:
            FitFailed: the model does not follow the angles.
        """
        last: FitFailed | None = None
        for wide in (WIDE, math.inf):
            try:
                return self._unstrained(self._opened(release, self.std(wide), False), self.std(wide))
            except FitFailed as error:
                last = last or error
        others = self._alternatives(release)
        if not others:
            assert last is not None
            raise last
        return min(others, key=lambda fitted: fitted.minimum.per_reading)

    def _alternatives(self, release: RecordedRelease) -> list[FittedRelease]:
        """Fit a release that the identified model does not follow with each alternative."""
        found = list[FittedRelease]()
        with ignoring(_log, "fitting with other pendulums", FitFailed):
            found.append(self._opened(release, self.std(WIDE), True))
        if release.run.phase_absolute:
            with ignoring(_log, "fitting with late locks", FitFailed):
                found.append(self._from_other_instants(release.with_late_locks("balanced"), self.std(WIDE)))
        if not self.known_friction:
            torques = (share * self.flick_Nm for share in _FRICTION_SHARES)
            found += [first] if (first := next(self.with_friction(release, torques), None)) else []
        return found

    def _unstrained(self, fitted: FittedRelease, std: Mapping[str, float]) -> FittedRelease:
        """Return a fit, or the one from other instants of the locks if its start is doubtful and that one is better."""
        if not fitted.release.run.phase_absolute or not is_strained(fitted.problem, fitted.minimum):
            return fitted
        with ignoring(_log, "fitting from other instants", FitFailed):
            return min(fitted, self._from_other_instants(fitted.release, std), key=lambda each: each.minimum.cost)
        return fitted

    def _from_other_instants(self, release: RecordedRelease, std: Mapping[str, float]) -> FittedRelease:
        """Fit a release from the instants of its locks that explain the first readings best."""
        shape, torque = self._friction(release)
        problem, horizons = opened(release.problem(shape), std), _horizons(release)
        start = problem.prior.copy()
        if shape is not None:
            start[list(TORQUES)] = torque
        place = opening_start(release, problem, start, horizons[0])
        search = Search(problem, horizons, 1, Effort(), lambda _: None)
        minimum = search.answers([(place, True), (place, False)], release.run.source)[0]
        return FittedRelease(release, problem, shape, minimum, horizons)

    def with_friction(self, release: RecordedRelease, torques_Nm: Iterable[Array]) -> Iterator[FittedRelease]:
        """Yield fits of a release with free dry friction; fits with negative friction are left out.

        Args:
            release: release to fit.
            torques_Nm: start values of the friction torques of A and B, shape (2,) each.
        """
        for torque in torques_Nm:
            with ignoring(_log, "fitting with dry friction", FitFailed):
                fitted = self._opened(release, self.std(WIDE), False, torque)
                at, minimum = list(TORQUES), fitted.minimum
                if np.all(minimum.theta[at] > -_MAX_NEGATIVE_STD * np.sqrt(np.diag(minimum.covariance)[at])):
                    yield fitted

    def _opened(
        self, release: RecordedRelease, std: Mapping[str, float], numbers: bool, torque_Nm: Array | None = None
    ) -> FittedRelease:
        """Make one attempt.

        Args:
            release: release to fit.
            std: prior standard deviation of the logarithm of each parameter.
            numbers: whether masses and lengths of the pendulums are free.
            torque_Nm: start values of the friction torques of A and B, N m; None for the identified friction.
        """
        shape, torque = self._friction(release) if torque_Nm is None else ("torque", torque_Nm)
        problem = opened(release.problem(shape), std)
        start = problem.prior.copy()
        if shape is not None:
            start[list(TORQUES)] = torque
        horizons = _horizons(release)
        starts = [start]
        if not release.run.phase_absolute:
            turns = angles_to_try(laid_over(release.knowledge, start[:2], start[SUSPENSION]))
            trials = [np.r_[start[:-1], turn] for turn in turns]
            starts = screened_starts(problem, trials, horizons[:-1], holding)

        def solve(problem: TransientProblem, *from_places: Array) -> Minimum:
            search = Search(problem, horizons, len(from_places), Effort(), lambda _: None)
            return search.answers([(place, False) for place in from_places], release.run.source)[0]

        if numbers:
            return fitted_with_numbers(release, problem, shape, horizons, solve, starts[0])
        return FittedRelease(release, problem, shape, solve(problem, *starts), horizons)

    def std(self, wide: float) -> dict[str, float]:
        """Return the prior standard deviation of each parameter's logarithm, at most that of a rig file's value.

        Args:
            wide: factor on the identified standard deviation; inf for that of a rig file's value.
        """
        std, found = self.identified.std, dict[str, float]()
        for name, nominal in _NOMINAL.items():
            if name in self.exact:
                found[name] = _EXACT
            elif name in self.identified.values:
                relative = std[name] / abs(self.identified.values[name])
                found[name] = min(nominal, max(wide * relative, _LEAST_SHARE) if math.isfinite(wide) else nominal)
            else:
                found[name] = nominal
        return found

    @property
    def known_friction(self) -> Mapping[str, float]:
        """Identified dry friction by name; empty if none was found."""
        kept: list[Any] = self.identified.provenance.get("tests", [])
        found: list[Mapping[str, float]] = [test["friction"] for test in kept if test.get("friction")]
        if whole := self.identified.provenance.get("friction"):
            found.append(whole["values"])
        return found[-1] if found and max(found[-1].values()) > 0 else {}

    @property
    def flick_Nm(self) -> Array:
        """Largest viscous torques of a flick on A and B, N m, shape (2,)."""
        return FLICK_RAD_S * np.array([self.identified.values.get(name, 0.0) for name in DAMPING])

    def _friction(self, release: RecordedRelease) -> tuple[Shape | None, Array]:
        """Return the shape of the free dry friction, None if none was identified, and its start value, N m."""
        values = self.known_friction
        if not values:
            return None, np.zeros(2)
        torque = (values.get("coulomb_a_Nm", 0.0), values.get("coulomb_b_Nm", 0.0))
        contact = (values.get("contact_a_kg_m2", 0.0), values.get("contact_b_kg_m2", 0.0))
        none = (0.0, 0.0)
        return "torque", Friction(torque, none, contact, none).torque_at(release.speed_rad_s)


def with_common_friction(attempts: Attempts, fits: Sequence[FittedRelease], pool: Executor) -> list[FittedRelease]:
    """Return all releases with dry friction if one of them requires friction that was not identified.

    The others start from the torque of those that require it: independent of the speed, and proportional to its square.
    If neither start leads to a fit, the release keeps its fit without friction. If no release requires friction, or
    friction was identified, the fits are returned unchanged.
    """
    need = [fit for fit in fits if fit.shape is not None]
    if attempts.known_friction or not need:
        return list(fits)
    torque = np.array([np.maximum(fit.minimum.theta[list(TORQUES)], 0.0) for fit in need])
    speed2 = np.array([[fit.release.speed_rad_s**2] for fit in need])
    same, by_square = np.mean(torque, axis=0), np.mean(torque / speed2, axis=0)

    def alike(fit: FittedRelease) -> FittedRelease:
        if fit.shape is not None:
            return fit
        starts = (by_square * fit.release.speed_rad_s**2, same)
        found = attempts.with_friction(fit.release, starts)
        return min(found, key=lambda each: each.minimum.cost, default=fit)

    return list(pool.map(alike, fits))


def _horizons(release: RecordedRelease) -> list[float]:
    """Return the ends of the growing stretches over the first seconds: every other horizon of the release, s."""
    end = release.begin_s + _LONGEST_S
    every = release.horizons("balanced")
    last = min(every[-1], end)
    return [h for h in every[:-1:2] if h < 0.7 * last + 0.3 * release.begin_s] + [last]
