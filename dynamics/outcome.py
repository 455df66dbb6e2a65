"""Which steady motion a release reaches, or that the pendulums never lock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynamics.integrate import locked_state, simulate
from dynamics.parameters import RotorParameters, physics_of
from dynamics.scene import Scene
from dynamics.speed_history import SpeedHistory
from dynamics.steady_motions import steady_states
from dynamics.steady_state import SteadyState

_CHUNK = 40  # revolutions integrated at a time
_NEAR_RAD = 5e-3  # this close to a stable state's own state at ψ = 0, the linear equations bring it there
_SLIPPED_TURNS = 8.0  # turns against the rotor, still going on, that make a pendulum a slipping one
_CREEP_RAD = 1e-4  # in twenty revolutions: under friction, at rest
_BESIDE_RAD = math.radians(20)  # farther from a state than this friction holds the pendulums at none
_MOST_S = 7200.0  # of the rig's time: longer than anyone waits at the slowest speed
PLAY_RAD = math.radians(0.2)


@dataclass(frozen=True)
class ReleaseOutcome:
    """Where a release ends.

    Attributes:
        state: "I", "II", "III" (or "one"), "held by friction" where dry friction keeps the pendulums at no such
            state, "slipping", or "not settled" within the revolutions and the time allowed.
        theta_rad: mean θ3, θ4 of the state reached, [0, 2π); of the last revolution when none was.
        after_s: time from the release until the motion stayed near that state; of the end when none was reached.
        revolutions: how far the motion was followed.
        slip_turns: turns of each pendulum against the rotor since the release.
        reached: the steady state, when one was reached.
    """

    state: str
    theta_rad: tuple[float, float]
    after_s: float
    revolutions: int
    slip_turns: tuple[float, float]
    reached: SteadyState | None


def release_outcome(
    rig: RotorParameters | object,
    speed_rad_s: float,
    from_rad: tuple[float, float] = (PLAY_RAD, math.pi - 0.5 * PLAY_RAD),
    *,
    states: Sequence[SteadyState] | None = None,
    accuracy: float = 1e-4,
    most_revolutions: int = 4000,
) -> ReleaseOutcome:
    """Follow the nonlinear motion from the locked orbit until it stays with one stable state.

    Args:
        rig: RotorParameters, or anything whose `.physics` is.
        from_rad: angles the locks hold. Exactly 0° and 180° may be an unstable rest from which nothing moves; a
            real lock has play, so the default lies 0.2° and 0.1° beside them.
        states: the steady states at this speed, when they are known already.
        accuracy: of the integration over 40 revolutions, rad.
        most_revolutions: when to give up and say "not settled".
    Raises:
        NotConverged: the motion can't be integrated.
    """
    p = physics_of(rig)
    known = steady_states(p, speed_rad_s, 1e-6) if states is None else states
    stable = [s for s in known if s.stable]
    period = 2 * math.pi / speed_rad_s
    history = SpeedHistory.constant(speed_rad_s)
    state = locked_state(p, speed_rad_s, 0.0, *from_rad)
    start, done = state[2:4].copy(), 0
    rubbing = p.a.friction_arm_m > 0 or p.b.friction_arm_m > 0
    while done < most_revolutions and done * period < _MOST_S:
        times = np.arange(_CHUNK + 1) * period
        strobe = simulate(p, Scene(history, (True, True), state), times, accuracy).state
        near = [_first_near(strobe, s) for s in stable]
        for s, at in zip(stable, near, strict=True):
            if at is not None:
                return ReleaseOutcome(
                    s.type, s.theta_rad, (done + at) * period, done + _CHUNK, _turns(strobe[-1], start), s
                )
        if rubbing and _at_rest(strobe):
            return _held(strobe[-1], stable, start, done + _CHUNK, period)
        done += _CHUNK
        state = strobe[-1].copy()
        slipped = np.abs(state[2:4] - start) / (2 * math.pi)
        going_on = np.abs(strobe[-1, 2:4] - strobe[0, 2:4]) > 0.5 * math.pi
        if np.any((slipped > _SLIPPED_TURNS) & going_on):
            return _without_rest("slipping", state, start, done, period)
    return _without_rest("not settled", state, start, done, period)


def _at_rest(strobe: NDArray[np.floating]) -> bool:
    """Whether dry friction has all but stopped the pendulums: what is left is creep under the torque's ripple."""
    late = strobe[len(strobe) // 2 :]
    return bool(np.ptp(late[:, 2:4], axis=0).max() < _CREEP_RAD and np.ptp(late[:, :2], axis=0).max() < 1e-6)


def _held(
    state: NDArray[np.floating], stable: Sequence[SteadyState], start: NDArray[np.floating], done: int, period: float
) -> ReleaseOutcome:
    """Pendulums that dry friction holds: at a stable state when they lie within its band."""
    rest = _without_rest("held by friction", state, start, done, period)
    for s in stable:
        away = np.abs(np.angle(np.exp(1j * (state[2:4] - np.array(s.theta_rad)))))
        if np.all(away <= np.minimum(1.2 * np.array(s.stick_half_width_rad), _BESIDE_RAD)):
            return replace(rest, state=s.type, reached=s)
    return rest


def _without_rest(
    name: str, state: NDArray[np.floating], start: NDArray[np.floating], done: int, period: float
) -> ReleaseOutcome:
    theta = state[2:4] % (2 * math.pi)
    return ReleaseOutcome(name, (float(theta[0]), float(theta[1])), done * period, done, _turns(state, start), None)


def _turns(state: NDArray[np.floating], start: NDArray[np.floating]) -> tuple[float, float]:
    turns = (state[2:4] - start) / (2 * math.pi)
    return float(turns[0]), float(turns[1])


def _first_near(strobe: NDArray[np.floating], s: SteadyState) -> int | None:
    """The revolution from which the strobed states (n, 8) stay near a state's own; None when the last is not."""
    angle = np.abs(np.exp(1j * strobe[:, 2:4]) - np.exp(1j * s.start[2:4])).max(axis=1)
    size = max(s.amplitude_m, 1e-6)
    place = np.abs(strobe[:, :2] - s.start[:2]).max(axis=1) / size
    near = (angle < _NEAR_RAD) & ((place < 0.02) | (np.abs(strobe[:, :2] - s.start[:2]).max(axis=1) < 2e-6))
    if not near[-1]:
        return None
    away = np.flatnonzero(~near)
    return int(away[-1]) + 1 if len(away) else 0
