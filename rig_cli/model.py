"""`rig predict`: results of the model alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_basics.units import TO_RPM
from rig_cli.console import notify, print_json, show, wait_for_compilation
from rig_cli.last_sentence import predict_sentence
from rig_cli.numbers import Positive
from rig_cli.option_groups import MODEL, OUTPUT, QUESTIONS
from rig_cli.options import Force, Json, ParametersPath, RigFile, Settings, check_outputs, warn_of_filled, what_if_words
from rig_cli.rest_points import report_balancing, report_lost
from rig_cli.share_progress import share_progress
from rig_cli.slow_roll_page import forced_region, shown_json, shown_line
from rig_cli.speed import NO_SPEED, SpeedChoice
from rig_cli.start_ups_page import start_ups_json, start_ups_lines
from rig_configs import IdentifiedParameters, Rig, RigFileError, load_rig

if TYPE_CHECKING:
    from dynamics.equations.parameters import RotorParameters
    from dynamics.steady.outcome import ReleaseOutcome
    from dynamics.steady.steady_state import SteadyState, SteadyStates

Plot = Annotated[Path | None, Parameter(name="--plot", group=OUTPUT, help="write a figure: .svg, .png or .pdf")]
Sweep = Annotated[
    str | None,
    Parameter(
        name="--sweep",
        help="KEY=A:B:N or KEY=A:B:N:log: follow the states along a number of the rig file or speed_ratio, find where "
        "another type becomes the stable one, as imbalance.radius_m=0:0.1:200",
    ),
]
Accuracy = Annotated[
    Positive, Parameter(help="wanted error of the largest multiplier, of angles (rad), of amplitudes (relative)")
]
AccuracyOrNone = Annotated[
    Positive | None,
    Parameter(
        help="wanted error of the largest multiplier, of angles (rad), of amplitudes (relative); without it 1e-8, and "
        "1e-6 where the suspension's damping grows with its speed"
    ),
]


@Parameter(name="*", group=MODEL)
@dataclass(frozen=True)
class PredictModel:
    """Accuracy and model of a prediction.

    Attributes:
        accuracy: see `AccuracyOrNone`.
        at_least: name of the smallest model to be used; None: the smallest that is exact.
    """

    accuracy: AccuracyOrNone = None
    at_least: Annotated[str | None, Parameter(name="--model", help="take a bigger model than needed")] = None


@Parameter(name="*", group=QUESTIONS)
@dataclass(frozen=True)
class PredictQuestions:
    """Results besides the steady states, or instead of them.

    Attributes:
        release: whether a release is followed.
        balancing: whether the balancing region is shown instead.
        lost: whether the speeds without singular points are shown instead.
        start_ups: number of start-ups to be followed; None: none.
        sweep: axis along which the states are followed instead; None: one speed.
    """

    release: Annotated[bool, Parameter(help="follow a release from 0° and 180° to where it ends")] = True
    balancing: Annotated[
        bool, Parameter(negative="", help="what the pendulums can balance: region, margins of S_P, centre of gravity")
    ] = False
    lost: Annotated[bool, Parameter(negative="", help="speeds at which singular points of Types II, III are lost")] = (
        False
    )
    start_ups: Annotated[
        int | None,
        Parameter(help="follow so many start-ups from rest, pendulums or balls free; --plot then draws them"),
    ] = None
    sweep: Sweep = None


_DEFAULT_MODEL, _STEADY_STATES = PredictModel(), PredictQuestions()


def predict(
    rig: RigFile,
    *,
    speed: SpeedChoice = NO_SPEED,
    model: PredictModel = _DEFAULT_MODEL,
    questions: PredictQuestions = _STEADY_STATES,
    parameters: ParametersPath = None,
    settings: Settings = None,
    plot: Plot = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Predict steady states, stability and amplitudes, and where a release ends.

    The speed is that of a point, or is given. --balancing and --lost need no speed. With --parameters all effects
    of the parameters file are included (a bow, drag, a suspension that depends on the motion), and the sensors'
    amplitudes include run-out.

    --sweep reports the stable range of each type, angles, amplitudes, and break points to a millionth. With
    --speed-ratio or --point each changed rig turns at that ratio of its own natural frequency, with --speed-rpm all at
    one speed. --balancing reports the region of the pendulum set (properly oversized, undersized, improperly
    oversized), S_P to its borders, possible centres of gravity and balanced angles in the plane of S_A and S_B;
    uncertainties of masses and lengths, or of S_P, give the region a probability. --lost reports speeds without a
    singular point of Types II and III; there, and close above a resonance, pendulums may slip.
    --model "periodic over a whole revolution" computes with a larger model, for comparison.

    Example: `rig predict my.toml --point B`
    """
    check_outputs("rig predict: --plot", plot, force=force)
    known = IdentifiedParameters.load(parameters) if parameters else IdentifiedParameters({}, np.zeros((0, 0)))
    changes = settings or []
    if questions.sweep is not None:
        from rig_cli.predict_sweep import predict_sweep

        if model.at_least is not None:
            raise RigFileError("rig predict: --model goes with one point or speed, not with --sweep")
        return predict_sweep(rig, questions.sweep, known, changes, speed, model.accuracy or 1e-8, plot, json=json)
    loaded = load_rig(rig, known, changes)
    warn_of_filled(known, loaded, changes)
    if questions.balancing or questions.lost:
        if (questions.balancing and questions.lost) or speed.count:
            raise RigFileError("rig predict: give --balancing or --lost alone, without a point or a speed")
        return (report_balancing if questions.balancing else report_lost)(loaded, known, changes, plot, json)
    found = _predicted(loaded, known, speed.rad_s("rig predict", loaded), model, questions.release)
    result = _result(found, known, questions.start_ups, changes, plot)
    if json:
        print_json(result)
        return 0
    _print(result, found.states)
    for line in start_ups_lines(result["start_ups"]) if result["start_ups"] else []:
        print(line)
    for line in known.slow_roll.sentences if known.slow_roll else []:
        print(line)
    if settings:
        print(what_if_words(settings))
    show(predict_sentence(result))
    return 0


