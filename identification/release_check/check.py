"""Comparison of the transient after each release with the identified model, as rows for a validation.

Steady states hardly depend on the pendulums' damping, but the first seconds after a release do. The release is fitted
with all parameters free, starting at the identified ones, so that the rows are valid even if these are many standard
deviations off.

A drag that a spin-down leaves undecided acts on the model of all releases. If one of them needs dry friction in
addition, or is not followed, all are fitted with contact friction in its place. The model that fewer releases refuse,
then that with the smaller χ², is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from daq.guided_test_kinds import point_of
from daq.signals.run import Run
from daq.signals.threads import on_one_thread
from identification.clocks import clock_errors
from identification.errors import FitFailed, NotIdentifiable
from identification.pendulums.opening_locks import Opening
from identification.pendulums.release_problem import RecordedRelease
from identification.pendulums.release_search import NotFollowed
from identification.pendulums.suspension_knowledge import Knowledge
from identification.release_check.attempts import DAMPING, FLICK_RAD_S, WIDE, Attempts, with_common_friction
from identification.release_check.model import Condensed, FittedRelease, condensed
from identification.release_check.together import agreed, fitted_at
from identification.sources import parts
from identification.work import bounded_work
from rig_basics.arrays import Array
from rig_basics.thread_pool import ThreadPool
from rig_configs.drag import LABELS, Drag, Reading, read_as
from rig_configs.error_label import ErrorLabel
from rig_configs.known import BOW, CONTACT_FRICTION, DRAG, FRICTION, INDEX, PHYSICAL, ZERO_A, ZERO_B
from rig_configs.parameters_file import IdentifiedParameters
from rig_configs.schema import Rig
from rig_configs.suspension_terms import TERMS

_ZERO_WIDE = 3.0  # factor on the standard uncertainty of zeros and other known numbers
_NUMBER_SHARE = 1e-3  # smallest relevant relative error of a number
_FRICTION_RAD_S = 0.03  # smallest relevant friction torque over the damping
_NO_MOTION = 1e3  # standard deviations stated for a release for which the model has no finite motion
_NOT_FOLLOWED = "release"  # name of the single row of a release that is not followed
_THREADS = 2
_PASSES = 8  # largest number of passes of the common linearisation point
_SETTLED_SHARE = 0.01  # change of that point, as a share of the smallest relevant error, below which the passes end
BOW_CAUSES = ("bow along", "bow across")
"""Names of the components of BOW in a validation: along the imbalance, and a quarter turn ahead."""


@dataclass(frozen=True)
class ReleaseRows:
    """Comparison of one release with the model.

    Attributes:
        point: name of the point; "A (2)" for its second recording.
        rows: names of the m rows.
        values: measured − predicted in standard deviations of the release's own errors, shape (m,).
        own: covariance of these errors, shape (m, m).
        by_parameter: derivatives of the values by the identified parameters, shape (m, n).
        parameters: names of the n parameters.
        by_number: number of the rig file, or a pendulum's dry friction or drag that is assumed to be 0 → derivative of
            the values by it, shape (m,).
        shared: label → shift of the values for one standard deviation of an error that other tests share, shape (m,).
        used_for: parameters whose identification used this release, so that their errors are not independent of its
            own errors.
        chi2_per_dof: χ²/dof of the readings with all parameters free.
        sentence: result in words: followed, not followed, or the reason why there are no rows.
        by_slow_roll: of BOW_CAUSES → change of the values per metre of bow in addition to the identified bow,
            shape (m,).
        reading: interpretation of a torque that a spin-down found to grow with the square of the speed, if no earlier
            release has decided it: "drag" of the air, or friction with the "contact" force; "" otherwise.
        unusual_openings: locks that opened at another instant than the rig file allows.
    """

    point: str
    rows: tuple[str, ...]
    values: Array
    own: Array
    by_parameter: Array
    parameters: tuple[str, ...]
    by_number: Mapping[str, Array] = field(default_factory=dict[str, Array])
    shared: Mapping[ErrorLabel, Array] = field(default_factory=dict[ErrorLabel, Array])
    used_for: tuple[str, ...] = ()
    chi2_per_dof: float = math.nan
    sentence: str = ""
    by_slow_roll: Mapping[str, Array] = field(default_factory=dict[str, Array])
    reading: Reading = ""
    unusual_openings: tuple[Opening, ...] = ()

    @property
    def remark(self) -> str:
        """Locks that opened at an unusual instant, and dry friction that no test has found; empty without any."""
        found = [each.sentence for each in self.unusual_openings]
        if "dry friction" in self.sentence and self.followed:
            found.append(self.sentence)
        return f"{self.point} release: {'; '.join(found)}" if found else ""

    @property
    def followed(self) -> bool:
        """Whether the release was compared, and a model near the identified one follows it."""
        return bool(self.rows) and self.rows != (_NOT_FOLLOWED,)


@on_one_thread
def check_releases(
    runs: Sequence[Run],
    rig: Rig,
    identified: IdentifiedParameters,
    progress: Callable[[str], None] | None = None,
    exact: Collection[str] = (),
) -> list[ReleaseRows]:
    """Compare every release at a point with the model with the identified parameters.

    Args:
        runs: recorded tests, of which those at points with a release are used.
        rig: known numbers and their uncertainties.
        identified: parameters with covariance. Parameters that are missing in it are free.
        progress: called with one line of text before each release.
        exact: names of parameters that were set, whose values are those of the rig.
    Returns:
        One result per release, sorted by point and time. A release that cannot be compared has no rows.
    Source: docs/theory/validation.md.
    """
    taken, named = dict[str, int](), list[tuple[str, Run]]()
    for run in sorted((r for r in runs if point_of(r.test)), key=lambda r: (r.test, r.start_s)):
        name = point_of(run.test)
        taken[name] = taken.get(name, 0) + 1
        named.append((f"{name} ({taken[name]})" if taken[name] > 1 else name, run))
    released = [each for each in named if each[1].releases]
    with ThreadPool(_THREADS) as pool:
        drag = Drag.of(identified.provenance)
        reading: Reading = "drag" if drag is not None and drag.undecided else ""
        case, first = _first(_Case(rig, Attempts(identified, frozenset(exact)), reading), released, pool, progress)
        if reading and any(_needs_friction(each) for each in first):
            by_contact = replace(identified, provenance=read_as(identified.provenance, "contact"))
            contact = replace(case, attempts=replace(case.attempts, identified=by_contact), reading="contact")
            other = _first(contact, released, pool, progress)
            case, first = min((case, first), other, key=lambda tried: _left(tried[1]))
        fits = [each for each in first if isinstance(each, FittedRelease)]
        fits = case.settled(with_common_friction(case.attempts, fits, pool), pool)
    followed = iter(fits)
    return [
        replace(each, reading=case.reading)
        if isinstance(each, ReleaseRows)
        else case.named(point, run, next(followed), each)
        for each, (point, run) in zip(first, released, strict=True)
    ]


def _first(
    case: _Case, released: Sequence[tuple[str, Run]], pool: ThreadPoolExecutor, progress: Callable[[str], None] | None
) -> tuple[_Case, list[ReleaseRows | FittedRelease]]:
    """Return the case and the fit of each release with all parameters free."""

    def opened(each: tuple[str, Run]) -> ReleaseRows | FittedRelease:
        if progress is not None:
            progress(f"{each[1].test}: comparing the release with the model")
        return case.opened(*each)

    return case, list(pool.map(opened, released))


def _needs_friction(each: ReleaseRows | FittedRelease) -> bool:
    """Return whether a release is followed only with dry friction, or not at all."""
    return each.shape is not None if isinstance(each, FittedRelease) else bool(each.rows)


def _left(first: Sequence[ReleaseRows | FittedRelease]) -> tuple[int, float]:
    """Return the number of releases that are not followed, and the sum of the costs of the others."""
    fits = [each for each in first if isinstance(each, FittedRelease)]
    return len(first) - len(fits), sum(each.minimum.cost for each in fits)


@dataclass(frozen=True)
class _Case:
    """Model and rig that all releases are compared with.

    Attributes:
        rig: known numbers and their uncertainties.
        attempts: start of the fits.
        reading: as in `ReleaseRows`.
    """

    rig: Rig
    attempts: Attempts
    reading: Reading = ""

    @property
    def identified(self) -> IdentifiedParameters:
        """Parameters with covariance."""
        return self.attempts.identified

    def opened(self, point: str, run: Run) -> ReleaseRows | FittedRelease:
        """Return the fit of one release with all parameters free, or rows with the reason why it has none."""
        names = tuple(self.identified.values)
        empty = ReleaseRows(point, (), np.empty(0), np.empty((0, 0)), np.empty((0, len(names))), names)
        zero_std = math.radians(self.rig.roles.zero_std_deg)
        if wrong := [name for name, value in self.identified.values.items() if value <= 0]:
            return replace(empty, sentence=f"{run.source}: not compared, {', '.join(wrong)} must be above 0")
        known = Knowledge.nominal(self.identified.applied_to(self.rig.physics))
        known = replace(known, terms=tuple(self._term_std), release_std_s=self.rig.pendulums.release_std_s)
        try:
            release = RecordedRelease.of(run, known, _ZERO_WIDE * zero_std, "balanced")
        except NotIdentifiable as error:
            return replace(empty, sentence=str(error))
        try:
            with bounded_work(f"{run.source}: release"):
                return self.attempts.fitted(release)
        except FitFailed as error:
            z, chi2 = _off(error, release)
            why = f"{error}: no model near the identified one follows it"
            none = np.zeros((1, len(names)))
            return replace(
                empty,
                rows=(_NOT_FOLLOWED,),
                values=np.array([z]),
                own=np.eye(1),
                by_parameter=none,
                chi2_per_dof=chi2,
                sentence=why,
            )

    def settled(self, fits: Sequence[FittedRelease], pool: ThreadPoolExecutor) -> list[Condensed]:
        """Return the results of the releases, linearised at the parameters that fit all of them best."""
        if not fits:
            return []
        relevant, assumed = self._relevant_errors(), self._assumed
        found = [condensed(fitted, assumed, relevant) for fitted in fits]
        before, there = dict[str, float](), found
        for _ in range(_PASSES):
            shared = {name: size for name, size in relevant.items() if name not in (*FRICTION, *DRAG)}
            place = {name: assumed.get(name, 0.0) + off for name, off in agreed(there, shared).items()}
            if before and all(abs(place[name] - before[name]) < _SETTLED_SHARE * relevant[name] for name in place):
                break
            moved = list(pool.map(fitted_at, fits, repeat(place), [each.misfit for each in found]))
            fits = [new or old for new, old in zip(moved, fits, strict=True)]
            found = [condensed(fitted, assumed, relevant) for fitted in fits]
            # a release that does not converge there is linearised at another point and does not determine the next one
            there = [each for each, new in zip(found, moved, strict=True) if new is not None] or found
            before = place
        return found

    @property
    def _assumed(self) -> dict[str, float]:
        """Components of θ that the release is compared with, by name."""
        found = {name: math.log(value) for name, value in self.identified.values.items()} | {ZERO_A: 0.0, ZERO_B: 0.0}
        return found if self.attempts.known_friction else found | dict.fromkeys(FRICTION, 0.0)

    @property
    def _bow_errors(self) -> dict[ErrorLabel, Array]:
        """Label → shift of the identified bow for one standard deviation of an error in it, shape (2,), m."""
        roll = self.identified.slow_roll
        if roll is None or roll.bow_m == 0:
            return {}
        errors = roll.errors(self.rig.roles.gain_stds, self.rig.known)
        return {label: shift[4:] for label, shift in errors.items()}

    @property
    def _term_std(self) -> dict[str, float]:
        """Term of the suspension → its standard deviation, for uncertain terms."""
        terms = self.identified.terms
        if terms is None:
            return {}
        return {name: std for name, std in zip(TERMS, terms.std.tolist(), strict=True) if std > 0}

    @property
    def _term_errors(self) -> dict[ErrorLabel, dict[str, float]]:
        """Label → term of the suspension → its shift for one standard deviation of an error."""
        if self.identified.terms is None:
            return {}
        errors = self.identified.terms.errors(self.rig.roles.gain_stds)
        return {label: dict(zip(TERMS, shift.tolist(), strict=True)) for label, shift in errors.items()}

    def named(self, point: str, run: Run, found: Condensed, fitted: FittedRelease) -> ReleaseRows:
        """Return the rows of one release.

        Args:
            point: name of the point.
            run: recording.
            found: information of the release on the shared unknowns.
            fitted: fit with all parameters free.
        """
        values = self.identified.values
        columns = [found.slopes[name] / value for name, value in values.items()]
        by = np.column_stack(columns) if columns else np.empty((len(found.values), 0))
        drag = Drag.of(self.identified.provenance)
        numbers = (*PHYSICAL, *FRICTION, *(() if drag else DRAG))
        by_number = {name: found.slopes[name] for name in numbers if name in found.slopes}
        for name, contact in zip(FRICTION, CONTACT_FRICTION, strict=True):
            if name in by_number:
                by_number[contact] = by_number[name] * fitted.release.speed_rad_s**2
        shared = {label: by @ shift for label, shift in self.identified.shared_with(self.rig.known).items()}
        known = self.rig.known.sources
        for source in drag.moved_with(known) if drag else known:
            parts = [found.slopes[name] * step for name, step in source.effects.items() if name in found.slopes]
            shared[source.label] = np.sum([shared.get(source.label, np.zeros(len(by))), *parts], axis=0)
        for label, shift in zip(LABELS, drag.root.T, strict=True) if drag else ():
            parts = np.sum([found.slopes[name] * float(s) for name, s in zip(DRAG, shift, strict=True)], axis=0)
            shared[label] = shared.get(label, np.zeros(len(by))) + parts
        for label, shift in self._bow_errors.items():
            parts = found.slopes[BOW[0]] * shift[0] + found.slopes[BOW[1]] * shift[1]
            shared[label] = shared.get(label, np.zeros(len(by))) + parts
        for label, moved in self._term_errors.items():
            parts = [found.slopes[name] * step for name, step in moved.items() if name in found.slopes]
            shared[label] = np.sum([shared.get(label, np.zeros(len(by))), *parts], axis=0)
        rate = {name: 1.0 if name in DAMPING else 2.0 for name in values if name[0] in "ck"}
        clock = -np.sum([power * found.slopes[name] for name, power in rate.items()], axis=0)
        for label, shift in clock_errors(run, {"angles": clock}).items():
            shared[label] = shared.get(label, np.zeros(len(by))) + shift
        count = len(found.values)
        return ReleaseRows(
            point,
            tuple(f"release {i + 1}" for i in range(count)),
            found.values,
            found.own,
            by,
            tuple(values),
            by_number,
            shared,
            used_for(run, self.identified),
            found.misfit.chi2_per_dof,
            f"followed{_friction_text(found)}; χ² of the readings {found.misfit.chi2_per_dof:.3g} each",
            {name: -found.slopes[part] for name, part in zip(BOW_CAUSES, BOW, strict=True)},
            self.reading,
            tuple(each for each in fitted.release.openings(fitted.minimum) if each.unusual),
        )

    def _relevant_errors(self) -> dict[str, float]:
        """Return the smallest relevant errors by name, in the units of the slopes."""
        known = self.rig.known
        found = {name: std for name, std in self.attempts.std(WIDE).items() if name in self.identified.values}
        for name in PHYSICAL:
            found[name] = max(_ZERO_WIDE * known.std(name), _NUMBER_SHARE * abs(known.values[name]))
        for name in (ZERO_A, ZERO_B, INDEX):
            found[name] = _ZERO_WIDE * known.std(name)
        found |= {name: _ZERO_WIDE * std for name, std in self._term_std.items()}
        errors = np.array([*self._bow_errors.values()]).reshape(-1, 2)
        found |= dict(zip(BOW, (_ZERO_WIDE * np.sqrt(np.sum(errors**2, axis=0))).tolist(), strict=True))
        for name, damping in zip(FRICTION, DAMPING, strict=True):
            found[name] = _FRICTION_RAD_S * self.identified.values.get(damping, 0.0)
        for name, damping in zip(DRAG, DAMPING, strict=True):
            found[name] = _FRICTION_RAD_S * self.identified.values.get(damping, 0.0) / FLICK_RAD_S**2
        return found


def _friction_text(found: Condensed) -> str:
    """Return the dry friction that a release requires, in words; empty if it requires none."""
    if not found.has_friction:
        return ""
    torque = [-found.values[-2 + i] / found.slopes[name][-2 + i] for i, name in enumerate(FRICTION)]
    return f" only with dry friction, of {torque[0]:.2g} N m (A) and {torque[1]:.2g} N m (B)"


def used_for(run: Run, identified: IdentifiedParameters) -> tuple[str, ...]:
    """Return the parameters whose identification used a run, found by its digest or its log's name."""
    kept: list[Any] = identified.provenance.get("tests", [])
    digest, found = str(run.metadata.get("digest") or ""), dict[str, None]()
    for test in kept:
        digests, logs = (parts(str(test.get(key, ""))) for key in ("digest", "log"))
        same = digest in digests if digest and any(digests) else Path(run.source).name in logs
        if same and not test.get("left_out"):
            found |= dict.fromkeys(test.get("values", {}))
    return tuple(name for name in identified.values if name in found)


def _off(error: FitFailed, release: RecordedRelease) -> tuple[float, float]:
    """Return the deviation of a release that is not followed in standard deviations, and χ²/dof.

    The deviation is Fisher's normal approximation of χ².
    """
    if not isinstance(error, NotFollowed) or not error.trials:
        return _NO_MOTION, math.nan
    best = max(error.trials, key=lambda t: (t.end_s, -t.misfit))
    n = sum(int(np.count_nonzero(r.averages.time_s <= best.end_s)) for r in release.readings)
    if not math.isfinite(best.misfit):
        return _NO_MOTION, math.nan
    return min(math.sqrt(2 * n) * (math.sqrt(max(best.misfit, 0.0)) - 1), _NO_MOTION), best.misfit
