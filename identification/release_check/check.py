# pyright: strict
"""What happened right after each release, against the model with the identified parameters, as rows for a validation.

Steady states hardly depend on the pendulums' damping; the first seconds after a release do. The release is fitted with
everything open, from what was identified on, so that the rows hold also where that is many standard deviations off.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.signals.run import Run, point_of
from identification.clocks import clock_errors
from identification.errors import FitFailed, NotIdentifiable
from identification.least_squares import Minimum
from identification.pendulums.free_angles import laid_over
from identification.pendulums.friction import Friction
from identification.pendulums.release_problem import SUSPENSION, Release, Shape
from identification.pendulums.release_search import Effort, NotFollowed, Search, holding
from identification.pendulums.suspension_knowledge import BOW, NAMES, NOMINAL_SHARE, Knowledge
from identification.pendulums.transient import TransientProblem
from identification.pendulums.unknown_phase import angles_to_try, race
from identification.release_check.model import Condensed, Fitted, condensed, fitted_with_numbers, opened
from identification.release_check.together import agreed, fitted_at
from identification.threads import on_one_thread
from rig_configs.drag import LABELS, Drag, Reading, read_as
from rig_configs.known import CONTACT_FRICTION, DRAG, FRICTION, INDEX, PHYSICAL, ZERO_A, ZERO_B
from rig_configs.parameters_file import IdentifiedParameters
from rig_configs.schema import Rig
from rig_configs.suspension_terms import TERMS

Array = NDArray[np.float64]

_LONGEST_S = 8.0
_WIDE, _LEAST_SHARE = 10.0, 0.01  # standard deviations, and a share, to which a parameter is opened
_ZERO_WIDE = 3.0
_NUMBER_SHARE = 1e-3  # of a number: an error worth seeing
_EXACT = 1e-7  # std of a logarithm that was set
_DAMPING = ("c3_Nms_per_rad", "c4_Nms_per_rad")
_NOMINAL: Mapping[str, float] = {**dict(zip(NAMES, NOMINAL_SHARE, strict=True)), **dict.fromkeys(_DAMPING, 2.5)}
_FLICK_RAD_S, _FRICTION_SHARES = 12.0, (0.003, 0.01, 0.03)  # friction to start from
_FRICTION_RAD_S = 0.03  # times the damping: friction worth seeing
_NO_MOTION = 1e3  # standard deviations of a release along which the model has no finite motion
_NOT_FOLLOWED = "release"  # the one row of such a release
_THREADS = 2
_PASSES, _STANDS = 8, 0.01  # over the place where all releases are met best; of what is worth seeing
BOW_CAUSES = ("bow along", "bow across")
"""How a validation names the components of BOW: along the imbalance, and a quarter turn ahead."""


@dataclass(frozen=True)
class ReleaseRows:
    """What one release says of the model.

    Attributes:
        point: the point's name, "A (2)" for its second recording.
        rows: names of the rows, m of them.
        values: measured − predicted in standard deviations of the release's own errors, shape (m,).
        own: covariance of these errors, shape (m, m).
        by_parameter: derivatives of the values by the identified parameters, shape (m, n).
        parameters: names of these, n of them.
        by_number: number of the rig file, or a pendulum's dry friction or drag that was taken as 0 → derivative of the
            values by it, shape (m,).
        shared: label → shift of the values for one standard deviation of an error that others share, shape (m,).
        used_for: parameters that this very release has helped to identify: their errors are not independent of its own.
        chi2_per_dof: of the readings with everything open.
        sentence: in words; why there are no rows, or that the motion is not followed.
        by_slow_roll: of BOW_CAUSES → change of the values per metre of a bow beyond what was taken, shape (m,).
        reading: what a torque that grows with the square of the speed was taken for, where a spin-down has found one
            and no release has told before: the air's "drag" or friction with the "contact" force; "" elsewhere.
    """

    point: str
    rows: tuple[str, ...]
    values: Array
    own: Array
    by_parameter: Array
    parameters: tuple[str, ...]
    by_number: Mapping[str, Array] = field(default_factory=dict[str, Array])
    shared: Mapping[str, Array] = field(default_factory=dict[str, Array])
    used_for: tuple[str, ...] = ()
    chi2_per_dof: float = math.nan
    sentence: str = ""
    by_slow_roll: Mapping[str, Array] = field(default_factory=dict[str, Array])
    reading: Reading = ""

    @property
    def followed(self) -> bool:
        """Whether the release was compared and some rig near the identified one moves like it."""
        return bool(self.rows) and self.rows != (_NOT_FOLLOWED,)


@on_one_thread
def check_releases(
    runs: Sequence[Run], rig: Rig, identified: IdentifiedParameters,
    progress: Callable[[str], None] | None = None, exact: Collection[str] = (),
) -> list[ReleaseRows]:  # fmt: skip
    """Every release at a point against the model with the identified parameters.

    Args:
        runs: recorded tests; those at points that hold a release are taken.
        rig: known numbers and their uncertainties.
        identified: parameters with covariance. What is absent from them is left open.
        progress: told one line before each release.
        exact: parameters that were set, to be taken as they stand in the rig.
    Returns:
        One per release, by point and time; without rows where a release holds nothing to compare.
    Source: docs/theory/validation.md.
    """
    taken, named = dict[str, int](), list[tuple[str, Run]]()
    for run in sorted((r for r in runs if point_of(r.test)), key=lambda r: (r.test, r.start_s)):
        name = point_of(run.test)
        taken[name] = taken.get(name, 0) + 1
        named.append((f"{name} ({taken[name]})" if taken[name] > 1 else name, run))
    released = [each for each in named if each[1].releases]
    with ThreadPoolExecutor(_THREADS) as pool:
        drag = Drag.of(identified.provenance)
        reading: Reading = "drag" if drag is not None and drag.undecided else ""
        case, first = _first(_Case(rig, identified, frozenset(exact), reading), released, pool, progress)
        if reading and any(_needs_friction(each) for each in first):
            rubs = replace(identified, provenance=read_as(identified.provenance, "contact"))
            other = _first(replace(case, identified=rubs, reading="contact"), released, pool, progress)
            case, first = min((case, first), other, key=lambda tried: _left(tried[1]))
        fits = case.settled([each for each in first if isinstance(each, Fitted)], pool)
    followed = iter(fits)
    return [
        replace(each, reading=case.reading)
        if isinstance(each, ReleaseRows)
        else case.named(point, run, next(followed), each.release.speed_rad_s)
        for each, (point, run) in zip(first, released, strict=True)
    ]


def _first(
    case: _Case, released: Sequence[tuple[str, Run]], pool: ThreadPoolExecutor, progress: Callable[[str], None] | None
) -> tuple[_Case, list[ReleaseRows | Fitted]]:
    """Each release's fit with everything open, and what it was held against."""

    def opened(each: tuple[str, Run]) -> ReleaseRows | Fitted:
        if progress is not None:
            progress(f"{each[1].test}: the release against the model")
        return case.opened(*each)

    return case, list(pool.map(opened, released))