@dataclass(frozen=True)
class _Prediction:
    """Steady states at one speed, and ends of releases.

    Attributes:
        rig: the rig file.
        physics: its parameters with all effects.
        speed_rad_s: the rotor's.
        states: the steady states.
        outcomes: ends of releases within the play; empty if none was followed.
        model, why: the model, and the reason for it.
    """

    rig: Rig
    physics: RotorParameters
    speed_rad_s: float
    states: SteadyStates
    outcomes: list[ReleaseOutcome]
    model: str
    why: str


def _predicted(
    rig: Rig, known: IdentifiedParameters, speed_rad_s: float, model: PredictModel, release: bool
) -> _Prediction:
    with wait_for_compilation("dynamics"):
        from dynamics import choose_model, steady_states

        physics = known.with_effects(rig.physics)
        accuracy, at_least = model.accuracy or _accuracy_of(physics), model.at_least
        states = steady_states(physics, speed_rad_s, accuracy, at_least=at_least)
        outcomes = _released(physics, speed_rad_s, states) if release else []
    chosen = states[0].model if states else choose_model(physics, at_least=at_least)
    return _Prediction(rig, physics, speed_rad_s, states, outcomes, chosen.name, chosen.why)


def _result(
    found: _Prediction, known: IdentifiedParameters, start_ups: int | None, settings: list[str], plot: Path | None
) -> dict[str, Any]:
    """Write the figure, if requested, and return the JSON."""
    physics, speed = found.physics, found.speed_rad_s
    outcome = found.outcomes[0] if found.outcomes else None
    started = None if start_ups is None else start_ups_json(found.rig, physics, speed, start_ups, plot)
    if plot is not None and started is None:
        _draw(plot, found, outcome, settings)
    return {
        "model": found.model,
        "why": found.why,
        "speed_ratio": speed / physics.natural_frequencies_rad_s[0],
        "speed_rpm": speed * TO_RPM,
        "balancing_region": forced_region(physics, speed),
        "slow_roll": known.slow_roll.table() if known.slow_roll else None,
        "steady_states": [_state_json(s, physics) | _shown(s, known, found.rig) for s in found.states],
        "unresolved": list(found.states.unresolved),
        "release": None if outcome is None else _outcome_json(outcome, physics),
        "releases_within_play": [_outcome_json(o, physics) for o in found.outcomes],
        "start_ups": started,
        "what_if": settings,
        "plot": None if plot is None else str(plot),
    }


