"""The corners of the domain of validity: is what dynamics answers true within the accuracy asked?

    uv run python benchmarks/dynamics_extremes.py --service multipliers --draws 2000 --seed 1 --accuracy 1e-8 [--json]

Draws parameters over the whole domain, calls one service and holds every answer against a reference: ball arithmetic
or heyoka where they are affordable, a second method at a tighter setting elsewhere. Prints what was answered, refused
and wrong; progress goes to standard error. The figures in docs/theory/domain.md come from here.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import time
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from dynamics import Pendulum, RotorParameters, Scene, SpeedHistory, multipliers, simulate, steady_states
from dynamics.bench import arb_peer, heyoka_peer
from dynamics.equations.linearised import type_one
from dynamics.errors import DynamicsError, NotConverged
from dynamics.motions.locked_motion import fastest_rate, locked_state
from dynamics.stability.floquet import floquet_multipliers

ARM_M = 0.054
_OTHER_METHODS = ("magnus", "explicit", "implicit", "chebyshev")
_MOST_TAYLOR_STEPS = 400_000
_MOST_RADIANS_80_BITS = 2000.0  # fastest rate × half a revolution of an orbit in 80 bits
_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
_PI = np.longdouble("3.14159265358979323846264338327950288")
Row = dict[str, Any]
_compiled: dict[str, Any] = {}


def draw(rng: np.random.Generator) -> tuple[RotorParameters, float, dict[str, Any]]:
    """Parameters, speed ratio and their description; properly oversized, borders to the last bit included."""

    def log(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    def maybe(share: float) -> bool:
        return bool(rng.random() < share)

    mass_a = log(1e-9, 7.0) if maybe(0.4) else 0.075
    mass_b = mass_a if maybe(0.5) else mass_a * log(0.2, 5.0)
    damping_a = 0.0 if maybe(0.1) else log(1e-8, 50.0)
    damping_b = damping_a if maybe(0.8) else log(1e-8, 50.0)
    ball = log(1e-4, 0.02) if maybe(0.15) else 0.0
    a, b = (Pendulum(m, ARM_M, c, ball_radius_m=ball) for m, c in ((mass_a, damping_a), (mass_b, damping_b)))
    s_a, s_b = a.first_moment_kg_m, b.first_moment_kg_m
    outer, inner = s_a + s_b, abs(s_a - s_b)
    places = {
        "inside": inner + rng.random() * (outer - inner),
        "S_A + S_B": outer,
        "S_A + S_B − 1 ulp": math.nextafter(outer, 0),
        "S_A + S_B + 1 ulp": math.nextafter(outer, math.inf),
        "|S_A − S_B|": inner,
        "|S_A − S_B| + 1 ulp": math.nextafter(inner, math.inf),
        "|S_A − S_B| − 1 ulp": math.nextafter(inner, 0),
        "near |S_A − S_B|": inner + outer * log(1e-18, 1e-2),
        "near S_A + S_B": outer * (1 - log(1e-16, 1e-2)),
    }
    place = str(rng.choice(list(places), p=[0.44, *[0.07] * 8]))
    isotropic = maybe(0.15)
    zeta1 = 0.0 if maybe(0.12) else log(1e-4, 2.0)
    zeta2 = zeta1 if isotropic else 0.0 if maybe(0.12) else log(1e-4, 2.0)
    ratio = 1.0 if isotropic else log(1e-2, 1e4)
    k1 = (8.0 + mass_a + mass_b) * (6 * math.pi) ** 2
    speed_ratio = log(1e-3, 100.0)
    drawn = {
        "mass_a": mass_a,
        "mass_b": mass_b,
        "c3": damping_a,
        "c4": damping_b,
        "ball_radius": ball,
        "sp": places[place],
        "place": place,
        "zeta1": zeta1,
        "zeta2": zeta2,
        "K": ratio,
        "speed_ratio": speed_ratio,
    }
    return RotorParameters(7.0, 1.0, places[place], a, b, k1, ratio * k1, zeta1, zeta2), speed_ratio, drawn


def _kind_of_refusal(error: BaseException) -> str:
    """The message with its numbers blanked, so that equal reasons fall together."""
    text = re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", str(error))
    return f"{type(error).__name__}: {text[:110]}"


def judge_multipliers(
    p: RotorParameters, ratio: float, drawn: dict[str, Any], options: argparse.Namespace
) -> dict[str, Any]:
    """One call of `multipliers`; its largest modulus, its error, and the angles' error."""
    speed = p.speed_rad_s(ratio)
    start = time.perf_counter()
    state = multipliers(p, speed, options.accuracy)
    row = {
        "seconds": time.perf_counter() - start,
        "estimate": state.error_estimate,
        "method": state.method.split(":")[0],
    }
    largest, allowed = state.multiplier_max, options.accuracy * max(1.0, state.multiplier_max)
    row |= {"largest": largest, "allowed": allowed}
    try:
        true = arb_peer.reference(p, speed, options.reference_seconds)
        gap = np.abs(np.exp(1j * np.array(state.theta_rad)) - np.exp(1j * np.array(true.theta_rad)))
        row |= {"reference": f"arb {true.method}", "uncertainty": true.error * max(1.0, true.largest)}
        row |= {"error": abs(largest - true.largest), "angle_error": float(np.max(gap))}
    except NotConverged:
        matrix = type_one(p, *state.theta_rad, speed)
        for name in _OTHER_METHODS:
            if name == row["method"]:
                continue
            try:
                second = floquet_multipliers(matrix, max(1e-13, 0.1 * options.accuracy), name)
            except (NotConverged, FloatingPointError):
                continue
            return row | {
                "reference": "second method",
                "uncertainty": second.error_estimate,
                "error": abs(largest - second.largest),
            }
    return row