def _needs_friction(each: ReleaseRows | Fitted) -> bool:
    """Whether a release is followed with dry friction only, or not at all."""
    return each.shape is not None if isinstance(each, Fitted) else bool(each.rows)


def _left(first: Sequence[ReleaseRows | Fitted]) -> tuple[int, float]:
    """How many releases are not followed, and what the others leave."""
    fits = [each for each in first if isinstance(each, Fitted)]
    return len(first) - len(fits), sum(each.minimum.cost for each in fits)


@dataclass(frozen=True)
class _Case:
    """What all releases are held against."""

    rig: Rig
    identified: IdentifiedParameters
    exact: frozenset[str]
    reading: Reading = ""

    def opened(self, point: str, run: Run) -> ReleaseRows | Fitted:
        """One release's fit with everything open; rows that say why where there is none."""
        names = tuple(self.identified.values)
        empty = ReleaseRows(point, (), np.empty(0), np.empty((0, 0)), np.empty((0, len(names))), names)
        zero_std = math.radians(self.rig.roles.zero_std_deg)
        if wrong := [name for name, value in self.identified.values.items() if value <= 0]:
            return replace(empty, sentence=f"{run.source}: not compared, {', '.join(wrong)} is not above 0")
        known = Knowledge.nominal(self.identified.applied_to(self.rig.physics))
        known = replace(known, terms=tuple(self._term_std))
        try:
            release = Release.of(run, known, _ZERO_WIDE * zero_std, "balanced")
        except NotIdentifiable as error:
            return replace(empty, sentence=str(error))
        try:
            return self._fitted(release)
        except FitFailed as error:
            z, chi2 = _off(error, release)
            why = f"{error}: no rig near the identified one moves like this"
            none = np.zeros((1, len(names)))
            return replace(
                empty, rows=(_NOT_FOLLOWED,), values=np.array([z]), own=np.eye(1), by_parameter=none,
                chi2_per_dof=chi2, sentence=why,
            )  # fmt: skip

    def settled(self, fits: Sequence[Fitted], pool: ThreadPoolExecutor) -> list[Condensed]:
        """What the releases say, linear about the place where all of them are met best."""
        if not fits:
            return []
        worth, assumed = self._worth(), self._assumed
        found = [condensed(fitted, assumed, worth) for fitted in fits]
        before, there = dict[str, float](), found
        for _ in range(_PASSES):
            shared = {name: size for name, size in worth.items() if name not in (*FRICTION, *DRAG)}
            place = {name: assumed.get(name, 0.0) + off for name, off in agreed(there, shared).items()}
            if before and all(abs(place[name] - before[name]) < _STANDS * worth[name] for name in place):
                break
            moved = list(pool.map(fitted_at, fits, repeat(place), [each.misfit for each in found]))
            fits = [new or old for new, old in zip(moved, fits, strict=True)]
            found = [condensed(fitted, assumed, worth) for fitted in fits]
            # what does not settle there is linear about another place: it has no say in where that is
            there = [each for each, new in zip(found, moved, strict=True) if new is not None] or found
            before = place
        return found

    @property
    def _assumed(self) -> dict[str, float]:
        """Places of θ that the release is held against."""
        found = {name: math.log(value) for name, value in self.identified.values.items()} | {ZERO_A: 0.0, ZERO_B: 0.0}
        return found if self._known_friction else found | dict.fromkeys(FRICTION, 0.0)

    @property
    def _bow_errors(self) -> dict[str, Array]:
        """Label → shift of the bow that was found for one standard deviation of an error in it, shape (2,), m."""
        roll = self.identified.slow_roll
        if roll is None or roll.bow_m == 0:
            return {}
        errors = roll.errors(self.rig.roles.gain_stds, self.rig.known)
        return {label: shift[4:] for label, shift in errors.items()}

    @property
    def _term_std(self) -> dict[str, float]:
        """Standard deviation of each of the suspension's terms that is uncertain."""
        terms = self.identified.terms
        if terms is None:
            return {}
        return {name: std for name, std in zip(TERMS, terms.std.tolist(), strict=True) if std > 0}

    @property
    def _term_errors(self) -> dict[str, dict[str, float]]:
        """Label → term of the suspension → its shift for one standard deviation of an error."""
        if self.identified.terms is None:
            return {}
        errors = self.identified.terms.errors(self.rig.roles.gain_stds)
        return {label: dict(zip(TERMS, shift.tolist(), strict=True)) for label, shift in errors.items()}

    def named(self, point: str, run: Run, found: Condensed, speed_rad_s: float) -> ReleaseRows:
        """Rows of what one release says."""
        values = self.identified.values
        columns = [found.slopes[name] / value for name, value in values.items()]
        by = np.column_stack(columns) if columns else np.empty((len(found.values), 0))
        drag = Drag.of(self.identified.provenance)
        numbers = (*PHYSICAL, *FRICTION, *(() if drag else DRAG))
        by_number = {name: found.slopes[name] for name in numbers if name in found.slopes}
        for name, contact in zip(FRICTION, CONTACT_FRICTION, strict=True):
            if name in by_number:
                by_number[contact] = by_number[name] * speed_rad_s**2
        shared = {label: by @ shift for label, shift in self.identified.shared_with(self.rig.known).items()}
        for source in self.rig.known.sources:
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
        rate = {name: 1.0 if name in _DAMPING else 2.0 for name in values if name[0] in "ck"}
        clock = -np.sum([power * found.slopes[name] for name, power in rate.items()], axis=0)
        for label, shift in clock_errors(run, {"angles": clock}).items():
            shared[label] = shared.get(label, np.zeros(len(by))) + shift
        count = len(found.values)
        return ReleaseRows(
            point, tuple(f"release {i + 1}" for i in range(count)), found.values, found.own, by, tuple(values),
            by_number, shared, _used_for(run, self.identified), found.misfit.chi2_per_dof,
            f"followed{_rubbing(found)}; χ² of the readings {found.misfit.chi2_per_dof:.3g} each",
            {name: -found.slopes[part] for name, part in zip(BOW_CAUSES, BOW, strict=True)}, self.reading,
        )  # fmt: skip

    def _fitted(self, release: Release) -> Fitted:
        """The release with everything open: from near what was identified, from far, with what a rig may have beside.

        That is other pendulums or dry friction, whichever leaves less.

        Raises:
            FitFailed: the model does not follow the angles.
        """
        last: FitFailed | None = None
        for wide in (_WIDE, math.inf):
            try:
                return self._opened(release, self._std(wide), False)
            except FitFailed as error:
                last = last or error
        found = self._beside(release)
        if not found:
            assert last is not None
            raise last
        return min(found, key=lambda fitted: fitted.minimum.cost)

    def _beside(self, release: Release) -> list[Fitted]:
        """A release that the identified model does not follow, with other pendulums and with dry friction."""
        found = list[Fitted]()
        with contextlib.suppress(FitFailed):
            found.append(self._opened(release, self._std(_WIDE), True))
        for share in () if self._known_friction else _FRICTION_SHARES:
            with contextlib.suppress(FitFailed):
                found.append(self._opened(release, self._std(_WIDE), False, share))
                break
        return found

    def _opened(
        self, release: Release, std: Mapping[str, float], numbers: bool, rubbing: float | None = None
    ) -> Fitted:
        """One attempt.

        Args:
            rubbing: share of the largest viscous torque of a flick that dry friction is to start from; None for what
                was identified of it.
        """
        shape, torque = self._friction(release) if rubbing is None else ("torque", rubbing * self._flick_Nm)
        problem = opened(release.problem(shape), std)
        start = problem.prior.copy()
        if shape is not None:
            start[16:18] = torque
        horizons = _horizons(release)
        starts = [start]
        if not release.run.phase_absolute:
            turns = angles_to_try(laid_over(release.knowledge, start[:2], start[SUSPENSION]))
            trials = [np.r_[start[:-1], turn] for turn in turns]
            starts = race(problem, trials, horizons[:-1], holding)

        def solve(problem: TransientProblem, *from_places: Array) -> Minimum:
            search = Search(problem, horizons, len(from_places), Effort(), lambda _: None)
            return search.answers([(place, False) for place in from_places], release.run.source)[0]

        if numbers:
            return fitted_with_numbers(release, problem, shape, horizons, solve, starts[0])
        return Fitted(release, problem, shape, solve(problem, *starts), horizons)

    def _std(self, wide: float) -> dict[str, float]:
        """How far each parameter's logarithm is opened, standard deviations of it; at most to what a file is worth."""
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

    def _worth(self) -> dict[str, float]:
        """Errors that a release should see, in the units of the slopes."""
        known = self.rig.known
        found = {name: std for name, std in self._std(_WIDE).items() if name in self.identified.values}
        for name in PHYSICAL:
            found[name] = max(_ZERO_WIDE * known.std(name), _NUMBER_SHARE * abs(known.values[name]))
        for name in (ZERO_A, ZERO_B, INDEX):
            found[name] = _ZERO_WIDE * known.std(name)
        found |= {name: _ZERO_WIDE * std for name, std in self._term_std.items()}
        errors = np.array([*self._bow_errors.values()]).reshape(-1, 2)
        found |= dict(zip(BOW, (_ZERO_WIDE * np.sqrt(np.sum(errors**2, axis=0))).tolist(), strict=True))
        for name, damping in zip(FRICTION, _DAMPING, strict=True):
            found[name] = _FRICTION_RAD_S * self.identified.values.get(damping, 0.0)
        for name, damping in zip(DRAG, _DAMPING, strict=True):
            found[name] = _FRICTION_RAD_S * self.identified.values.get(damping, 0.0) / _FLICK_RAD_S**2
        return found

    @property
    def _known_friction(self) -> Mapping[str, float]:
        """What the identification found of dry friction; empty where it found none."""
        kept: list[Any] = self.identified.provenance.get("tests", [])
        found: list[Mapping[str, float]] = [test["friction"] for test in kept if test.get("friction")]
        if whole := self.identified.provenance.get("friction"):
            found.append(whole["values"])
        return found[-1] if found and max(found[-1].values()) > 0 else {}

    @property
    def _flick_Nm(self) -> Array:
        """The largest viscous torques of a flick, shape (2,)."""
        return _FLICK_RAD_S * np.array([self.identified.values.get(name, 0.0) for name in _DAMPING])

    def _friction(self, release: Release) -> tuple[Shape | None, Array]:
        """Dry friction to open, and its torque to start from, where the identification found some."""
        values = self._known_friction
        if not values:
            return None, np.zeros(2)
        torque = (values.get("coulomb_a_Nm", 0.0), values.get("coulomb_b_Nm", 0.0))
        contact = (values.get("contact_a_kg_m2", 0.0), values.get("contact_b_kg_m2", 0.0))
        none = (0.0, 0.0)
        return "torque", Friction(torque, none, contact, none).torque_at(release.speed_rad_s)


