"""Which experiments, with which settings and how often, reach what is wanted, and whether these sensors can.

For each want the cheapest test on offer that reaches it is taken (recording time, with what a test takes beside its
recording), tests already taken for another want first. What no number of runs reaches is stated with what stands in the
way: gain, clock, mass.
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
from identification.plan.sensors import Sensors
from identification.plan.wants import Want
from rig_configs.schema import Rig

MOST_RUNS = 25
_BESIDE_S: Mapping[Method, float] = {"ring-down": 10.0, "spin-down": 15.0, "passage": 20.0, "release": 60.0}
"""Seconds that a test takes beside its recording."""


@dataclass(frozen=True)
class Step:
    """An experiment of the plan, done so many times, and which wants it is for."""

    experiment: Experiment
    runs: int
    wanted_for: tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """What a plan says of one want.

    Attributes:
        want, believed: what is wanted, and the parameter's value as believed.
        wanted, reached: relative standard deviations; reached by the plan as a whole, masses included.
        possible: whether these sensors can.
        best: of every kind of test, the best single run: (test, relative standard deviation, its floor).
        floor: the lowest that any number of runs gives, masses included, relative.
        limited_by: what makes that floor, "gain", "clock", "mass", or "noise" where runs alone would help.
    """

    want: Want
    believed: float
    wanted: float
    reached: float
    possible: bool
    best: list[tuple[Experiment, float]]
    floor: float
    limited_by: str


@dataclass(frozen=True)
class Plan:
    """What to record.

    Attributes:
        steps: in the order of doing them.
        answers: one per want.
        record_s: recording time of all steps.
        sensors: what they were taken to be able to.
        remarks: what a reader must know.
    """

    steps: list[Step]
    answers: list[Answer]
    record_s: float
    sensors: Sensors
    remarks: list[str] = field(default_factory=list)

    @property
    def possible(self) -> bool:
        """Whether every want can be met."""
        return all(a.possible for a in self.answers)


@on_one_thread
def plan(
    rig: Rig,
    wants: Sequence[Want],
    sensors: Sensors | None = None,
    mass_std: float = 0.0,
    tell: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Plan the experiments for some wants.

    Args:
        rig: its k, ζ, c, S_P are what the parameters are believed to be; lay identified ones over it.
        wants: what is to be known, each parameter once.
        sensors: as measured in a log; None takes the rig file's.
        mass_std: relative standard uncertainty of the masses; k, c and S_P can never be known better.
        tell: told one line before each kind of test.
    Raises:
        NotIdentifiable: no want, a parameter wanted twice, or one that is 0 by the rig file.
    Source: docs/theory/planning.md.
    """
    sensors = sensors or Sensors.of(rig)
    believed = rig.physics.identified()
    names = [w.name for w in wants]
    if not names or len(set(names)) < len(names):
        raise NotIdentifiable("expected each wanted parameter once, at least one; for example --want zeta1=1%")
    nothing = [n for n in names if not believed[n] > 0]
    if nothing:
        raise NotIdentifiable(f"{', '.join(nothing)} is 0 by the rig file; give a guess of it with --set")
    remarks: list[str] = []
    offers = list(offers_for(rig, sensors, names, tell, remarks))
    steps = _chosen(offers, wants, believed, mass_std)
    reached = together([(s.experiment, s.runs) for s in steps]) if steps else {}
    answers = [_answer(w, believed[w.name], offers, reached, mass_std) for w in wants]
    seconds = sum(s.runs * s.experiment.record_s for s in steps)
    remarks += list(dict.fromkeys(r for s in steps for r in s.experiment.remarks))
    return Plan(steps, answers, seconds, sensors, remarks)