def _symbolic(steady: bool) -> Any:
    """heyoka's equations with all parameters at run time, so that they are compiled once."""
    par = heyoka_peer.heyoka().par

    def body(s: int, j: int, d: int, c: int) -> Any:
        return SimpleNamespace(
            first_moment_kg_m=par[s], inertia_kg_m2=par[j], drive_inertia_kg_m2=par[d], damping_Nms_per_rad=par[c]
        )

    symbols = SimpleNamespace(
        total_mass_kg=par[0],
        k1_N_per_m=par[1],
        k2_N_per_m=par[2],
        damping_Ns_per_m=(par[3], par[4]),
        a=body(5, 8, 13, 10),
        b=body(6, 9, 14, 11),
        forcing_moment_kg_m=par[7],
        pivot_shift_m=par[12],
        gravity_m_per_s2=par[17],
    )
    return heyoka_peer.equations(symbols, par[18], 0.0 if steady else par[19])


def _taylor(kind: str, tolerance: float = heyoka_peer.DOUBLE_TOLERANCE) -> Any:
    """A compiled integrator: "motion" (with a ramp) or "orbit" (with variational states)."""
    key = f"{kind} {tolerance:g}"
    if key not in _compiled:
        hy: Any = heyoka_peer.heyoka()
        if hy is None:
            raise SystemExit("this service is judged by heyoka, which is not installed (Linux: pip install heyoka)")
        system = _symbolic(kind == "orbit")
        if kind == "orbit":
            system = hy.var_ode_sys(system, hy.var_args.vars, order=1)
        number = np.longdouble if kind == "orbit" else float
        _compiled[key] = hy.taylor_adaptive(
            system, np.zeros(8, number), tol=number(tolerance), compact_mode=True, fp_type=number
        )
    return _compiled[key]


def _numbers(p: RotorParameters, speed: float, ramp: float) -> list[float]:
    return [*p.packed(), speed, ramp]