def _rubbing(found: Condensed) -> str:
    """The dry friction without which a release is not followed, in words; empty where it is."""
    if not found.rubs:
        return ""
    torque = [-found.values[-2 + i] / found.slopes[name][-2 + i] for i, name in enumerate(FRICTION)]
    return f" only with dry friction, of {torque[0]:.2g} N m (A) and {torque[1]:.2g} N m (B)"


def _used_for(run: Run, identified: IdentifiedParameters) -> tuple[str, ...]:
    """Parameters whose identification took this run's values, by its digest or its log's name."""
    kept: list[Any] = identified.provenance.get("tests", [])
    digest, found = str(run.metadata.get("digest") or ""), dict[str, None]()
    for test in kept:
        digests, logs = str(test.get("digest", "")).split(" + "), str(test.get("log", "")).split(" + ")
        same = digest in digests if digest and any(digests) else Path(run.source).name in logs
        if same and not test.get("left_out"):
            found |= dict.fromkeys(test.get("values", {}))
    return tuple(name for name in identified.values if name in found)


def _horizons(release: Release) -> list[float]:
    """Last instants over the first seconds, every other one of a release's."""
    end = release.begin_s + _LONGEST_S
    every = release.horizons("balanced")
    last = min(every[-1], end)
    return [h for h in every[:-1:2] if h < 0.7 * last + 0.3 * release.begin_s] + [last]


def _off(error: FitFailed, release: Release) -> tuple[float, float]:
    """How many standard deviations a release is off that is not followed, by Fisher's normal form of χ², and χ²/dof."""
    if not isinstance(error, NotFollowed) or not error.trials:
        return _NO_MOTION, math.nan
    best = max(error.trials, key=lambda t: (t.end_s, -t.misfit))
    n = sum(int(np.count_nonzero(r.averages.time_s <= best.end_s)) for r in release.readings)
    if not math.isfinite(best.misfit):
        return _NO_MOTION, math.nan
    return min(math.sqrt(2 * n) * (math.sqrt(max(best.misfit, 0.0)) - 1), _NO_MOTION), best.misfit
