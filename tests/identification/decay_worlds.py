"""Decays of rigs that the model of a ring-down does not describe, from closed forms and SciPy's integration.

Every world yields times, s, shape (n,), and the displacements that two lasers would read, m, shape (n, 2).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from rig_basics.arrays import Array

World = Callable[[int], tuple[Array, Array]]

F_Hz, ZETA = (3.0, 4.1), (0.010, 0.008)
PULL_M, NOISE_M, RATE_Hz, RECORD_S, TURN_DEG = 3e-3, 4e-6, 1000.0, 20.0, 3.0
OMEGA = 2 * np.pi * np.array(F_Hz)
DAMPING = 2 * np.array(ZETA) * OMEGA  # 1/s
START_M = PULL_M * np.array([1.0, 0.3])


def times(rate_Hz: float = RATE_Hz, record_s: float = RECORD_S) -> Array:
    """Uniform times, s."""
    return np.arange(round(rate_Hz * record_s)) / rate_Hz


def seen(motion_m: Array, seed: int, noise_m: float = NOISE_M) -> Array:
    """Readings of two lasers turned against the axes, with white noise."""
    b = np.radians(TURN_DEG)
    turned = motion_m @ np.array([[np.cos(b), np.sin(b)], [-np.sin(b), np.cos(b)]]).T
    return turned + noise_m * np.random.default_rng(seed).normal(size=turned.shape)


def released(acceleration: Callable[[Array, Array], Array], t: Array, start_m: Array = START_M) -> Array:
    """Displacements of x and y released from rest; the acceleration is a function of position and velocity."""

    def slope(_: float, state: Array) -> Array:
        return np.concatenate([state[2:], acceleration(state[:2], state[2:])])

    whole = np.concatenate([start_m, np.zeros(2)])
    return solve_ivp(slope, (0.0, float(t[-1])), whole, "RK45", t, rtol=1e-7, atol=1e-11, max_step=5e-3).y[:2].T


def linear_motion(t: Array, mass: Array, stiffness: Array, damping: Array, start_m: Array) -> Array:
    """Displacements of M q̈ + C q̇ + K q = 0 released from rest, shape (n, q)."""
    n = len(start_m)
    inverse = np.linalg.inv(mass)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    rates, shapes = np.linalg.eig(state)
    shares = np.linalg.solve(shapes, np.concatenate([start_m, np.zeros(n)]).astype(complex))
    return np.real(np.exp(np.outer(t, rates)) @ (shapes[:n] * shares).T)


def ideal(seed: int, noise_m: float = NOISE_M, stiffness: float = 1.0, start_m: Array = START_M) -> tuple[Array, Array]:
    """Two modes at right angles with viscous damping; stiffness over the nominal one at the same damping ratios."""
    t = times()
    k, c = np.diag(stiffness * OMEGA**2), np.diag(np.sqrt(stiffness) * DAMPING)
    return t, seen(linear_motion(t, np.eye(2), k, c, start_m), seed, noise_m)


def tilting_disk(seed: int) -> tuple[Array, Array]:
    """A disk that tilts: each direction has a second mode, at 14 and 18 Hz, excited by the same release."""
    t = times()
    stiffness, mass, damping = np.zeros((4, 4)), np.eye(4), np.diag([*DAMPING, 0.4, 0.4])
    for i, tilt_Hz in enumerate((14.0, 18.0)):
        stiffness[i, i], stiffness[i + 2, i + 2] = OMEGA[i] ** 2, (2 * np.pi * tilt_Hz) ** 2
        stiffness[i, i + 2] = stiffness[i + 2, i] = 0.3 * OMEGA[i] * 2 * np.pi * tilt_Hz
    motion = linear_motion(t, mass, stiffness, damping, np.r_[START_M, 0.0, 0.0])
    return t, seen(motion[:, :2] + 0.05 * motion[:, 2:], seed)


def soft_foundation(seed: int) -> tuple[Array, Array]:
    """A foundation of ten times the rotor's mass on soft feet, lightly damped, in both directions."""
    t = times()
    foot = (2 * np.pi * 1.7) ** 2 * 10
    k, c = np.diag(OMEGA**2), np.diag(DAMPING)
    stiffness = np.block([[k, -k], [-k, k + foot * np.eye(2)]])
    damping = np.block([[c, -c], [-c, c + 0.6 * np.eye(2)]])
    motion = linear_motion(t, np.diag([1.0, 1.0, 10.0, 10.0]), stiffness, damping, np.r_[START_M, 0.0, 0.0])
    return t, seen(motion[:, :2], seed)


def bearing_clearance(seed: int, gap_m: float = 2.5e-6) -> tuple[Array, Array]:
    """Springs that do not push within a clearance."""
    t = times()
    return t, seen(released(lambda q, v: -(OMEGA**2) * (q - np.clip(q, -gap_m, gap_m)) - DAMPING * v, t), seed)


def structural_damping(seed: int) -> tuple[Array, Array]:
    """Springs of a lossy material: three relaxation elements in each direction and no viscous damper."""
    t = times()
    relaxing = 2 * np.pi * np.array([0.3, 3.0, 30.0])  # 1/s
    share = 0.012
    total = np.zeros((len(t), 2))
    for i in range(2):
        w2 = OMEGA[i] ** 2
        n = 2 + len(relaxing)
        state = np.zeros((n, n))
        state[0, 1], state[1, 0] = 1.0, -w2
        for j, own in enumerate(relaxing, start=2):
            state[1, j], state[j, 1], state[j, j] = -share * w2, 1.0, -own
        rates, shapes = np.linalg.eig(state)
        shares = np.linalg.solve(shapes, np.r_[START_M[i], np.zeros(n - 1)].astype(complex))
        total[:, i] = np.real(np.exp(np.outer(t, rates)) @ (shapes[0] * shares))
    return t, seen(total, seed)


