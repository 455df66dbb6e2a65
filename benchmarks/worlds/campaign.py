"""One campaign on one world: recorded, identified, validated, held against the truth.

`identified` and `validated` are the only places that call the suite under test.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from analysis.explanations import Explanations
from analysis.validation import Validation, validate
from benchmarks.worlds.recording import BEFORE_POINTS, LONGEST_S, campaign_tests, record
from benchmarks.worlds.world import WRONG, Effects, Spread, World, draw_world
from daq.signals.run import Run
from identification import Identification, identify
from identification.release_check import check_releases, check_run_ups
from rig_configs.schema import Rig

UNSTATED_STD = 5e-4
"""Relative standard uncertainty of masses and lengths: a rig file states none, a laboratory's balance gives this."""
_ANOTHER = 10**9  # to the seed: the further run-up has noise of its own
_ROUTINE = re.compile(r"by itself it does not exclude dry friction")
_NAMED = {
    "cubic": r"amplitude-dependent|stiffness (rises|falls|grows|changes)|harden|soften|cubic",
    "quadratic": r"amplitude-dependent|damping (rises|falls|grows|changes)|quadratic",
    "dry": r"dry friction",
    "contact": r"dry friction",
    "drag": r"\bair\b|drag|quadratic|not purely viscous",
    "bow_m": r"\bbow|bent|run-?out",
    "runout_m": r"\bbow|bent|run-?out",
    "hum_m": r"\bhum\b|mains|50(\.\d+)? ?Hz",
    "wander_m": r"wander|drift|coloured|1/f|low frequenc",
    "creep_rpm": r"rotor (may )?(move|creep|turn)",
    "phase_step_deg": r"phase.*(step|coarse)",
    "speed_noise_rpm": r"speed.*nois|phase.*(nois|speed)",
    "turned_deg": r"sensors? stand|turned|axis angle",
    "noise_m": r"nois",
    "gaps": r"gap|lost|missing",
}
"""Words in a warning that name an effect."""


@dataclass(frozen=True)
class Plan:
    """What every campaign of a series has.

    Attributes:
        spread, effects: of the worlds.
        wrong, by: a number off by so many standard deviations; "" for none.
        joint: identify once more with the points' releases.
        run_up_after: record a further run-up after the points, to be validated with them.
    """

    spread: Spread
    effects: Effects
    wrong: str = ""
    by: float = 5.0
    joint: bool = False
    run_up_after: bool = False


def identified(runs: Sequence[Run], rig: Rig, earlier: Identification | None = None) -> Identification:
    """The suite's parameters."""
    return identify(runs, rig, earlier=earlier)


def validated(runs: Sequence[Run], rig: Rig, found: Identification) -> Validation:
    """The suite's verdicts on the points."""
    known = found.parameters
    held = [*check_releases(runs, rig, known), *check_run_ups(runs, rig, known)]
    return validate(runs, rig, known, releases=held)


