"""Identify the rig's parameters from recorded runs: a fit of each test, then the joint estimate of all tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from daq.signals.completeness import missing_warnings
from daq.signals.phase_noise import phase_remarks
from daq.signals.rotor_doubts import encoder_jumps
from daq.signals.run import Run, disagreements
from daq.signals.threads import on_one_thread
from daq.signals.witnesses import WitnessAgreement
from identification.errors import FitFailed, IdentificationError, NotIdentifiable
from identification.estimate import Estimate
from identification.joint import ConsistencyRow, combine, joint_estimate
from identification.joint.drift import with_drift
from identification.joint.provenance import with_tests
from identification.joint.shared_friction import friction_messages, with_shared_friction, without_known
from identification.locked_pendulums import loose_locks
from identification.methods import advice, reduced_to_given, runs_for, skipped_tests, turns
from identification.mounting import as_mounted, mounting_remarks
from identification.pendulums.drag import FoundDrag, found_drag, with_undecided_drag
from identification.pendulums.friction import Friction, kept_friction
from identification.pendulums.open_friction import OpenFriction, pooled
from identification.pendulums.open_numbers import PENDULUMS
from identification.pendulums.release import ReleaseLeftOut, fit_release
from identification.pendulums.release_search import Effort
from identification.pendulums.spin_down_run import damping_estimate, fit_spin_down_run
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientFit
from identification.physical import keep_directed, keep_physical, physical_parameters, run_up_sides
from identification.ring_down.fit import RingDownFit
from identification.ring_down_campaign import fit_ring_downs
from identification.run_up.fit import RunUpFit, fit_run_up_run, run_up_estimate
from identification.run_up.slow_roll_vector import slow_roll_of, slow_roll_of_all
from identification.rungs import Rung, held_back
from identification.setting import Setting
from identification.sources import Sources, joined, log_names
from identification.suspension_terms import ChosenTerms, known_suspension, sharing_terms, terms_of_all
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_configs.drag import Reading
from rig_configs.known import BOW, DRAG, KnownSource, assumed_remarks
from rig_configs.parameters_file import PARAMETER_UNITS, IdentifiedParameters
from rig_configs.schema import Rig
from rig_configs.slow_roll import SlowRoll

Fit = RingDownFit | RunUpFit | TransientFit


@dataclass(frozen=True)
class NamedFit:
    """Fit of one test, for the report. Its curves are in `fit.curves`."""

    test: str
    sources: Sources
    fit: Fit

    @property
    def source(self) -> str:
        """Paths of the logs as one text."""
        return joined(self.sources)


@dataclass(frozen=True)
class Identification(Tabular):
    """Result of the identification from a set of runs.

    Attributes:
        parameters: joint estimate, in the order of parameters.toml. Parameters that no run determines are absent.
        axis_angle_deg, axis_angle_std_deg: angle from the stiffness axes to the sensor axes and its standard
            uncertainty; NaN if no run determines it.
        estimates: values and covariance of each test.
        fits: fit of each test, with curves.
        consistency: agreement per parameter and test, for parameters that at least two tests determine.
        warnings: findings that limit the use of the values.
        witnesses: comparison of additional sensors along an axis with the sensors that measure for the rig, per run.
        to_record: advice what to record for the parameters that no run determines; empty if none is absent.
    """

    parameters: IdentifiedParameters
    axis_angle_deg: float
    axis_angle_std_deg: float
    estimates: list[Estimate]
    fits: list[NamedFit]
    consistency: list[ConsistencyRow]
    warnings: list[str]
    witnesses: list[WitnessAgreement] = field(default_factory=list[WitnessAgreement])
    to_record: str = ""

    @property
    def heading(self) -> str:
        """Number of fitted tests, and what is identified."""
        return f"{number_of(len(self.fits), 'test')}: {self.parameters.heading}"

    @property
    def remarks(self) -> list[str]:
        """The warnings, and what to record."""
        return [*self.warnings, *([self.to_record] if self.to_record else [])]

    def columns(self) -> Mapping[str, Column]:
        """Return the table of the parameters."""
        return self.parameters.columns()


@dataclass
class _Work:
    """Intermediate results of the tests that have been fitted so far."""

    rig: Rig
    notify: Callable[[str], None]
    setting: Setting
    without: frozenset[Rung]
    estimates: list[Estimate]
    fits: list[NamedFit]
    warnings: list[str]
    effort: Effort = field(default_factory=Effort)
    left_out: list[tuple[str, ReleaseLeftOut]] = field(default_factory=list[tuple[str, ReleaseLeftOut]])
    reading: Reading = ""

    def add(self, run: Run, fit: Fit, estimate: Estimate, tests: Sequence[str] = ()) -> None:
        self.fits.append(NamedFit(run.test, estimate.sources, fit))
        self.warnings += [f"{log_names(estimate.sources)}: {w}" for w in fit.warnings]
        if not fit.settled:
            self.warnings.append(f"{run.test} left out: its fit had not settled, its values are not usable")
            return
        self._keep(estimate, tests or [run.test])

    def _keep(self, estimate: Estimate, tests: Sequence[str]) -> None:
        """Add an estimate, reduced to the parameters that its tests give and to values that are physically possible."""
        given = reduced_to_given(estimate, tests)
        if given is None:
            return
        for keep in (keep_physical, keep_directed):
            given, messages = keep(given, self.rig)
            self.warnings += messages
            if given is None:
                return
        self.estimates.append(given)

    def knowledge(self) -> Knowledge:
        """Values of the rig file, replaced by the values that the tests so far have found."""
        open_masses = () if "open-masses" in self.without else PENDULUMS
        stated = {n: std for n in open_masses if (std := self.rig.known.std(n)) > 0}
        known = replace(
            Knowledge.nominal(self.rig.physics),
            friction=self.friction(),
            number_std=stated,
            release_std_s=self.rig.pendulums.release_std_s,
        )
        if (roll := self.slow_roll()[0]) is not None and roll.bow_m:
            bent = replace(known.physics, bow_x_m=roll.bow_m.real, bow_y_m=roll.bow_m.imag)
            known = replace(known, physics=bent, numbers=(*known.numbers, *BOW))
        known = replace(known, physics=self.suspension_terms().terms.applied_to(known.physics))
        if not self.estimates:
            return known
        joint = joint_estimate(with_drift(self.estimates)[0])
        found = joint.parameters
        damping = {n: v for n, v in found.values.items() if n.startswith(("c3", "c4"))}
        slopes = {n: dict(zip(found.values, by.tolist(), strict=True)) for n, by in joint.weighted.by_number.items()}
        known = known.with_found(found.values, found.std).with_slopes(found.values, slopes)
        return replace(known, physics=known.physics.with_values(**damping))

    @property
    def drag(self) -> FoundDrag | None:
        """Drag found in spin-downs (torque ∝ speed²), or None. None too if a release identified contact friction."""
        fits = [f.fit for f in self.fits if isinstance(f.fit, TransientFit)]
        found = None if self.reading == "contact" else found_drag(fits)
        return None if found is None else replace(found, drag=replace(found.drag, undecided=not self.reading))

    @property
    def sources(self) -> tuple[KnownSource, ...]:
        """Uncertainty sources of the quantities that the tests take as known."""
        known, drag = self.rig.known.sources, self.drag.drag if self.drag else None
        if (roll := self.slow_roll()[0]) is not None:
            known = known + roll.bow_sources
        return drag.moved_with(known) + drag.sources if drag else known

    @property
    def transients(self) -> dict[Sources, TransientFit]:
        """Pendulum fits by their logs. If a drag is found, their friction is the one next to that drag."""
        fits = {f.sources: f.fit for f in self.fits if isinstance(f.fit, TransientFit)}
        return {logs: with_undecided_drag(fit) for logs, fit in fits.items()} if self.drag else fits

    def dragged(self) -> Knowledge | None:
        """Return `knowledge` with the drag added, for releases, or None if no drag is found."""
        known, found = self.knowledge(), self.drag
        if found is None:
            return None
        friction = self.friction()
        friction = friction.without_contact if friction is not None and friction.speed_rad_s == 0 else friction
        return replace(known, physics=found.drag.on(known.physics), friction=friction, numbers=(*known.numbers, *DRAG))

    def slow_roll(self, digests: Mapping[Sources, str] | None = None) -> tuple[SlowRoll | None, list[str]]:
        """Run-out and bow from the accepted run-ups so far. `digests` are the logs' digests by source."""
        found = [slow_roll_of(fit, joined(logs), (digests or {}).get(logs, "")) for logs, fit in self.passages.items()]
        return slow_roll_of_all([one for one in found if one is not None])

    @property
    def passages(self) -> dict[Sources, RunUpFit]:
        """Fits of the run-ups whose S_P was accepted, by their logs. Other fits give nothing to later tests."""
        accepted = {e.sources for e in self.estimates if "SP_kg_m" in e.names}
        return {f.sources: f.fit for f in self.fits if isinstance(f.fit, RunUpFit) and f.sources in accepted}

    def suspension_terms(self, digests: Mapping[Sources, str] | None = None) -> ChosenTerms:
        """Amplitude dependence of the suspension from the tests so far. `digests` are the logs' digests by source."""
        ring_downs = [(f.sources, f.fit.terms) for f in self.fits if isinstance(f.fit, RingDownFit)]
        passages = [(logs, fit.terms) for logs, fit in self.passages.items()]
        return terms_of_all(ring_downs, passages, digests)

    @property
    def axis_angle_deg(self) -> float:
        """Angle from the stiffness x axis to the sensor x axis by the tests so far; 0 if none determines it."""
        angle = _axis_angle(self.fits)[0]
        return angle if math.isfinite(angle) else 0.0

    def open_friction(self) -> OpenFriction | None:
        """Friction of all transients so far, including the known numbers' uncertainty; None for fewer than two."""
        fits = [fit for fit in self.transients.values() if fit.open_friction is not None]
        sources, zero_std = self.sources, math.radians(self.rig.roles.zero_std_deg)
        if len(fits) < 2:
            return None
        return pooled([without_known(fit, zero_std) for fit in fits], sources).covering(sources)

    def friction(self) -> Friction | None:
        """Friction of all tests so far if it is significant, else that of the last release, else of a spin-down."""
        found = [(turns(f.test), f.fit) for f in self.fits if isinstance(f.fit, TransientFit)]
        whole = self.open_friction()
        if whole is not None and (sure := Friction.sure(whole)) is not None:
            return sure
        at_speed = [fit.friction for release, fit in found if fit.friction is not None and release]
        return at_speed[-1] if at_speed else next((fit.friction for _, fit in found if fit.friction is not None), None)


