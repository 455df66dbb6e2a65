"""Synthetic releases at speed: the coupled motion by scipy's DOP853 with an encoder's readings, and its bound.

    M (ẍ + 2ζ1ω1 ẋ + ω1² x) = Re F,  M (ÿ + 2ζ2ω2 ẏ + ω2² y) = Im F,
    F = S_P Ω² e^{iψ} + Σ S_i [φ̇_i² − iφ̈_i] e^{iφ_i},    φ_i = ψ + θ_i,
    J_i θ̈_i + c_i θ̇_i = S_i (ẍ sin φ_i − ÿ cos φ_i),

in a formulation independent of the dynamics package. Before the release the disk is on the steady orbit of the locked
pendulums. The input of a method contains exact masses, lengths, speed and marks. Suspension, S_P and the encoders'
zeros have the given uncertainties. The start values of c3 and c4 are wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import integrate

from daq.signals.run import Release, Run
from dynamics.equations.parameters import RotorParameters
from identification.bench.fisher import bound
from identification.bench.trials import SyntheticRecord
from identification.pendulums.suspension_knowledge import NAMES, Knowledge

SPEED_RAD_S = 2 * np.pi * 8.0
LOCKED_S, RATE_HZ = 3.0, 1000.0
ZERO_STD_RAD = np.radians(0.05)
LASER_NOISE_M = 10e-6
_KNOWN_SHARE = np.array([1e-4, 1e-4, 2e-3, 2e-3, 1e-3])  # of k1, k2, ζ1, ζ2, S_P
_TIME_STD_S = 1e-4
_JITTER_STEPS, _LOST = 0.3, 0.02
_TOLERANCE = 1e-9
_DAMPING = ("c3_Nms_per_rad", "c4_Nms_per_rad")


@dataclass(frozen=True)
class ReleaseRecord:
    """Record of a release, the input of a method.

    Attributes:
        run: readings of both encoders, marks and lasers, with the instant of release.
        knowledge: prior knowledge, with c3 and c4 wrong by the factor of the case.
    """

    run: Run
    knowledge: Knowledge


def release(
    rng: np.random.Generator, physics: RotorParameters, wrong_start: float, record_s: float, truths: int
) -> SyntheticRecord:
    """Draw a release at 8 Hz of a rig whose parameters lie around the given ones.

    Args:
        rng: random generator.
        physics: parameters around which those of the rig are drawn.
        wrong_start: factor by which the start value of c3 is too large and that of c4 too small, or vice versa.
        record_s: length after the release, s.
        truths: number of different motions; each record has its own noise, lost samples and prior knowledge. The bound
            of each motion takes 25 integrations.
    """
    drawn = _drawn(physics, int(rng.integers(truths)), record_s)
    run = _recorded(rng, drawn)
    direction = rng.choice([-1.0, 1.0])
    given = dict(zip(NAMES, drawn.suspension * np.exp(_KNOWN_SHARE * rng.normal(size=5)), strict=True))
    given |= dict(zip(_DAMPING, drawn.damping * wrong_start ** np.array([direction, -direction]), strict=True))
    knowledge = Knowledge(physics.with_values(**given), _KNOWN_SHARE)
    truth, limit = ({n: float(v) for n, v in zip(_DAMPING, own, strict=True)} for own in (drawn.damping, drawn.bound))
    return SyntheticRecord(ReleaseRecord(run, knowledge), truth, limit)


@dataclass(frozen=True)
class _Drawn:
    """One motion.

    Attributes:
        damping, suspension, phase_rad: true parameters.
        angle_rad: angles at the encoder's samples, rad, shape (n, 2).
        disk_m: displacements of the disk, m, shape (n, 2).
        bound: bound of c3 and c4, shape (2,).
    """

    damping: np.ndarray
    suspension: np.ndarray
    phase_rad: float
    angle_rad: np.ndarray
    disk_m: np.ndarray
    bound: np.ndarray


@lru_cache(maxsize=64)
def _drawn(physics: RotorParameters, number: int, record_s: float) -> _Drawn:
    rng = np.random.default_rng([8, number])
    damping = physics.a.damping_Nms_per_rad * np.exp(rng.uniform(-0.5, 0.5, 2))
    suspension = np.array([physics.identified()[n] for n in NAMES])
    phase = rng.uniform(-np.pi, np.pi)
    angles = np.array([0.0, np.pi]) + np.radians(rng.uniform(2.0, 6.0, 2) * rng.choice([-1, 1], 2))
    time = np.arange(1, round(record_s * RATE_HZ)) / RATE_HZ

    def motion(theta: np.ndarray) -> np.ndarray:
        return _motion(physics, np.exp(theta[:2]), np.exp(theta[2:7]), theta[7:9], phase, theta[11], time)

    def mean(theta: np.ndarray) -> np.ndarray:
        return motion(theta)[:, 2:4] + theta[9:11]

    theta = np.r_[np.log(damping), np.log(suspension), angles, np.zeros(3)]
    step_rad = 2 * np.pi / 4096
    noise = step_rad * np.sqrt(1 / 12 + _JITTER_STEPS**2)
    locked = noise / np.sqrt(LOCKED_S * RATE_HZ)  # standard deviation of the mean of the start angles' readings
    known = np.r_[np.full(2, np.inf), _KNOWN_SHARE, np.full(2, np.inf), np.full(2, ZERO_STD_RAD), _TIME_STD_S]

    def with_locked(at: np.ndarray) -> np.ndarray:
        return np.concatenate([mean(at).ravel(), (at[7:9] + at[9:11]) * noise / locked])

    std = bound(with_locked, theta, np.r_[np.full(11, 1e-5), 1e-6], noise, known)
    states = motion(theta)
    return _Drawn(damping, suspension, phase, states[:, 2:4], states[:, :2], damping * std[:2])


def _motion(
    physics: RotorParameters,
    damping: np.ndarray,
    suspension: np.ndarray,
    start_rad: np.ndarray,
    phase_rad: float,
    delay_s: float,
    time: np.ndarray,
) -> np.ndarray:
    """Return x, y, θ3, θ4 and their rates after a release at delay_s, with the given phase at t = 0, shape (n, 8)."""
    numbers = equation_numbers(physics, damping, suspension, phase_rad)
    w, mass, moment, k, loss, s = numbers[1], numbers[2], numbers[3], numbers[4:6], numbers[6:8], numbers[8:10]
    whole = moment + np.sum(s * np.exp(1j * start_rad))
    turned = whole * w * w * np.exp(1j * (phase_rad + w * delay_s)) / (k - mass * w * w + 1j * w * loss)
    turned[1] *= -1j  # y is the imaginary part
    start = np.r_[turned.real, start_rad, (1j * w * turned).real, 0.0, 0.0]
    span = (delay_s, float(time[-1]))
    tolerances = {"rtol": _TOLERANCE, "atol": 1e-3 * _TOLERANCE}
    untyped = cast("Any", integrate)  # scipy has no types
    found: NDArray[np.float64] = untyped.solve_ivp(slope, span, start, "DOP853", time, args=(numbers,), **tolerances).y
    return found.T


def equation_numbers(
    physics: RotorParameters, damping: np.ndarray, suspension: np.ndarray, phase_rad: float
) -> np.ndarray:
    """Return the numbers for `slope`: ψ at t = 0, Ω, M, S_P and pairs of k, disk damping, S, J, c; shape (14,).

    Args:
        suspension: k1, k2, ζ1, ζ2, S_P.
    """
    mass = physics.total_mass_kg
    pendulums = (physics.a, physics.b)
    loss = 2 * suspension[2:4] * np.sqrt(suspension[:2] * mass)
    s, j = [p.first_moment_kg_m for p in pendulums], [p.inertia_kg_m2 for p in pendulums]
    return np.r_[phase_rad, SPEED_RAD_S, mass, suspension[4], suspension[:2], loss, s, j, damping]


@njit(cache=True, nogil=True, error_model="numpy")
def slope(t: float, state: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the rates of (x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4) by elimination of θ̈ from the disk's two equations."""
    phase, w, mass, moment = numbers[0], numbers[1], numbers[2], numbers[3]
    psi = phase + w * t
    fx = moment * w * w * math.cos(psi) - numbers[6] * state[4] - numbers[4] * state[0]
    fy = moment * w * w * math.sin(psi) - numbers[7] * state[5] - numbers[5] * state[1]
    mxx, mxy, myy = mass, 0.0, mass
    for i in range(2):
        s, j, c = numbers[8 + i], numbers[10 + i], numbers[12 + i]
        sin, cos, rate = math.sin(psi + state[2 + i]), math.cos(psi + state[2 + i]), state[6 + i]
        pull, drag = s * (w + rate) ** 2, -c * rate / j * s
        fx += pull * cos + drag * sin
        fy += pull * sin - drag * cos
        mxx -= s * s / j * sin * sin
        mxy += s * s / j * sin * cos
        myy -= s * s / j * cos * cos
    inverse = 1 / (mxx * myy - mxy * mxy)
    ax, ay = inverse * (myy * fx - mxy * fy), inverse * (mxx * fy - mxy * fx)
    out = np.empty(8)
    out[:4] = state[4:]
    out[4], out[5] = ax, ay
    for i in range(2):
        sin, cos = math.sin(psi + state[2 + i]), math.cos(psi + state[2 + i])
        out[6 + i] = (numbers[8 + i] * (ax * sin - ay * cos) - numbers[12 + i] * state[6 + i]) / numbers[10 + i]
    return out