def _propagated(
    p: RotorParameters, start: np.ndarray, speed: float, ramp: float, times: np.ndarray, tolerance: float
) -> Any:
    """States of the reference at the times, or None when it would take too many steps."""
    if fastest_rate(p, speed + ramp * times[-1]) * times[-1] > 5 * _MOST_TAYLOR_STEPS:
        return None
    ta = _taylor("motion", tolerance)
    ta.pars[:] = _numbers(p, speed, ramp)[: len(ta.pars)]
    ta.time, ta.state[:] = 0.0, start
    found = ta.propagate_grid(times, max_steps=_MOST_TAYLOR_STEPS)
    states = found[-1]
    return states if len(states) == len(times) and np.all(np.isfinite(states)) else None


def _scene(p: RotorParameters, ratio: float, drawn: dict[str, Any]) -> tuple[Scene, np.ndarray, float, float]:
    """A release at speed, or a ramp from there; over 3 to 30 revolutions."""
    rng = np.random.default_rng(int(drawn["number"]) + 7919)
    speed, revolutions = p.speed_rad_s(ratio), float(rng.uniform(3, 30))
    ramp = 0.0 if rng.random() < 0.5 else math.exp(rng.uniform(math.log(0.01), math.log(1000.0))) * math.pi / 30
    turned = 2 * math.pi * revolutions
    duration = turned / speed if ramp == 0 else 2 * turned / (speed + math.sqrt(speed**2 + 2 * ramp * turned))
    start = locked_state(p, speed, 0.0, 0.2 * math.pi / 180, math.pi + 0.1 * math.pi / 180)
    history = SpeedHistory.constant(speed) if ramp == 0 else SpeedHistory.ramp(speed, speed + ramp * duration, duration)
    drawn |= {"revolutions": revolutions, "ramp_rpm_per_s": ramp * 30 / math.pi}
    return Scene(history, start=start), np.linspace(0.0, duration, 65), speed, ramp


def judge_motion(p: RotorParameters, ratio: float, drawn: dict[str, Any], options: argparse.Namespace) -> Row:
    """One call of `simulate`; the largest error over 65 instants."""
    scene, times, speed, ramp = _scene(p, ratio, drawn)
    begin = time.perf_counter()
    motion = simulate(p, scene, times, options.accuracy)
    row = {"seconds": time.perf_counter() - begin, "estimate": motion.error_estimate, "method": motion.method}
    row |= {"allowed": options.accuracy, "steps": motion.steps}
    weights = np.array([ARM_M, ARM_M, 1.0, 1.0])

    def apart(one: np.ndarray, other: np.ndarray) -> float:
        return float(np.max(np.abs(one[:, :4] - other[:, :4]) / weights))

    assert scene.start is not None
    true, other = (
        _propagated(p, scene.start, speed, ramp, times, tol) for tol in (heyoka_peer.DOUBLE_TOLERANCE, 2e-15)
    )
    if true is not None and other is not None:
        return row | {"reference": "heyoka", "uncertainty": apart(true, other), "error": apart(motion.state, true)}
    try:
        method = "implicit" if motion.method == "explicit" else None
        second = simulate(p, scene, times, max(1e-12, 1e-2 * options.accuracy), method, work_limit=3_000_000)
    except DynamicsError:
        return row
    return row | {
        "reference": "second method",
        "uncertainty": second.error_estimate,
        "error": apart(motion.state, second.state),
    }