@on_one_thread
def identify(
    runs: Sequence[Run],
    rig: Rig,
    notify: Callable[[str], None] | None = None,
    earlier: Identification | None = None,
    setting: Setting = "balanced",
    without: Collection[str] = (),
) -> Identification:
    """Estimate k1, k2, ζ1, ζ2, c3, c4 and S_P from the given runs.

    Args:
        runs: tests of any kind, number and order. The row of the test in the table of test kinds states which
            parameters are taken from it.
        rig: masses, lengths and the uncertainties of gains and zeros. Its k, ζ, c and S_P are only start values.
        notify: called with one line of text before each fit.
        earlier: identification of some of these runs with the same rig. The fits of these runs are taken from it.
        setting: effort of every fit.
        without: rungs of the model ladders that are not used (identification.rungs.RUNGS).
    Raises:
        ValueError: a name in `without` is not a rung.
        NotIdentifiable: no run determines any parameter. The message lists the reasons.
    Source: docs/theory/identification.md.
    """
    work = _Work(rig, notify or (lambda _: None), setting, held_back(without), [], [], [])
    runs = _once_each(runs, work)
    given, runs = runs, _take_over(runs, earlier, work)
    work.warnings += [*assumed_remarks(rig.known.assumed), *missing_warnings(runs)]
    work.warnings += [f"{Path(run.source).name}: {each}" for run in runs for each in disagreements(run)]
    work.warnings += [
        f"{Path(run.source).name}: {remark}" for run in runs for remark in phase_remarks(run, turns(run.test))
    ]
    jumps = [(run, jump) for run in runs for jump in encoder_jumps(run.angle_time_s, run.angle_rad)]
    work.warnings += [f"{Path(run.source).name}: {jump.words}" for run, jump in jumps]
    work.warnings += skipped_tests(runs)
    plucked = runs_for("ring-down", runs)
    work.warnings += [f"{Path(run.source).name}: {each.sentence}" for run in plucked for each in loose_locks(run)]
    ring_downs, messages = fit_ring_downs(plucked, rig.physics.total_mass_kg, setting, work.notify, work.without)
    work.warnings += messages
    for found in ring_downs:
        work.add(found.run, found.fit, found.estimate, found.tests)
    for run in runs_for("passage", runs):
        _one(run, work, _run_up)
    work.estimates = sharing_terms(work.estimates, work.suspension_terms())
    for run in runs_for("spin-down", runs):
        _one(run, work, _spin_down)
    points = [r for r in runs_for("release", runs) if r.releases]
    # short transients first: the result of each improves the start values of the next
    for run in sorted(points, key=lambda r: r.angle_time_s[-1] if len(r.angle_time_s) else 0.0):
        _one(run, work, _release)
    _share_friction(work)
    work.warnings += _left_out(work.left_out)
    if not work.estimates:
        raise NotIdentifiable("no run gave any parameter: " + ("; ".join(work.warnings) or "there are no known tests"))
    return replace(_finished(given, work), witnesses=[agreement for run in given for agreement in run.agreements()])