def _recorded(rng: np.random.Generator, drawn: _Drawn) -> Run:
    """Return the readings of lasers, encoders and tachometer; the release is at LOCKED_S plus a stamp error."""
    step = 2 * np.pi / 4096
    before = np.tile(drawn.angle_rad[0], (round(LOCKED_S * RATE_HZ) + 1, 1))
    angle: NDArray[np.float64] = np.concatenate([before, drawn.angle_rad]) + ZERO_STD_RAD * rng.normal(size=2)
    time: NDArray[np.floating] = np.arange(len(angle)) / RATE_HZ
    counts: NDArray[np.float64] = np.rint(angle / step + _JITTER_STEPS * rng.normal(size=angle.shape))
    keep = rng.random(len(time)) >= _LOST
    phase_at_zero = drawn.phase_rad - SPEED_RAD_S * LOCKED_S
    whole = np.array([phase_at_zero, phase_at_zero + SPEED_RAD_S * time[-1]]) / (2 * np.pi)
    turns = 2 * np.pi * np.arange(float(np.ceil(whole[0])), float(np.floor(whole[1])) + 1)
    at = LOCKED_S + time[: len(drawn.disk_m)] + 1 / RATE_HZ
    disk = drawn.disk_m + LASER_NOISE_M * rng.normal(size=drawn.disk_m.shape)
    stamp = LOCKED_S + _TIME_STD_S * rng.normal()
    return Run(
        "point-8-Hz",
        "synthetic",
        0.0,
        at,
        disk[:, 0],
        at,
        disk[:, 1],
        time[keep],
        counts[keep] * step,
        (turns - phase_at_zero) / SPEED_RAD_S,
        turns,
        (Release(0, stamp, _TIME_STD_S), Release(1, stamp, _TIME_STD_S)),
        step,
        dict.fromkeys(("x", "y", "angles", "phase"), 0.0),
    )