def _chosen(
    offers: Sequence[Experiment], wants: Sequence[Want], believed: dict[str, float], mass_std: float
) -> list[Step]:
    """The cheapest experiments; the hardest wants choose first, what they choose counts for the others."""
    steps: list[Step] = []
    order = sorted(wants, key=lambda w: -_cheapest(offers, w, believed, mass_std)[2])
    for want in order:
        target = _target(want, believed, mass_std)
        reached = together([(s.experiment, s.runs) for s in steps]) if steps else {}
        if reached.get(want.name, math.inf) <= target:
            index = next(i for i, s in enumerate(steps) if want.name in s.experiment.expected.names)
            step = steps[index]
            steps[index] = Step(step.experiment, step.runs, (*step.wanted_for, want.name))
            continue
        experiment, runs, _ = _cheapest(offers, want, believed, mass_std)
        if experiment is None:
            continue
        steps.append(Step(experiment, runs, (want.name,)))
    return sorted(_without_waste(steps, wants, believed, mass_std), key=lambda s: s.experiment.test)


def _without_waste(steps: list[Step], wants: Sequence[Want], believed: dict[str, float], mass_std: float) -> list[Step]:
    """Without experiments that a later choice has made unnecessary."""
    for step in list(steps):
        rest = [s for s in steps if s is not step]
        reached = together([(s.experiment, s.runs) for s in rest]) if rest else {}
        if all(
            reached.get(w.name, math.inf) <= _target(w, believed, mass_std) for w in wants if w.name in step.wanted_for
        ):
            for name in step.wanted_for:
                i = next(i for i, s in enumerate(rest) if name in s.experiment.expected.names)
                rest[i] = Step(rest[i].experiment, rest[i].runs, tuple(dict.fromkeys((*rest[i].wanted_for, name))))
            steps = rest
    return steps


def _target(want: Want, believed: dict[str, float], mass_std: float) -> float:
    """What is left for the sensors of a wanted relative standard deviation; 0 when the masses take it all."""
    wanted = want.relative_std(believed[want.name])
    mass = 0.0 if want.name.startswith("zeta") else mass_std
    return math.sqrt(max(wanted**2 - mass**2, 0.0))


def _cheapest(
    offers: Sequence[Experiment], want: Want, believed: dict[str, float], mass_std: float
) -> tuple[Experiment | None, int, float]:
    """The experiment, how often, and the seconds it takes; None and inf when none reaches it."""
    target, best = _target(want, believed, mass_std), (None, 0, math.inf)
    for offer in offers:
        if want.name not in offer.expected.names or offer.floor(want.name) >= target:
            continue
        share = offer.noise(want.name) ** 2 / (target**2 - offer.floor(want.name) ** 2)
        runs = max(1, math.ceil(share * (1 - 1e-9)))
        seconds = runs * (offer.record_s + _BESIDE_S[offer.method])
        if runs <= MOST_RUNS and seconds < best[2]:
            best = (offer, runs, seconds)
    return best


def _answer(
    want: Want, believed: float, offers: Sequence[Experiment], reached: dict[str, float], mass_std: float
) -> Answer:
    having = [o for o in offers if want.name in o.expected.names]
    mass = 0.0 if want.name.startswith("zeta") else mass_std
    wanted = want.relative_std(believed)
    best = {}
    for offer in having:
        kept = best.get(offer.test)
        if kept is None or offer.relative_std(want.name) < kept[1]:
            best[offer.test] = (offer, offer.relative_std(want.name))
    lowest = min(having, key=lambda o: o.relative_std(want.name, MOST_RUNS), default=None)
    least = math.inf if lowest is None else math.hypot(lowest.relative_std(want.name, MOST_RUNS), mass)
    got = math.hypot(reached.get(want.name, math.inf), mass)
    return Answer(
        want,
        believed,
        wanted,
        got,
        got <= wanted * (1 + 1e-9),
        sorted(best.values(), key=lambda pair: pair[1]),
        least,
        "no test" if lowest is None else _main_limit(lowest, want.name, mass),
    )


def _main_limit(experiment: Experiment, name: str, mass: float) -> str:
    """The largest of what is left after the most runs."""
    i = experiment.expected.names.index(name)
    value = abs(float(experiment.expected.values[i]))
    parts = {"mass": mass**2, "noise": experiment.noise(name) ** 2 / MOST_RUNS}
    for label, shift in experiment.expected.shared.items():
        kind = "clock" if label.startswith("clock") else "gain"
        parts[kind] = parts.get(kind, 0.0) + (float(shift[i]) / value) ** 2
    return max(parts, key=lambda k: parts[k])