def _once_each(runs: Sequence[Run], work: _Work) -> list[Run]:
    """Drop repeated recordings: a log that is given twice would count as two independent tests."""
    found: dict[str, Run] = {}
    for run in runs:
        digest = str(run.metadata.get("digest") or id(run))
        if digest in found:
            first = Path(found[digest].source).name
            work.warnings.append(f"{Path(run.source).name}: the same recording as {first}; taken once")
        found.setdefault(digest, run)
    return list(found.values())


def _take_over(runs: Sequence[Run], earlier: Identification | None, work: _Work) -> list[Run]:
    """Copy the results of runs that an earlier identification contains. Return the other runs."""
    if earlier is None:
        return list(runs)
    wanted = {run.source for run in runs}
    work.estimates += [e.with_sources(()) for e in earlier.estimates if wanted.issuperset(e.sources)]
    work.fits += [f for f in earlier.fits if wanted.issuperset(f.sources)]
    done = {source for e in work.estimates for source in e.sources}
    names = {Path(source).name for source in done} | {log_names(e.sources) for e in work.estimates}
    work.warnings += [w for w in earlier.warnings if w.partition(":")[0] in names]
    return [run for run in runs if run.source not in done]


def _one(run: Run, work: _Work, fit: Callable[[Run, _Work], tuple[Fit, Estimate]]) -> None:
    """Fit one run. A failed fit becomes a warning."""
    work.notify(f"{run.test}: fitting {Path(run.source).name}")
    try:
        work.add(run, *fit(run, work))
    except ReleaseLeftOut as error:
        work.left_out.append((run.test, error))
    except IdentificationError as error:
        work.warnings.append(f"{run.test} left out: {error}")


