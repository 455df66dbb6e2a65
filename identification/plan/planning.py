"""Selection of the experiments, their settings and their number of runs that reach the required uncertainties.

For each requirement the cheapest candidate experiment that reaches it is selected. The cost is the time of recording
and preparation. Experiments that are already selected for another requirement are used first. If no number of runs
reaches a requirement, the answer states the limiting error: gain, clock or mass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from daq.signals.threads import on_one_thread
from identification.errors import NotIdentifiable
from identification.methods import Method
from identification.plan.experiment import Experiment, together
from identification.plan.offers import offers_for
from identification.plan.requirements import Requirement
from identification.plan.sensors import SensorProperties
from rig_basics.tabular import Column, Tabular
from rig_configs.schema import Rig

MOST_RUNS = 25
"""Largest number of runs of one experiment in a plan."""
_OVERHEAD_S: Mapping[Method, float] = {"ring-down": 10.0, "spin-down": 15.0, "passage": 20.0, "release": 60.0}
"""Time of a test in addition to its recording, s."""


@dataclass(frozen=True)
class Step:
    """An experiment of the plan.

    Attributes:
        experiment: test with its settings.
        runs: number of runs.
        wanted_for: names of the required parameters that the experiment was selected for.
    """

    experiment: Experiment
    runs: int
    wanted_for: tuple[str, ...]


@dataclass(frozen=True)
class PlanAnswer:
    """Result of a plan for one requirement.

    Attributes:
        want: requirement.
        believed: nominal value of the parameter, in its unit.
        wanted: required relative standard deviation.
        reached: relative standard deviation of the whole plan, errors of the masses included.
        possible: whether the plan reaches the requirement with these sensors.
        best: best single run of every kind of test, as (experiment, relative standard deviation).
        floor: relative standard deviation after MOST_RUNS runs of the best experiment, errors of the masses included.
        limited_by: largest part of that floor: "gain", "clock", "known", "mass", or "noise" if more runs would help.
            "no test" if no test of the rig shows the parameter.
    """

    want: Requirement
    believed: float
    wanted: float
    reached: float
    possible: bool
    best: list[tuple[Experiment, float]]
    floor: float
    limited_by: str


@dataclass(frozen=True)
class ExperimentPlan(Tabular):
    """Experiments to record and their expected results.

    Attributes:
        steps: experiments in the order of execution.
        answers: one result per requirement.
        record_s: recording time of all steps, s.
        sensors: sensor properties that the plan is based on.
        assumptions: assumptions and omissions, as sentences.
    """

    steps: list[Step]
    answers: list[PlanAnswer]
    record_s: float
    sensors: SensorProperties
    assumptions: list[str] = field(default_factory=list[str])

    @property
    def remarks(self) -> list[str]:
        """The assumptions."""
        return self.assumptions

    @property
    def heading(self) -> str:
        """The experiments and their time."""
        steps = ", ".join(f"{step.runs} × {step.experiment.test}" for step in self.steps)
        return f"{steps}: {self.record_s:.4g} s of recording"

    def columns(self) -> Mapping[str, Column]:
        """Return the wanted and the reached relative standard deviation of each parameter."""
        return {
            "parameter": [answer.want.name for answer in self.answers],
            "wanted": [answer.wanted for answer in self.answers],
            "reached": [answer.reached for answer in self.answers],
            "possible": [answer.possible for answer in self.answers],
            "limited_by": [answer.limited_by for answer in self.answers],
        }

    @property
    def possible(self) -> bool:
        """Whether every requirement is reached."""
        return all(a.possible for a in self.answers)


@on_one_thread
def plan_experiments(
    rig: Rig,
    requirements: Sequence[Requirement],
    sensors: SensorProperties | None = None,
    mass_std: float = 0.0,
    notify: Callable[[str], None] = lambda _: None,
) -> ExperimentPlan:
    """Plan the experiments for the required uncertainties.

    Args:
        rig: rig file whose k, ζ, c and S_P are the nominal values. Identified values should be applied to it first.
        requirements: required standard deviations, each parameter once.
        sensors: sensor properties measured in a log; None selects those of the rig file.
        mass_std: relative standard uncertainty of the masses, a lower bound of that of k, c and S_P.
        notify: called with one line of text before each kind of test.
    Raises:
        NotIdentifiable: `requirements` is empty, a parameter occurs twice, or its nominal value is 0.
    Source: docs/theory/planning.md.
    """
    sensors = sensors or SensorProperties.of(rig)
    nominal = rig.physics.identified()
    names = [w.name for w in requirements]
    if not names or len(set(names)) < len(names):
        raise NotIdentifiable(
            f"expected each required parameter once and at least one, got {', '.join(names) or 'none'}; for example "
            "zeta1=1%"
        )
    absent = [n for n in names if not nominal[n] > 0]
    if absent:
        raise NotIdentifiable(f"{', '.join(absent)} is 0 in the rig file; set an estimate above 0")
    remarks: list[str] = []
    offers = list(offers_for(rig, sensors, names, notify, remarks))
    steps = _chosen(offers, requirements, nominal, mass_std)
    reached = together([(s.experiment, s.runs) for s in steps]) if steps else {}
    answers = [_answer(w, nominal[w.name], offers, reached, mass_std) for w in requirements]
    seconds = sum(s.runs * s.experiment.record_s for s in steps)
    remarks += list(dict.fromkeys(r for s in steps for r in s.experiment.remarks))
    return ExperimentPlan(steps, answers, seconds, sensors, remarks)


def _chosen(
    offers: Sequence[Experiment], requirements: Sequence[Requirement], nominal: dict[str, float], mass_std: float
) -> list[Step]:
    """Select the cheapest experiments, the most expensive requirement first; each selection counts for the others."""
    steps: list[Step] = []
    order = sorted(requirements, key=lambda w: -_cheapest(offers, w, nominal, mass_std)[2])
    for want in order:
        target = _target(want, nominal, mass_std)
        reached = together([(s.experiment, s.runs) for s in steps]) if steps else {}
        if reached.get(want.name, math.inf) <= target:
            index = next(i for i, s in enumerate(steps) if want.name in s.experiment.expected.names)
            step = steps[index]
            steps[index] = Step(step.experiment, step.runs, (*step.wanted_for, want.name))
            continue
        experiment, runs, _ = _cheapest(offers, want, nominal, mass_std)
        if experiment is None:
            continue
        steps.append(Step(experiment, runs, (want.name,)))
    needed = _without_redundant_steps(steps, requirements, nominal, mass_std)
    return sorted(needed, key=lambda s: s.experiment.test)


def _without_redundant_steps(
    steps: list[Step], requirements: Sequence[Requirement], nominal: dict[str, float], mass_std: float
) -> list[Step]:
    """Return the steps without those that a later selection has made unnecessary."""
    for step in list(steps):
        rest = [s for s in steps if s is not step]
        reached = together([(s.experiment, s.runs) for s in rest]) if rest else {}
        if all(
            reached.get(w.name, math.inf) <= _target(w, nominal, mass_std)
            for w in requirements
            if w.name in step.wanted_for
        ):
            for name in step.wanted_for:
                i = next(i for i, s in enumerate(rest) if name in s.experiment.expected.names)
                rest[i] = Step(rest[i].experiment, rest[i].runs, tuple(dict.fromkeys((*rest[i].wanted_for, name))))
            steps = rest
    return steps


def _target(want: Requirement, nominal: dict[str, float], mass_std: float) -> float:
    """Return the part of a required relative standard deviation that remains for the sensors; 0 if masses exceed it."""
    wanted = want.relative_std(nominal[want.name])
    mass = 0.0 if want.name.startswith("zeta") else mass_std
    return math.sqrt(max(wanted**2 - mass**2, 0.0))


def _cheapest(
    offers: Sequence[Experiment], want: Requirement, nominal: dict[str, float], mass_std: float
) -> tuple[Experiment | None, int, float]:
    """Return the cheapest experiment, its number of runs and its time in s; None, 0 and inf if none is sufficient."""
    target = _target(want, nominal, mass_std)
    best: tuple[Experiment | None, int, float] = (None, 0, math.inf)
    for offer in offers:
        if want.name not in offer.expected.names or offer.floor(want.name) >= target:
            continue
        share = offer.noise(want.name) ** 2 / (target**2 - offer.floor(want.name) ** 2)
        runs = max(1, math.ceil(share * (1 - 1e-9)))
        seconds = runs * (offer.record_s + _OVERHEAD_S[offer.method])
        if runs <= MOST_RUNS and seconds < best[2]:
            best = (offer, runs, seconds)
    return best


def _answer(
    want: Requirement, nominal: float, offers: Sequence[Experiment], reached: dict[str, float], mass_std: float
) -> PlanAnswer:
    having = [o for o in offers if want.name in o.expected.names]
    mass = 0.0 if want.name.startswith("zeta") else mass_std
    wanted = want.relative_std(nominal)
    best: dict[str, tuple[Experiment, float]] = {}
    for offer in having:
        kept = best.get(offer.test)
        if kept is None or offer.relative_std(want.name) < kept[1]:
            best[offer.test] = (offer, offer.relative_std(want.name))
    lowest = min(having, key=lambda o: o.relative_std(want.name, MOST_RUNS), default=None)
    least = math.inf if lowest is None else math.hypot(lowest.relative_std(want.name, MOST_RUNS), mass)
    got = math.hypot(reached.get(want.name, math.inf), mass)
    return PlanAnswer(
        want,
        nominal,
        wanted,
        got,
        got <= wanted * (1 + 1e-9),
        sorted(best.values(), key=lambda pair: pair[1]),
        least,
        "no test" if lowest is None else _main_limit(lowest, want.name, mass),
    )


def _main_limit(experiment: Experiment, name: str, mass: float) -> str:
    """Return the name of the largest part of the variance after MOST_RUNS runs."""
    i = experiment.expected.names.index(name)
    value = abs(float(experiment.expected.values[i]))
    parts = {"mass": mass**2, "noise": experiment.noise(name) ** 2 / MOST_RUNS}
    for label, shift in experiment.expected.shared.items():
        kind = label.kind if label.kind in ("clock", "known") else "gain"
        parts[kind] = parts.get(kind, 0.0) + (float(shift[i]) / value) ** 2
    return max(parts, key=lambda k: parts[k])