def _orbit_through(
    p: RotorParameters, speed: float, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The periodic orbit near a start state, by Newton's method on the map over half a revolution in 80 bits.

    Returns:
        How far the start state is from the orbit's, what that is uncertain by (rounding of the 80 bits over the
        distance of a multiplier from 1), and the orbit's multipliers; None when it takes too many steps.
    """
    ta = _taylor("orbit", float(np.finfo(np.longdouble).eps))
    ta.pars[:] = np.array(_numbers(p, speed, 0.0)[: len(ta.pars)], np.longdouble)
    here, half = start.astype(np.longdouble), np.empty((8, 8))
    whirl = float(np.max(np.abs(start[:2])))
    size = np.array([whirl, whirl, 1.0, 1.0, whirl * speed, whirl * speed, speed, speed])
    for _ in range(2):
        ta.time, ta.state[:8], ta.state[8:] = np.longdouble(0), here, np.eye(8, dtype=np.longdouble).ravel()
        ended = ta.propagate_until(_PI / np.longdouble(speed), max_steps=_MOST_TAYLOR_STEPS)
        if "time_limit" not in str(ended[0]):
            return None
        half = np.asarray(_TURN[:, None] * ta.state[8:].reshape(8, 8), float)
        residual = np.asarray(_TURN * ta.state[:8] - here, float)
        here = here + np.linalg.lstsq(np.eye(8) - half, residual, rcond=1e-13)[0]
    noise = 1e-17 * np.abs(np.linalg.pinv(np.eye(8) - half, rcond=1e-13)) @ size
    return np.asarray(here - start, float), noise, np.linalg.eigvals(half) ** 2


def judge_states(p: RotorParameters, ratio: float, drawn: dict[str, Any], options: argparse.Namespace) -> Row:
    """One call of `steady_states`; the worst of all states' angles and multipliers as a share of what is allowed."""
    speed = p.speed_rad_s(ratio)
    begin = time.perf_counter()
    states = steady_states(p, speed, options.accuracy)
    row: dict[str, Any] = {"seconds": time.perf_counter() - begin, "method": f"{len(states)} states", "allowed": 1.0}
    row |= {"estimate": 1.0, "unresolved": len(states.unresolved)}
    if fastest_rate(p, speed) * math.pi / speed > _MOST_RADIANS_80_BITS:
        return row
    worst, beyond = 0.0, 0.0
    for state in states:
        found = _orbit_through(p, speed, state.start)
        if found is None:
            return row
        off, noise, true = found
        scale = max(1.0, float(np.max(np.abs(true))))
        modulus = abs(float(np.max(np.abs(true))) - state.multiplier_max)
        # the angles of a disk at rest are judged in ball arithmetic by the service "multipliers"
        angle = 0.0 if state.type == "I" else max(0.0, float(np.max(np.abs(off[2:4]) - noise[2:4])))
        worst = max(worst, angle / options.accuracy, modulus / (options.accuracy * scale))
        share = max(angle / (state.angle_error_rad + 1e-15), modulus / (state.error_estimate + 1e-15 * scale))
        if share > beyond:
            beyond = share
            row |= {
                "type": state.type,
                "angle": (angle, state.angle_error_rad),
                "modulus": (modulus, state.error_estimate),
            }
            row |= {"largest": state.multiplier_max}
    estimate = worst / beyond if beyond > 0 else 1.0
    return row | {"estimate": estimate, "error": worst, "uncertainty": 0.0, "reference": "heyoka, 80 bits"}


JUDGES: dict[str, Callable[..., dict[str, Any]]] = {
    "multipliers": judge_multipliers,
    "motion": judge_motion,
    "states": judge_states,
}