def _run_up(run: Run, work: _Work) -> tuple[Fit, Estimate]:
    if not (len(run.x_time_s) and len(run.y_time_s)):
        raise NotIdentifiable(f"{run.source}: it holds no laser {'y' if len(run.x_time_s) else 'x'}")
    if not np.isfinite(run.angle_rad).all():  # one pendulum was not recorded
        run = replace(run, angle_time_s=np.empty(0), angle_rad=np.empty((0, 2)))
    if not len(run.angle_rad):
        work.warnings.append(f"{Path(run.source).name}: no angles of both pendulums; taken as locked at 0° and 180°")
    if loose := loose_locks(run):
        raise NotIdentifiable(f"{run.source}: {'; '.join(each.sentence for each in loose)}")
    terms = work.suspension_terms().terms
    known = known_suspension(work.knowledge().physics, terms, work.axis_angle_deg - run.turn_deg)
    fit = fit_run_up_run(run, setting=work.setting, known=known, without=work.without)
    fit = as_mounted(fit, run.turn_deg)
    gains = work.rig.roles.gain_stds
    estimate = run_up_estimate(run, fit, work.rig.physics, gains)
    estimate, messages = run_up_sides(run, fit, estimate, work.rig, gains)
    work.warnings += messages
    return fit, estimate


