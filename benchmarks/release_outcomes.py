"""Where releases end, as `release_outcome` has it, against very long runs of an independent integrator.

Draws rigs where long transients, slipping and locking lie side by side: pendulum damping 3e-5 … 3e-3 N m s/rad,
Ω 0.5 … 6, ζ up to 0.2. The referee is heyoka with its own equations: it follows each release ten times as far as
needed for a verdict and calls it locked when the state repeats each revolution to 1e-6, else turning.

    uv run python -m benchmarks.release_outcomes --draws 60 --seed 1

A claim counts as wrong when a "slipping" release locks, or one with a predicted state ends in no such state. A mirror
image other than the one claimed counts apart: after a chaotic transient it depends on rounding; `same_end` is False.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dynamics import Pendulum, RotorParameters, release_outcome, steady_states
from dynamics.bench.heyoka_runs import compiled
from dynamics.errors import DynamicsError
from dynamics.motions.integrate import locked_state
from dynamics.steady.outcome import PLAY_RAD
from dynamics.steady.steady_state import SteadyStates

_BLOCK = 500  # revolutions
_START = (PLAY_RAD, math.pi - 0.5 * PLAY_RAD)


def draw(rng: np.random.Generator, weak: bool = False) -> tuple[RotorParameters, float]:
    """A rig and a speed in rad/s; most draws between the resonances, where slipping is.

    Args:
        weak: weak damping all round and speeds near the border of slipping: the longest transients.
    """

    def log(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    mass_b, stiffness = 0.075 * rng.uniform(0.85, 1.15), rng.uniform(8, 20)
    k1 = (7.195 + mass_b) * (6 * math.pi) ** 2 * rng.uniform(0.9, 1.1)
    a, b = Pendulum(0.075, 0.054, log(3e-5, 3e-3)), Pendulum(mass_b, 0.054, log(3e-5, 3e-3))
    zeta = log(0.01, 0.03) if weak else log(0.005, 0.2)
    if weak:
        a, b = replace(a, damping_Nms_per_rad=log(5e-5, 3e-4)), replace(b, damping_Nms_per_rad=log(5e-5, 3e-4))
    p = RotorParameters(
        7.0, 0.12, 0.02117 * rng.uniform(0.7, 1.3), a, b, k1, stiffness * k1, zeta, zeta * rng.uniform(0.5, 1.5)
    )
    if weak:
        return p, p.speed_rad_s(rng.uniform(0.7, 0.95) * math.sqrt(stiffness))
    between = (1.0, 1.15 * math.sqrt(stiffness))
    return p, p.speed_rad_s(rng.uniform(*between) if rng.random() < 0.6 else rng.uniform(0.5, 6.0))


def referee(p: RotorParameters, speed: float, most: int) -> np.ndarray | None:
    """Angles θ3, θ4 at ψ = 0 at which a release locks; None when it still turns or swings after `most` revolutions."""
    ta = compiled(False, 1e-13)
    ta.pars[:] = np.array([*p.packed()[:12], speed])
    period, done = 2 * math.pi / speed, 0
    state = locked_state(p, speed, 0.0, *_START)
    while done < most:
        ta.time = 0.0
        ta.state[:] = state
        strobe = ta.propagate_grid(np.arange(_BLOCK + 1) * period)[5]
        state = strobe[-1].copy()
        state[2:4] %= 2 * math.pi
        done += _BLOCK
        if np.max(np.ptp(strobe[-200:, 2:4], axis=0)) < 1e-6:
            return state[2:4]
    return None


def judge(state: str, reached: Any, end: np.ndarray | None) -> str:
    """One claim against the referee's end."""
    if state == "not settled":
        return "no claim"
    if state == "slipping":
        return "right" if end is None else "WRONG: slipping, but it locks"
    if end is None:
        return f"WRONG: {state}, but it does not lock"
    if np.max(np.abs(np.exp(1j * end) - np.exp(1j * reached.start[2:4]))) < 1e-3:
        return "right"
    return "other image" if state == "I" else f"WRONG: {state} elsewhere"


def _old(path: Path) -> Callable[..., Any]:
    spec = importlib.util.spec_from_file_location("old_outcome", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["old_outcome"] = module
    spec.loader.exec_module(module)
    return module.release_outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--most", type=int, default=50_000, help="revolutions the referee follows")
    parser.add_argument("--weak", action="store_true", help="weak damping, speeds near the border of slipping")
    parser.add_argument("--against", type=Path, help="another outcome.py to judge in addition to this one")
    asked = parser.parse_args()
    judged: dict[str, Callable[..., Any]] = {"this": release_outcome}
    if asked.against is not None:
        judged["other"] = _old(asked.against)
    rng, counts, claims = np.random.default_rng(asked.seed), {k: Counter() for k in judged}, Counter()
    seconds: list[float] = []
    for n in range(asked.draws):
        p, speed = draw(rng, asked.weak)
        try:
            states: SteadyStates = steady_states(p, speed, 1e-6)
        except DynamicsError as error:
            print(f"{n}: no states: {error}")
            continue
        end = referee(p, speed, asked.most)
        for name, ask in judged.items():
            started = time.perf_counter()
            found = ask(p, speed, states=states)
            took = time.perf_counter() - started
            if name == "this":
                seconds.append(took)
                claims[found.state] += 1
            verdict = judge(found.state, found.reached, end)
            if verdict == "other image" and not getattr(found, "same_end", True):
                verdict = "other image, and reported as chance"
            counts[name][verdict] += 1
            if verdict != "right":
                where = f"Ω {speed / p.natural_frequencies_rad_s[0]:.4f} ζ {p.zeta1:.3g}"
                print(
                    f"{n} {name}: {verdict} ({where}, {found.revolutions} rev., {took:.2g} s) "
                    f"{getattr(found, 'seen', '')}"
                )
    for name, count in counts.items():
        print(name, dict(count))
    print("claims", dict(claims), f"seconds: median {np.median(seconds):.2g}, largest {max(seconds):.2g}")


if __name__ == "__main__":
    main()
