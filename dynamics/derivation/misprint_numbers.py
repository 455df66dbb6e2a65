"""Numbers in the list of misprints. Each is computed when the list is written."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import scipy.optimize

from dynamics.derivation.effects import (
    NOMINAL_MOMENT_KG_M,
    POINTS,
    isotropic_variants,
    rig,
    states_at_rest,
    variants,
)
from dynamics.derivation.run_up_faults import SCRIPT_SPEED_RAD_S, PrintedFaults, ReleaseMotion, release, script_rig
from dynamics.steady.singular_points import dynamic_stiffness

_solvers: Any = scipy.optimize  # scipy has no annotations
FAULTS = {
    "right equations": PrintedFaults(),
    "(a) no push back": PrintedFaults(without_reaction=True),
    "(b) speed runs on": PrintedFaults(integrates_locked_speed=True),
    "(a) and (b), the script": PrintedFaults(without_reaction=True, integrates_locked_speed=True),
}
# Regions of balancing capability: S_P (kg m), mass of pendulum B (kg)
REGIONS = {
    "properly oversized": (NOMINAL_MOMENT_KG_M, 0.055),
    "undersized": (0.012, 0.075),
    "improperly oversized": (0.001, 0.019),
}


@functools.cache
def type_i_multipliers(mass_b_kg: float) -> dict[str, tuple[float, ...]]:
    """Largest Type I multiplier over one revolution at A–E for each variant of `effects.variants`."""
    p = rig(mass_b_kg=mass_b_kg)
    return {name: tuple(motion.multipliers(p, POINTS.values())) for name, motion in variants().items()}


@functools.cache
def isotropic_growth_rates() -> dict[str, dict[str, float]]:
    """Growth rate (1/s) of each singular point by each isotropic variant; ζ = 0.05, K = 1."""
    cases = {
        "I, identical pendulums, Ω = 2.5": (rig(1, 0.05), 2.5, "I"),
        "I, M_BB = 0.055 kg, Ω = 2.5": (rig(1, 0.05, mass_b_kg=0.055), 2.5, "I"),
        "III, Ω = 0.8": (rig(1, 0.05), 0.8, "III"),
        "III, S_P = 0.012 kg m, Ω = 2.5": (rig(1, 0.05, 0.012), 2.5, "III"),
        "II, M_BB = 0.019 kg, S_P = 0.001 kg m, Ω = 2.5": (rig(1, 0.05, 0.001, 0.019), 2.5, "II"),
    }
    found: dict[str, dict[str, float]] = {}
    for name, (p, ratio, kind) in cases.items():
        omega = p.speed_rad_s(ratio)
        states = states_at_rest(p, omega)[kind]
        # of two solutions of Types II and III: the one that is stable with the derived matrices; the derived rates of
        # mirror images are equal, those of the printed matrices differ
        growth = {i: round(isotropic_variants()["derived"].growth_rate(p, omega, y), 6) for i, y in enumerate(states)}
        state = states[min(growth, key=lambda i: (growth[i], float(states[i][2]) % (2 * math.pi)))]
        found[name] = {v: motion.growth_rate(p, omega, state) for v, motion in isotropic_variants().items()}
    return found


@functools.cache
def stable_types() -> dict[tuple[str, float], list[str]]:
    """Types with a stable solution by region and speed ratio; equal springs, ζ = 0.02."""
    derived, found = isotropic_variants()["derived"], dict[tuple[str, float], list[str]]()
    for region, (moment, mass_b) in REGIONS.items():
        p = rig(1, 0.02, moment, mass_b)
        for ratio in (0.8, 2.5):
            omega = p.speed_rad_s(ratio)
            states = states_at_rest(p, omega)
            found[region, ratio] = [
                kind for kind, points in states.items() if any(derived.growth_rate(p, omega, y) < 0 for y in points)
            ]
    return found


def least_moment_of_type_iii(ratio: float = 0.8, zeta: float = 0.05) -> float:
    """S_P below which singular points of Type III do not exist, kg m: (S_A + S_B) sin φ_H; nominal pendulums, K = 1."""
    p = rig(1, zeta)
    stiffness = dynamic_stiffness(p, p.speed_rad_s(ratio))
    return (p.a.first_moment_kg_m + p.b.first_moment_kg_m) * abs(math.sin(np.angle(stiffness)))


def type_ii_against_none(share: float) -> float:
    """Amplitude of stable Type II over that without pendulums at S_P = share · |S_A − S_B|; K = 1, Ω = 6, ζ = 0.02."""
    difference = (0.075 - 0.019) * 0.054
    p = rig(1, 0.02, share * difference, 0.019)
    omega = p.speed_rad_s(6.0)
    derived = isotropic_variants()["derived"]
    y1, y2, *_ = min(states_at_rest(p, omega)["II"], key=lambda y: derived.growth_rate(p, omega, y))
    alone = omega**2 * p.imbalance_moment_kg_m / abs(dynamic_stiffness(p, omega))
    return math.hypot(y1, y2) / alone


def settling_times_s(damping: tuple[float, ...]) -> list[float]:
    """Time constants of the slowest Type I motion at B for given c34 (N m s/rad), s."""
    found: list[float] = []
    for c in damping:
        p = rig(damping=(c, c))
        multiplier = variants()["derived"].piecewise_multiplier(p, POINTS["B"], 100, 0.5)
        found.append(-2 * math.pi / p.speed_rad_s(POINTS["B"]) / math.log(multiplier))
    return found


def piecewise_errors(pieces: int) -> tuple[list[float], float]:
    """Error of the source's piecewise scheme at A, B, E; largest change for samples at the ends of the pieces."""
    motion, p = variants()["derived"], rig()
    ratios = [POINTS[name] for name in "ABE"]
    middle = np.array([motion.piecewise_multiplier(p, ratio, pieces, 0.5) for ratio in ratios])
    end = np.array([motion.piecewise_multiplier(p, ratio, pieces, 1.0) for ratio in ratios])
    return list(abs(middle - motion.multipliers(p, ratios))), float(np.max(abs(end - middle)))


