"""The search for what a release's readings say: growing horizons from several starts, and when to stop trying.

A release starts near an unstable equilibrium, so the fit proceeds over growing horizons, each from the one before.
Where the start is at fault another start ends elsewhere. Where the model is at fault (masses, lengths, friction) starts
far apart end at the same place with the same residual: three of them, and the search ends, with what it found kept for
the question what would mend it. A search whose starts all end at different places is bounded by its effort.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.answers import plausible_answers
from identification.pendulums.transient import TransientProblem

GOOD = 1.5  # χ²/dof
_HELD_STD = 0.4  # ln c
_EARLY, _LATE, _MORE = 8, 25, 60  # iterations: of a horizon, of the last one, and where that has nearly settled
_ALIKE_C, _ALIKE_COST, _FAR_APART = 0.05, 1.1, 0.7  # ln c, ratio of costs, ln c between starts
_SAME_END = 3
_HOPELESS = 1e3  # χ²/dof of a start that led nowhere: it says nothing of the model

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Trial:
    """Where one start led.

    Attributes:
        start: it.
        minimum, end_s: the last fit and its horizon.
        misfit: of that, 1 for a right model.
        whole: whether that horizon is the last one.
        doubtful: the first fit whose residuals are not noise, and its horizon; None where there is none.
    """

    start: np.ndarray
    minimum: Minimum
    end_s: float
    misfit: float
    whole: bool
    doubtful: tuple[Minimum, float] | None

    @property
    def good(self) -> bool:
        """Whether it explains all the readings and has settled."""
        return self.whole and self.misfit < GOOD and self.minimum.converged

    def ends_like(self, other: Trial) -> bool:
        """Whether two fits ended at the same place."""
        near = float(np.max(np.abs(self.minimum.theta[:2] - other.minimum.theta[:2])))
        costs = sorted((self.minimum.cost, other.minimum.cost))
        return self.end_s == other.end_s and near < _ALIKE_C and costs[1] < _ALIKE_COST * costs[0]


@dataclass
class Effort:
    """How much may be spent on searches, in seconds of motion integrated; shared by a campaign's releases.

    Attributes:
        left: what remains; a search that finds it used up makes do with its first starts.
    """

    left: float = 3000.0


class NotFollowed(FitFailed):
    """No start led to a fit of the whole; with what was found on the way."""

    def __init__(self, message: str, trials: list[Trial], structural: bool) -> None:
        super().__init__(message)
        self.trials, self.structural = trials, structural

    @property
    def doubtful(self) -> tuple[Minimum, float] | None:
        """The trial that followed longest, where its residuals first were more than noise."""
        found = [t for t in self.trials if t.doubtful is not None]
        if not found:
            return None
        return max(found, key=lambda t: (t.end_s, -t.minimum.cost)).doubtful


@dataclass
class Search:
    """One release's search.

    Attributes:
        problem, horizons: what is fitted, last instants.
        fewest: starts tried in any case; after them the search ends as soon as one has led somewhere.
        effort: shared with other searches.
        tell: told what is tried, now and then.
        early: iterations over each horizon but the last; a motion that sticks and slides needs more.
    """

    problem: TransientProblem
    horizons: list[float]
    fewest: int
    effort: Effort
    tell: Tell
    early: int = _EARLY
    trials: list[Trial] = field(default_factory=list)

    def answers(self, starts: Iterable[tuple[np.ndarray, bool]], source: str) -> list[Minimum]:
        """What the starts lead to that explains the readings, the best first.

        Args:
            starts: (θ, whether the damping is kept near it over the first horizons).
            source: named in the message.
        Raises:
            NotFollowed: the model does not follow the angles from any of them.
        """
        good: list[Minimum] = []
        for number, (start, held) in enumerate(starts, 1):
            if number > max(2, self.fewest) and (self.effort.left <= 0 or self.structural):
                break
            if number > 1:
                self.tell(f"start {number}")
            try:
                trial = self._grown(start, held)
            except FitFailed:  # the motion from there is beyond all numbers
                continue
            self.trials.append(trial)
            if trial.good:
                good.append(trial.minimum)
            if good and number >= self.fewest:
                break
        if good:
            return plausible_answers(good)
        raise NotFollowed(f"{source}: {self._happened()}", self.trials, self.structural)

    @property
    def structural(self) -> bool:
        """Whether starts far apart have ended at the same place: another start will, too."""
        for trial in self.trials:
            alike = [t for t in self.trials if t.misfit < _HOPELESS and t.ends_like(trial)]
            if len(alike) >= _SAME_END:
                starts = np.array([t.start[:2] for t in alike])
                if float(np.max(np.ptp(starts, axis=0))) > _FAR_APART:
                    return True
        return False

    def _grown(self, start: np.ndarray, held: bool) -> Trial:
        """Least squares over growing horizons; it ends at an early one where the model fails.

        Args:
            held: keep the damping near the start's for the first ones. Half a second says little about weak damping,
                and what it says can lead to a side minimum.
        """
        early = holding(self.problem, start) if held else self.problem
        theta, doubtful = start, None
        begin = float(self.problem.readings[0].averages.time_s[0])
        trial: Trial | None = None
        for i, end in enumerate(self.horizons):
            last = i == len(self.horizons) - 1
            now = early if i < len(self.horizons) - 2 else self.problem
            minimum = now.solve(theta, end, _LATE if last else self.early, plateau=3 * GOOD)
            self.effort.left -= minimum.iterations * (end - begin)
            level = min(now.chi2_per_dof(minimum, end), now.misfit(minimum, end))
            if last and not minimum.converged and level < GOOD:
                minimum = now.solve(minimum.theta, end, _MORE)
                level = now.misfit(minimum, end)
            if doubtful is None and level > GOOD:
                doubtful = minimum, end
            trial = Trial(start, minimum, end, level, last, doubtful)
            if not last and not level < 3 * GOOD:
                break
            theta = minimum.theta
        assert trial is not None
        return trial

    def _happened(self) -> str:
        begin = float(self.problem.readings[0].averages.time_s[0])
        whole = [t for t in self.trials if t.whole and np.isfinite(t.misfit)]
        over = f"the model does not follow the released pendulums over {self.horizons[-1] - begin:.2g} s"
        if any(t.misfit < GOOD for t in whole):
            best = min(whole, key=lambda t: t.misfit)
            return (
                f"the fit of the released pendulums over {self.horizons[-1] - begin:.2g} s had not settled after "
                f"{best.minimum.iterations} iterations"
            )
        if whole:
            least = min(t.misfit for t in whole)
            return f"{over} (residuals {least:.3g} times what noise explains, expected below {GOOD:g})"
        furthest = max((t.end_s for t in self.trials), default=self.horizons[0]) - begin
        return f"{over} (from no start value did it get past the first {furthest:.2g} s)"


def holding(problem: TransientProblem, start: np.ndarray) -> TransientProblem:
    """The problem with the damping kept near the start's."""
    prior, std = problem.prior.copy(), problem.prior_std.copy()
    prior[:2], std[:2] = start[:2], _HELD_STD
    return replace(problem, prior=prior, prior_std=std)
