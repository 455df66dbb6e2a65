"""Search for the minima of a release fit: growing horizons from several starts, and the criteria to stop.

A release starts near an unstable equilibrium, so the fit proceeds over growing horizons, each from the minimum of the
one before. If a start value is wrong, another start ends elsewhere. If the model is wrong (masses, lengths, friction),
distant starts end at the same place with the same residual. After three of these the search ends, and its trials are
kept for the diagnosis. A search whose starts all end at different places is limited by its effort.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.answers import plausible_answers
from identification.pendulums.transient import TransientProblem
from identification.work import tried
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

GOOD = 1.5
"""Largest misfit (χ²/dof over that of noise) of an accepted fit."""
_HELD_STD = 0.4  # prior standard deviation of a held ln c
_EARLY, _LATE = 15, 60  # iterations: of a horizon, and of the last one
_SAME_LOG_C, _SAME_COST_RATIO = 0.05, 1.1  # largest differences between fits that end at the same place
_DISTANT_LOG_C = 0.7  # smallest difference between distant starts
_SAME_ENDS = 3  # number of equal ends after which the model counts as wrong
_MAX_MISFIT = 1e3  # larger misfits come from a wrong start and contain no information about the model

Notify = Callable[[str], None]
"""Called with one line of text."""


@dataclass(frozen=True)
class SearchTrial:
    """Result of one start.

    Attributes:
        start: start value of θ.
        minimum, end_s: last fit and its horizon.
        misfit: misfit of that fit, 1 for a correct model.
        whole: whether that horizon is the last one.
        doubtful: first fit with residuals above noise, and its horizon; None if all residuals are noise.
    """

    start: np.ndarray
    minimum: Minimum
    end_s: float
    misfit: float
    whole: bool
    doubtful: tuple[Minimum, float] | None

    @property
    def good(self) -> bool:
        """Whether the fit explains all readings and has converged."""
        return self.whole and self.misfit < GOOD and self.minimum.converged

    def ends_like(self, other: SearchTrial) -> bool:
        """Return whether two fits ended at the same place."""
        near = float(np.max(np.abs(self.minimum.theta[:2] - other.minimum.theta[:2])))
        costs = sorted((self.minimum.cost, other.minimum.cost))
        return self.end_s == other.end_s and near < _SAME_LOG_C and costs[1] < _SAME_COST_RATIO * costs[0]


@dataclass
class Effort:
    """Budget of the searches of a campaign's releases, in seconds of integrated motion.

    Attributes:
        left: remaining budget, s. If it is used up, a search tries only its first starts.
    """

    left: float = 3000.0


class NotFollowed(FitFailed):
    """No start led to a fit of the whole release.

    Attributes:
        trials: results of the starts.
        structural: whether distant starts ended at the same place, so that the model counts as wrong.
    """

    def __init__(self, message: str, trials: list[SearchTrial], structural: bool) -> None:
        super().__init__(message)
        self.trials: list[SearchTrial] = trials
        self.structural: bool = structural

    @property
    def doubtful(self) -> tuple[Minimum, float] | None:
        """First fit with residuals above noise and its horizon, of the trial with the longest horizon."""
        found = [t for t in self.trials if t.doubtful is not None]
        if not found:
            return None
        return max(found, key=lambda t: (t.end_s, -t.minimum.cost)).doubtful


@dataclass
class Search:
    """Search for the minima of one release.

    Attributes:
        problem: least-squares problem of the release.
        horizons: last instants of the growing stretches, s.
        fewest: smallest number of starts. After these the search ends with the first good trial.
        effort: budget shared with other searches.
        notify: called with one line of text before each start after the first.
        early: iterations over each horizon except the last. A motion with sticking needs more of them.
        trials: results of the starts.
    """

    problem: TransientProblem
    horizons: list[float]
    fewest: int
    effort: Effort
    notify: Notify
    early: int = _EARLY
    trials: list[SearchTrial] = field(default_factory=list[SearchTrial])

    def answers(self, starts: Iterable[tuple[np.ndarray, bool]], source: str) -> list[Minimum]:
        """Return the minima that explain the readings, the best first.

        Args:
            starts: (θ, whether the damping is held near that of θ over the first horizons).
            source: name of the log for the message.
        Raises:
            NotFollowed: the model does not follow the angles from any start.
        """
        good: list[Minimum] = []
        for number, (start, held) in enumerate(starts, 1):
            if number > max(2, self.fewest) and (self.effort.left <= 0 or self.structural):
                break
            c3, c4 = np.exp(start[:2]).tolist()
            tried(f"start {number} at c3 {c3:.2g}, c4 {c4:.2g}")
            if number > 1:
                self.notify(f"start {number}")
            try:
                trial = self._grown(start, held)
            except FitFailed as error:  # the motion from this start is not finite
                _log.debug("start %d is left out: %s", number, error)
                continue
            self.trials.append(trial)
            if trial.good:
                good.append(trial.minimum)
            if good and number >= self.fewest:
                break
        if good:
            return plausible_answers(good)
        raise NotFollowed(f"{source}: {self._failure_text()}", self.trials, self.structural)

    @property
    def structural(self) -> bool:
        """Whether distant starts have ended at the same place, so that other starts will as well."""
        for trial in self.trials:
            alike = [t for t in self.trials if t.misfit < _MAX_MISFIT and t.ends_like(trial)]
            if len(alike) >= _SAME_ENDS:
                starts = np.array([t.start[:2] for t in alike])
                if float(np.max(np.ptp(starts, axis=0))) > _DISTANT_LOG_C:
                    return True
        return False

    def _grown(self, start: np.ndarray, held: bool) -> SearchTrial:
        """Fit over growing horizons; stop at an early one if the model fails.

        Args:
            start: start value of θ.
            held: whether to hold the damping near that of the start for the first horizons. Half a second contains
                little information on weak damping, which can lead to a side minimum.
        """
        early = holding(self.problem, start) if held else self.problem
        theta, doubtful = start, None
        begin = float(self.problem.readings[0].averages.time_s[0])
        trial: SearchTrial | None = None
        for i, end in enumerate(self.horizons):
            last = i == len(self.horizons) - 1
            now = early if i < len(self.horizons) - 2 else self.problem
            minimum = now.solve(theta, end, _LATE if last else self.early, plateau=3 * GOOD)
            self.effort.left -= minimum.iterations * (end - begin)
            level = min(now.chi2_per_dof(minimum, end), now.misfit(minimum, end))
            if doubtful is None and level > GOOD:
                doubtful = minimum, end
            trial = SearchTrial(start, minimum, end, level, last, doubtful)
            if not last and not level < 3 * GOOD:
                break
            theta = minimum.theta
        assert trial is not None
        return trial

    def _failure_text(self) -> str:
        begin = float(self.problem.readings[0].averages.time_s[0])
        whole = [t for t in self.trials if t.whole and np.isfinite(t.misfit)]
        over = f"the model does not follow the released pendulums over {self.horizons[-1] - begin:.2g} s"
        if any(t.misfit < GOOD for t in whole):
            best = min(whole, key=lambda t: t.misfit)
            return (
                f"the fit of the released pendulums over {self.horizons[-1] - begin:.2g} s had not settled after "
                f"{number_of(best.minimum.iterations, 'iteration')}"
            )
        if whole:
            least = min(t.misfit for t in whole)
            return f"{over} (residuals {least:.3g} times those explained by noise, expected below {GOOD:g})"
        furthest = max((t.end_s for t in self.trials), default=self.horizons[0]) - begin
        return f"{over} (no start value led beyond the first {furthest:.2g} s)"


def holding(problem: TransientProblem, start: np.ndarray) -> TransientProblem:
    """Return the problem with the damping held near that of a start."""
    prior, std = problem.prior.copy(), problem.prior_std.copy()
    prior[:2], std[:2] = start[:2], _HELD_STD
    return replace(problem, prior=prior, prior_std=std)