def _spin_down(run: Run, work: _Work) -> tuple[Fit, Estimate]:
    fit = fit_spin_down_run(run, work.knowledge(), setting=work.setting, without=work.without)
    return fit, damping_estimate(run, fit, "coupled run-down of both pendulums, nonlinear least squares")


def _share_friction(work: _Work) -> None:
    """Recompute each transient's damping with the joint friction. A single transient keeps its undecided friction."""
    fits = work.transients
    zero_std = math.radians(work.rig.roles.zero_std_deg)
    work.estimates, shared = with_shared_friction(work.estimates, fits, zero_std, work.sources)
    undecided = [f"{log_names(logs)}: {fit.undecided}" for logs, fit in fits.items() if fit.undecided]
    work.warnings = [w for w in work.warnings if w not in undecided]
    work.warnings += undecided if shared is None else friction_messages(shared)


def _release(run: Run, work: _Work) -> tuple[Fit, Estimate]:
    zero_std = math.radians(work.rig.roles.zero_std_deg)
    name = Path(run.source).name

    def notify(text: str) -> None:
        work.notify(f"{run.test}: {name}: {text}")

    def fitted(known: Knowledge) -> TransientFit:
        return fit_release(
            run, known, zero_std, setting=work.setting, notify=notify, effort=work.effort, without=work.without
        )

    dragged = work.dragged()
    if dragged is None:
        fit = fitted(work.knowledge())
    else:
        try:
            fit, work.reading = fitted(dragged), "drag"
        except FitFailed:
            if work.reading:
                raise
            fit, work.reading = fitted(work.knowledge()), "contact"
    method = "transient after release, nonlinear least squares over growing horizons"
    return fit, damping_estimate(run, fit, method, zero_std)


def _finished(runs: Sequence[Run], work: _Work) -> Identification:
    # each fit takes the known numbers as exact; their uncertainty is added to all estimates together
    work.estimates = [e.with_sources(work.sources) for e in work.estimates]
    work.estimates, drifts = with_drift(work.estimates)
    parameters, rows, warnings = combine(work.estimates)
    warnings += drifts
    parameters, messages = physical_parameters(parameters, work.rig)
    warnings += messages
    missing = [n for n in PARAMETER_UNITS if n not in parameters.values]
    to_record = ""
    if missing:
        to_record = advice(missing, runs, work.rig.roles)
        warnings.append(f"not identified: {', '.join(missing)}; {to_record}")
    drag = work.drag
    torques = {**kept_friction(work.friction(), work.open_friction()), **(drag.drag.table if drag else {})}
    facts = _provenance(runs, work, rows, torques)
    if drag is not None:
        own = dict(zip(parameters.values, np.sqrt(np.diag(parameters.own_covariance)).tolist(), strict=True))
        shifts = drag.shifts(parameters.values, own)
        parameters = replace(parameters, shared={**shifts, **parameters.shared})
    angle, std = _axis_angle(work.fits)
    warnings += mounting_remarks((angle, std), (runs[0].turn_deg, work.rig.roles.mounted_deg[1]))
    digests = {(r.source,): str(r.metadata.get("digest", "")) for r in runs}
    slow_roll, messages = work.slow_roll(digests)
    warnings += messages
    terms = work.suspension_terms(digests).terms
    found = Identification(
        replace(
            parameters,
            provenance=facts,
            axis_angle_deg=_known(angle, std),
            slow_roll=slow_roll,
            terms=terms if np.any(terms.covariance) else None,
        ),
        angle,
        std,
        work.estimates,
        work.fits,
        rows,
        work.warnings + warnings,
        to_record=to_record,
    )
    return replace(found, parameters=with_tests(found, runs))