def _draw(plot: Path, found: _Prediction, outcome: ReleaseOutcome | None, settings: list[str]) -> None:
    from analysis.figures.steady_states import draw_steady_states
    from analysis.figures.style import save

    ratio = found.speed_rad_s / found.physics.natural_frequencies_rad_s[0]
    rpm = found.speed_rad_s * TO_RPM
    title = f"{found.rig.name}, Ω = {ratio:.4g} ({rpm:.1f} rpm){what_if_words(settings, '; ')}"
    save(plot, draw_steady_states(found.physics, found.states, title, outcome))


def _shown(state: SteadyState, known: IdentifiedParameters, rig: Rig) -> dict[str, Any]:
    """Return the sensors' amplitudes, which differ from the motion's if there is run-out; else an empty table."""
    roll = known.slow_roll
    return {"sensors": shown_json(state, known, rig)} if roll and (roll.run_out_x_m or roll.run_out_y_m) else {}


def _accuracy_of(physics: RotorParameters) -> float:
    """Return the default accuracy: |v| v has kinks, which limit the accuracy of multipliers to about 1e-7."""
    return 1e-6 if any(physics.damping_growth_s_per_m) else 1e-8


def _released(physics: RotorParameters, speed: float, found: SteadyStates) -> list[ReleaseOutcome]:
    """Return the ends of releases within the locks' play; an empty list, with a message, without a locked motion."""
    from dynamics.errors import DynamicsError
    from dynamics.steady.outcome import releases_within_play

    if not (physics.a.present or physics.b.present):
        return []
    try:
        with share_progress("following a release until it settles") as progress:
            return releases_within_play(physics, speed, states=found, progress=progress)
    except DynamicsError as error:
        notify(f"no release followed: {error}")
        return []


def _angles_json(theta_rad: tuple[float, float], physics: RotorParameters) -> dict[str, float | None]:
    """Return θ3 and θ4 in degrees; None for a pendulum that the rig does not have."""
    there = (physics.a.present, physics.b.present)
    return {
        name: math.degrees(angle) if present else None
        for name, angle, present in zip(("theta3_deg", "theta4_deg"), theta_rad, there, strict=True)
    }


def _state_json(s: SteadyState, physics: RotorParameters) -> dict[str, Any]:
    out: dict[str, Any] = {
        "type": s.type,
        **_angles_json(s.theta_rad, physics),
        "any_angle": s.any_angle,
        "amplitude_mm": 1e3 * s.amplitude_m,
        "stable": s.stable,
        "stability": s.stability,
        "multiplier_max": s.multiplier_max,
        "error_estimate": s.error_estimate,
        "angle_error_deg": math.degrees(s.angle_error_rad),
        "amplitude_error_mm": 1e3 * s.amplitude_error_m,
        "method": s.method,
    }
    if any(s.stick_half_width_rad):
        out["stick_half_width_deg"] = [math.degrees(w) for w in s.stick_half_width_rad]
    return out


def _outcome_json(o: ReleaseOutcome, physics: RotorParameters) -> dict[str, Any]:
    out: dict[str, Any] = {
        "reaches": o.state,
        "from_deg": [math.degrees(angle) for angle in o.from_rad],
        **_angles_json(o.theta_rad, physics),
        "after_s": o.after_s,
        "revolutions": o.revolutions,
        "slip_turns": list(o.slip_turns),
        "same_end": o.same_end,
        "same_time": o.same_time,
        "seen": o.seen or None,
    }
    if o.slipping is not None:
        out["slip_turns_per_revolution"] = list(o.slipping.turns_per_revolution)
        out["slip_shrinkage"] = {"factor": o.slipping.shrinkage, "revolutions": o.slipping.judged}
    return out