def dry_friction(seed: int, share: float = 0.004) -> tuple[Array, Array]:
    """A dry contact along each axis besides viscous damping, with a share of the pull's spring force."""
    t = times()
    hold = share * OMEGA**2 * PULL_M
    return t, seen(released(lambda q, v: -(OMEGA**2) * q - DAMPING * v - hold * np.tanh(v / 2e-5), t), seed)


def cubic_spring(seed: int, at_pull: float = 0.04) -> tuple[Array, Array]:
    """A spring that hardens with the distance from the centre, which couples both directions."""
    t = times()
    return t, seen(released(lambda q, v: -(OMEGA**2) * q * (1 + at_pull * (q @ q) / PULL_M**2) - DAMPING * v, t), seed)


def axes_off_square(seed: int, degrees: float = 2.0) -> tuple[Array, Array]:
    """Lasers that are not at right angles."""
    t, signal = ideal(seed, 0.0)
    skew = np.radians(degrees)
    signal[:, 1] = np.cos(skew) * signal[:, 1] + np.sin(skew) * signal[:, 0]
    return t, signal + NOISE_M * np.random.default_rng(seed).normal(size=signal.shape)


def lost_cycle(seed: int) -> tuple[Array, Array]:
    """A third of a second that was lost while the time stamps went on without a gap."""
    t, signal = ideal(seed)
    first, last = round(4.0 * RATE_Hz), round(4.333 * RATE_Hz)
    return t[: len(t) - (last - first)], np.delete(signal, np.s_[first:last], axis=0)


def nonlinear_lasers(seed: int, share: float = 1e-3, range_m: float = 10e-3) -> tuple[Array, Array]:
    """Lasers whose characteristic bends by a share of their range."""
    t, signal = ideal(seed, 0.0)
    bent = signal + share * range_m * (
        np.cos(np.pi * signal / range_m) - 1 + 0.7 * np.sin(2 * np.pi * signal / range_m)
    )
    return t, bent + NOISE_M * np.random.default_rng(seed).normal(size=signal.shape)


def steel_beam(seed: int) -> tuple[Array, Array]:
    """A struck beam: many modes between 4 and 130 Hz, 20 s at 2 048 Hz, 1.2 s of rest before, both sensors alike."""
    t = times(2048.0, 20.0)
    rng = np.random.default_rng(seed)
    total = np.zeros((len(t), 2))
    free = t > 1.2
    since = t[free] - 1.2
    for f, zeta, size in (
        (4.2, 0.004, 1.0),
        (13.1, 0.01, 0.25),
        (26.3, 0.003, 0.8),
        (33.0, 0.02, 0.2),
        (73.6, 0.002, 0.9),
        (131.0, 0.002, 0.5),
    ):
        w = 2 * np.pi * f
        wave = np.exp(-zeta * w * since) * np.sin(w * np.sqrt(1 - zeta**2) * since)
        total[free] += size * np.outer(wave, [1.0, 0.4 * rng.normal()]) * 1e-3
    drift = 2e-6 * np.cumsum(rng.normal(size=total.shape), axis=0) / np.sqrt(2048)
    return t, total + drift + 2e-6 * rng.normal(size=total.shape)


def seismometer(seed: int, f_Hz: float = 0.113, zeta: float = 0.07) -> tuple[Array, Array]:
    """A slow pendulum with seven visible cycles, 20 s of rest before, and a building that sways at 3.05 Hz."""
    t = times(50.0, 120.0)
    rng = np.random.default_rng(seed)
    w, since = 2 * np.pi * f_Hz, np.maximum(t - 20.0, 0.0)
    wave = np.exp(-zeta * w * since) * np.cos(w * np.sqrt(1 - zeta**2) * since) * (t >= 20.0)
    sway = 1e-2 * np.sin(2 * np.pi * 3.05 * t + 0.5 * np.cumsum(rng.normal(size=len(t))) / 7)
    return t, PULL_M * (wave + sway + 3e-3 * rng.normal(size=len(t)))[:, None]


def warming(seed: int, change: float = 5e-3) -> tuple[Array, Array]:
    """Springs whose stiffness falls in proportion to time, as in a room that warms up."""
    t = times()

    def slope(time: float, state: Array) -> Array:
        stiff = OMEGA**2 * (1 - change * time / RECORD_S)
        return np.concatenate([state[2:], -stiff * state[:2] - DAMPING * state[2:]])

    whole = np.concatenate([START_M, np.zeros(2)])
    motion = solve_ivp(slope, (0.0, float(t[-1])), whole, "DOP853", t, rtol=1e-9, atol=1e-12).y[:2].T
    return t, seen(motion, seed)


WORLDS: dict[str, World] = {
    "ideal": ideal,
    "no noise": partial(ideal, noise_m=0.0),
    "tilting disk": tilting_disk,
    "soft foundation": soft_foundation,
    "bearing clearance": bearing_clearance,
    "structural damping": structural_damping,
    "dry friction": dry_friction,
    "cubic spring": cubic_spring,
    "axes off square": axes_off_square,
    "lost cycle": lost_cycle,
    "nonlinear lasers": nonlinear_lasers,
    "steel beam": steel_beam,
    "seismometer": seismometer,
    "warming": warming,
}
"""Worlds that the model does not describe, besides the ideal one."""