def campaign(seed: int, plan: Plan) -> dict[str, Any]:
    """One campaign as a JSON object: truth, parameters, z, points, warnings, seconds; "error" where it broke off."""
    began = time.perf_counter()
    world = draw_world(seed, plan.spread, plan.effects)
    if plan.wrong and not WRONG[plan.wrong]:
        world = world.changed(plan.wrong, plan.by * _stated_std(world, plan.wrong))
    before = [record(world, seed, test) for test in BEFORE_POINTS]
    row: dict[str, Any] = {
        "seed": seed,
        "truth": world.truth,
        "effects": asdict(plan.effects),
        "wrong": plan.wrong,
        "by": plan.by if plan.wrong else 0.0,
    }
    seconds = {"data": time.perf_counter() - began}
    try:
        started = time.perf_counter()
        found = identified(before, world.rig)
        seconds["identification"] = time.perf_counter() - started
        row |= _estimates(found, world)
        later = world
        if plan.wrong and (name := WRONG[plan.wrong]):
            later = world.changed(plan.wrong, plan.by * found.parameters.std[name])
        started = time.perf_counter()
        points = {
            test.removeprefix("point-"): record(later, seed, test)
            for test in campaign_tests(world)
            if test not in BEFORE_POINTS
        }
        after = [_further_run_up(later, seed)] if plan.run_up_after else []
        seconds["data"] += time.perf_counter() - started
        started = time.perf_counter()
        judged = validated([*points.values(), *after], world.rig, found)
        late = [name for name, point in judged.points.items() if point.verdict == "not settled"]
        if late:  # a guided test records on
            points |= {name: record(later, seed, f"point-{name}", LONGEST_S) for name in late}
            started = time.perf_counter()
            judged = validated([*points.values(), *after], world.rig, found)
        row |= _judged(judged)
        row["warnings"] = [*row["warnings"], *judged.warnings]
        seconds["validation"] = time.perf_counter() - started
        if plan.joint:
            started = time.perf_counter()
            row["joint"] = _estimates(identified([*before, *points.values()], world.rig, found), world)
            seconds["joint"] = time.perf_counter() - started
    except Exception as error:  # the series goes on after any error, and the summary shows it
        row["error"] = f"{type(error).__name__}: {error}"
    return row | {"seconds": seconds}


def _further_run_up(world: World, seed: int) -> Run:
    """A run-up that has identified nothing: with noise of its own, and a log of its own name."""
    run = record(world, seed + _ANOTHER, "run-up")
    return replace(run, source=run.source.replace("run-up", "run-up-after"))


def named_effects(effects: Effects) -> list[str]:
    """Names of all that is not as on a usual rig."""
    usual, given = asdict(Effects()), asdict(effects)
    return [name for name in given if given[name] != usual[name]]


def names_effect(warning: str, effects: Effects) -> bool:
    """Whether a warning names one of the effects; one that every campaign has does not."""
    patterns = [_NAMED[name] for name in named_effects(effects) if name in _NAMED]
    return not is_routine(warning) and any(re.search(p, warning, re.IGNORECASE) for p in patterns)


def is_routine(warning: str) -> bool:
    """Whether a warning is that of every campaign: a spin-down alone does not separate friction from damping."""
    return bool(_ROUTINE.search(warning))


def _stated_std(world: World, name: str) -> float:
    """Standard uncertainty of what is not identified, SI; of a gain relative."""
    b, roles, known = world.mechanics.b, world.rig.roles, world.rig.known
    return {
        "mass_b": known.std("pendulums.b.mass_kg") or UNSTATED_STD * b.mass_kg,
        "length_b": known.std("pendulums.b.length_m") or UNSTATED_STD * b.length_m,
        "zero_a": math.radians(roles.zero_std_deg),
        "gain_x": roles.gain_stds[0],
    }[name]


def _estimates(found: Identification, world: World) -> dict[str, Any]:
    parameters, truth = found.parameters, world.truth
    shown = {n: (value, parameters.std[n]) for n, value in parameters.values.items()}
    axis = math.degrees(world.axis_rad)
    return {
        "parameters": {n: value for n, (value, _) in shown.items()},
        "std": {n: std for n, (_, std) in shown.items()},
        "z": {n: (value - truth[n]) / std for n, (value, std) in shown.items()},
        "axis": {"found_deg": found.axis_angle_deg, "std_deg": found.axis_angle_std_deg, "true_deg": axis},
        "warnings": found.warnings,
    }


def _causes(explained: Explanations) -> list[list[str]]:
    """Names of the likeliest explanations' causes, the likeliest first."""
    ranked = [e for e in (*explained.singles, *explained.pairs) if e.explained] or list(explained.singles)
    return [[cause.name for cause in one.causes] for one in ranked[:5]]


def _judged(validation: Validation) -> dict[str, Any]:
    return {
        "passed": validation.passed,
        "together": None if validation.agreement is None else validation.agreement.together.to_json(),
        "causes": [] if validation.explanations is None else _causes(validation.explanations),
        "points": {
            name: {"state": p.state, "verdict": p.verdict, "why": p.why, "z": dict(p.z_scores)}
            for name, p in validation.points.items()
        },
    }