def _print(result: dict[str, Any], found: list[SteadyState]) -> None:
    print(
        f"{result['speed_rpm']:.6g} rpm, speed ratio {result['speed_ratio']:.6g}; "
        f"pendulums {result['balancing_region']}"
    )
    print(f"model: {result['model']}: {result['why']}")
    for s in result["steady_states"]:
        print(
            f"  {s['type']:4} {s['stability']:9} {_angles(s)}  "
            f"amplitude {s['amplitude_mm']:.4f} mm  "
            f"multiplier {_near_one(s['multiplier_max'])} ± {s['error_estimate']:.1g}"
        )
        if "stick_half_width_deg" in s:
            bands = ("anywhere" if w >= 180 else f"within ± {w:.3g}°" for w in s["stick_half_width_deg"])
            print("       without dry friction, which can hold A and B " + ", ".join(bands))
        if "sensors" in s:
            print(shown_line(s["sensors"]))
    if not found:
        lost = "" if result["unresolved"] else ": the singular points are lost at this speed"
        print(f"  no steady motion found{lost}")
    for line in result["unresolved"]:
        print(f"  not in the list: {line}")
    methods = {s.method.split(":")[0]: s.method for s in reversed(found)}
    if methods:
        print("stability by " + "; by ".join(methods.values()))
    for line in _release_lines(result["releases_within_play"]):
        print(line)


def _angles(s: dict[str, Any], digits: int = 3) -> str:
    """Return both angles of a JSON entry, in columns."""
    shown: list[str] = []
    for name, angle in (("θ3", s["theta3_deg"]), ("θ4", s["theta4_deg"])):
        shown.append(f"{name}     none" if angle is None else f"{name} {angle:{5 + digits}.{digits}f}°")
    return " ".join(shown) + (" or any other, turned together" if s.get("any_angle") else "")


def _release_lines(releases: list[dict[str, Any]]) -> list[str]:
    """Return a line for each end of the releases within the play, with the number that reach it."""
    lines: list[str] = []
    for end, members in _by_end(releases).items():
        first = members[0]
        of = f"{len(members)} of {number_of(len(releases), 'release')}" if len(members) < len(releases) else "a release"
        begin = f"{of} from 0° and 180° (± 0.2° of play)"
        if end[0] == "not settled":
            lines.append(f"{begin}: {first['seen']}")
        elif end[0] == "slipping":
            a, b = first["slip_turns_per_revolution"]
            shrunk = first["slip_shrinkage"]
            lines.append(
                f"{begin}: slipping for ever, A {a:.4g} and B {b:.4g} turns per revolution: a stable slipping motion "
                f"(deviations shrink to {shrunk['factor']:.1g} in {number_of(shrunk['revolutions'], 'revolution')})"
            )
        elif end[0] == "held by friction":
            lines.append(f"{begin}: held by friction; followed for {number_of(first['revolutions'], 'revolution')}")
        else:
            about = "" if all(m["same_time"] for m in members) else "about "
            chance = "" if all(m["same_end"] for m in members) else "; which end a single release takes is chance"
            lines.append(
                f"{begin} reaches {end[0]} at {_angles(first, 2)} after {about}{first['after_s']:.1f} s{chance}"
            )
    return lines


def _by_end(releases: list[dict[str, Any]]) -> dict[tuple[str, ...], list[dict[str, Any]]]:
    """Group releases by the state and the angles they reach."""
    ends: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for r in releases:
        reached = r["reaches"] not in ("not settled", "slipping", "held by friction")
        key = (r["reaches"], _angles(r, 0)) if reached else (r["reaches"],)
        ends.setdefault(key, []).append(r)
    return ends


def _near_one(multiplier: float) -> str:
    """Return six digits, or the difference from 1 if six digits do not show it."""
    return f"{multiplier:.6f}" if abs(multiplier - 1) > 1e-4 else f"1 {multiplier - 1:+.3e}"