def _known(angle_deg: float, std_deg: float) -> tuple[float, float] | None:
    return (angle_deg, std_deg) if math.isfinite(angle_deg) and math.isfinite(std_deg) else None


def _left_out(releases: list[tuple[str, ReleaseLeftOut]]) -> list[str]:
    """Messages: one for each release that the model does not reproduce, and one with a common cause."""
    if not releases:
        return []
    messages = [f"{test} left out: {error}" for test, error in releases]
    named = {test: error.causes for test, error in releases if error.causes}
    if named:
        which = "; ".join(f"{test}: {' or '.join(causes)}" for test, causes in named.items())
        messages.append(f"a likely cause is one number of the rig file; it would explain {which}. Weigh and measure it")
    else:
        messages.append(
            "no single mass, length or encoder scale explains the releases left out: look whether A and B are swapped, "
            "at the speed's marks and at what may have touched a pendulum"
        )
    return messages


def _provenance(
    runs: Sequence[Run], work: _Work, rows: list[ConsistencyRow], torques: Mapping[str, Any]
) -> dict[str, Any]:
    digests = _digests(runs, work.estimates)
    friction = {f.sources: f.fit.friction for f in work.fits if isinstance(f.fit, TransientFit) and f.fit.friction}
    tests = [
        {
            "test": e.test,
            "log": log_names(e.sources),
            **({"digest": digests[e.sources]} if digests[e.sources] else {}),
            "method": e.method,
            "values": {n: float(v) for n, v in zip(e.names, e.values, strict=True)},
            "std": e.std,
            **(
                {"friction": friction[e.sources].values, "friction_std": friction[e.sources].std}
                if e.sources in friction
                else {}
            ),
        }
        for e in work.estimates
    ]
    consistency = [
        {"parameter": r.parameter, "test": r.test, "z": r.z, "chi2": r.chi2, "dof": r.dof, "p": r.p} for r in rows
    ]
    facts: dict[str, Any] = {"method": "generalised least squares over per-test fits", "tests": tests}
    if work.without:
        facts["without"] = sorted(work.without)
    return {**facts, "consistency": consistency, **torques}


def _digests(runs: Sequence[Run], estimates: Sequence[Estimate]) -> dict[Sources, str]:
    """Digest of each estimate's logs, joined if several were fitted together; "" if one of them is not known."""
    known = {r.source: str(r.metadata.get("digest", "")) for r in runs}
    digests = {e.sources: [known.get(source, "") for source in e.sources] for e in estimates}
    return {sources: joined(of) if all(of) else "" for sources, of in digests.items()}


def _axis_angle(fits: list[NamedFit]) -> tuple[float, float]:
    """Weighted mean of the axis angles of ring-downs and run-ups, and its standard uncertainty, deg."""
    found = [
        (f.fit.values["axis_angle_deg"], f.fit.std["axis_angle_deg"]) for f in fits if "axis_angle_deg" in f.fit.values
    ]
    if not found:
        return float("nan"), float("nan")
    weight = np.array([1 / s**2 for _, s in found])
    return float(weight @ [v for v, _ in found] / weight.sum()), float(weight.sum() ** -0.5)