def judged(number: int, options: argparse.Namespace) -> Row:
    """One draw of the seed's sequence, its call and its verdict."""
    p, ratio, drawn = draw(np.random.default_rng([options.seed, number]))
    drawn["number"] = number
    begin = time.perf_counter()
    try:
        row = JUDGES[options.service](p, ratio, drawn, options)
    except DynamicsError as error:
        row = {"seconds": time.perf_counter() - begin, "refused": _kind_of_refusal(error), "message": str(error)}
    except Exception as error:  # any other exception is a finding
        row = {"seconds": time.perf_counter() - begin, "crashed": _kind_of_refusal(error), "message": str(error)}
    return drawn | row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts, shares and times of the draws."""
    answered = [r for r in rows if "estimate" in r]
    known = [r for r in answered if "error" in r and r["uncertainty"] <= 0.1 * r["allowed"]]
    sharp = [
        r for r in known if r["uncertainty"] <= 0.3 * r["estimate"] or r["error"] > r["estimate"] + r["uncertainty"]
    ]
    seconds = np.array([r["seconds"] for r in rows])
    wrong = [r for r in known if r["error"] > r["allowed"] + r["uncertainty"]]
    beyond = [r for r in sharp if r["error"] > r["estimate"] + r["uncertainty"]]
    return {
        "draws": len(rows),
        "answered": len(answered),
        "refused": dict(Counter(r["refused"] for r in rows if "refused" in r).most_common()),
        "crashed": dict(Counter(r["crashed"] for r in rows if "crashed" in r).most_common()),
        "judged_by": dict(Counter(r["reference"] for r in known)),
        "not_finite": sum(not math.isfinite(r.get("largest", 0.0) + r["estimate"]) for r in answered),
        "beyond_target": len(wrong),
        "judged_on_estimate": len(sharp),
        "beyond_estimate": len(beyond),
        "worst_by_target": sorted(known, key=lambda r: -r["error"] / r["allowed"])[:5],
        "worst_by_estimate": sorted(sharp, key=lambda r: -r["error"] / max(r["estimate"], 1e-300))[:5],
        "angle_error_max": max((r.get("angle_error", 0.0) for r in known), default=0.0),
        "seconds_median": float(np.median(seconds)),
        "seconds_95": float(np.quantile(seconds, 0.95)),
        "seconds_max": float(seconds.max()),
        "methods": dict(Counter(r["method"] for r in answered)),
    }


def _print(found: dict[str, Any]) -> None:
    known = sum(found["judged_by"].values())
    print(f"{found['draws']} draws, {found['answered']} answered, {found['not_finite']} not finite")
    for name in ("refused", "crashed", "judged_by", "methods"):
        for text, count in found[name].items():
            print(f"  {name:10s} {count:5d}  {text}")
    print(f"within target: {known - found['beyond_target']} of {known}")
    print(f"within estimate: {found['judged_on_estimate'] - found['beyond_estimate']} of {found['judged_on_estimate']}")
    print(f"largest error of a balanced angle: {found['angle_error_max']:.2g} rad")
    print(
        f"seconds: median {found['seconds_median']:.3g}, 95 % {found['seconds_95']:.3g}, max {found['seconds_max']:.3g}"
    )
    for name in ("worst_by_target", "worst_by_estimate"):
        print(name)
        for row in found[name]:
            share = row["error"] / (row["allowed"] if name == "worst_by_target" else max(row["estimate"], 1e-300))
            print(
                f"  {share:.3g}  "
                + ", ".join(f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in row.items())
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--service", choices=list(JUDGES), default="multipliers")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--accuracy", type=float, default=1e-8)
    parser.add_argument(
        "--reference-seconds", type=float, default=1.0, help="what a reference in ball arithmetic may take"
    )
    parser.add_argument("--json", action="store_true", help="all rows and the summary as one JSON object")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for number in range(options.draws):
        rows.append(judged(number, options))
        limit = min(rows[-1].get("allowed", math.inf), rows[-1].get("estimate", math.inf)) + rows[-1].get(
            "uncertainty", 0.0
        )
        if "crashed" in rows[-1] or rows[-1].get("error", 0.0) > limit:
            print(f"suspect: {json.dumps(rows[-1])}", file=sys.stderr, flush=True)
        if (number + 1) % 50 == 0:
            print(f"{number + 1} of {options.draws}", file=sys.stderr, flush=True)
    found = summary(rows)
    if options.json:
        print(json.dumps({"options": vars(options), "summary": found, "rows": rows}))
    else:
        _print(found)


if __name__ == "__main__":
    main()