def border_shift(slack: float = 1e-5) -> tuple[float, float]:
    """Speed ratio of the first stable zone's lower border, and its shift for a limit of 1 + slack."""
    motion, p = variants()["derived"], rig()

    def border(limit: float) -> float:
        def excess(ratio: float) -> float:
            return float(motion.multipliers(p, [ratio], 200)[0] - limit)

        return float(_solvers.root_scalar(excess, bracket=(0.9, 1.6), xtol=1e-12).root)

    right = border(1.0)
    return right, border(1.0 + slack) - right


@functools.cache
def releases() -> dict[str, dict[str, ReleaseMotion]]:
    """Releases, 12 s locked and 60 s free, at A, B, D of the nominal rig and with the script's values, by fault."""
    p = rig()
    places = {name: (p, p.speed_rad_s(POINTS[name])) for name in "ABD"}
    places["the script's rig"] = (script_rig(), SCRIPT_SPEED_RAD_S)
    return {
        place: {name: release(parameters, speed, faults) for name, faults in FAULTS.items()}
        for place, (parameters, speed) in places.items()
    }


def largest_angle_difference_rad(one: ReleaseMotion, other: ReleaseMotion) -> float:
    """Largest difference of θ3 or θ4 at equal times after the release, rad."""
    return float(np.max(np.abs(one.state[one.released :, 2:4] - other.state[other.released :, 2:4])))


def slip_revolutions(free_s: float = 60.0) -> tuple[float, float]:
    """Turns of A and B relative to the rotor after a release at D with ζ = 0.05."""
    p = rig(zeta=0.05)
    run = release(p, p.speed_rad_s(POINTS["D"]), PrintedFaults(), free_s=free_s)
    turned = (run.state[-1, 2:4] - run.state[run.released, 2:4]) / (2 * math.pi)
    return float(turned[0]), float(turned[1])


def slip_without_imbalance() -> tuple[float, float]:
    """Common slip of the pendulums (rad/s) and whirl radius (m) at Ω = 0.8, K = 1, ζ = 0.05, S_P = 1e-9 kg m."""
    p = rig(1, 0.05, 1e-9)
    run = release(p, p.speed_rad_s(0.8), PrintedFaults(), free_s=120.0)
    return float(np.mean(run.state[-500:, 6:8])), float(np.max(run.radius_m[-50:]))


def largest_multipliers() -> dict[str, complex]:
    """Largest Type I multiplier over one revolution at A–E; of a conjugate pair the upper one."""
    spectra = variants()["derived"].spectra(rig(), POINTS.values())
    upper = [values[np.lexsort((-values.imag, -np.abs(values).round(9)))][0] for values in spectra]
    return {name: complex(value) for name, value in zip(POINTS, upper, strict=True)}


def wobble_rad(run: ReleaseMotion) -> float:
    """Amplitude of θ3 at twice the running speed over the last five revolutions, rad."""
    turn = np.exp(-4j * np.pi * np.arange(50) / 10)
    return float(2 * abs(np.mean(run.state[-50:, 2] * turn)))
