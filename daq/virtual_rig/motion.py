"""The true motion, on a fixed 4 kHz grid of rig time."""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynamics.equations.kernels import rk4_step
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.friction_steps import friction_step
from dynamics.motions.integrate import fastest_rate

GRID_S = 250e-6
_BRAKE_LAG_S = 0.01


@njit(cache=True, error_model="numpy")
def _turn(rotor, h, target, ramp, slip, lag, out):
    """Advance phase, speed and commanded speed by h; write (ψ, ω, α) at the end into out."""
    step = ramp * h
    rotor[2] += min(max(target - rotor[2], -step), step)
    goal = rotor[2] * (1.0 - slip)
    if rotor[2] == 0.0 and target == 0.0 and abs(rotor[1]) < 1e-3:
        rotor[1] = 0.0  # static friction holds the rotor
        out[0], out[1], out[2] = rotor[0], 0.0, 0.0
        return
    decay = math.exp(-h / lag)
    rotor[0] += goal * h + (rotor[1] - goal) * lag * (1.0 - decay)
    rotor[1] = goal + (rotor[1] - goal) * decay
    out[0], out[1], out[2] = rotor[0], rotor[1], (goal - rotor[1]) / lag


@njit(cache=True, error_model="numpy")
def _advance(y, rotor, phase, target, ramp, slip, lag, n, substeps, p, rough, free, held, held_at, angles, drift, out):
    """n grid steps, with dry friction where it is rough; out[i] = state (8), ψ, ω after step i."""
    h = 250e-6 / substeps
    scratch = np.empty((5, 8))
    modes, signed = np.empty(2), p.copy()
    ph = np.empty((3, 3))
    ph[0] = phase
    for i in range(n):
        for _ in range(substeps):
            _turn(rotor, h / 2, target, ramp, slip, lag, ph[1])
            _turn(rotor, h / 2, target, ramp, slip, lag, ph[2])
            if rough:
                friction_step(
                    y,
                    h,
                    ph[0],
                    ph[1],
                    ph[2],
                    p,
                    free,
                    modes,
                    signed,
                    scratch[0],
                    scratch[1],
                    scratch[2],
                    scratch[3],
                    scratch[4],
                )
            else:
                rk4_step(
                    y,
                    h,
                    ph[0],
                    ph[1],
                    ph[2],
                    p,
                    free[0],
                    free[1],
                    scratch[0],
                    scratch[1],
                    scratch[2],
                    scratch[3],
                    scratch[4],
                )
            ph[0] = ph[2]
        for j in range(2):
            if free[j] == 0.0:  # the lock carries the pendulum towards its position
                gap = angles[j] - y[2 + j]
                y[2 + j] += min(max(gap, -drift * 250e-6), drift * 250e-6)
                y[6 + j] = 0.0
        if held:
            y[0], y[1], y[4], y[5] = held_at[0], held_at[1], 0.0, 0.0
        for j in range(8):
            out[i, j] = y[j]
        out[i, 8], out[i, 9] = ph[0, 0], ph[0, 1]
    phase[:] = ph[0]


@njit(cache=True, error_model="numpy")
def _hermite(time_s, first_s, rows, value, rate):
    """See Trajectory.at."""
    out = np.empty(time_s.shape[0])
    for k in range(time_s.shape[0]):
        past = (time_s[k] - first_s) / GRID_S
        i = min(max(int(past), 0), rows.shape[0] - 2)
        u = (time_s[k] - (first_s + i * GRID_S)) / GRID_S
        a, b = rows[i, value], rows[i + 1, value]
        da, db = rows[i, rate] * GRID_S, rows[i + 1, rate] * GRID_S
        out[k] = a + u * (da + u * (3 * (b - a) - 2 * da - db + u * (2 * (a - b) + da + db)))
    return out


@dataclass
class Trajectory:
    """The motion over the last step, on the grid, its first row being the last of the step before.

    Attributes:
        time_s: shape (n + 1,).
        rows: shape (n + 1, 10): x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4, ψ, ω.
    """

    time_s: NDArray[np.floating]
    rows: NDArray[np.floating]

    def at(self, time_s: NDArray[np.floating], value: int, rate: int) -> NDArray[np.floating]:
        """Cubic Hermite interpolation of one column with its rate's column; shape of time_s."""
        return _hermite(np.asarray(time_s, np.float64), float(self.time_s[0]), self.rows, value, rate)


class Motion:
    """Rotor, column and pendulums of the simulated rig.

    Attributes:
        time_s: rig time reached.
        target_rad_s, ramp_rad_s2: what the drive wants.
        braking: whether it brakes at its current limit, where the speed loop's lag plays no part.
    """

    def __init__(self, physics: RotorParameters, slip: float, lag_s: float) -> None:
        self.physics = physics
        self.time_s = 0.0
        self.target_rad_s = 0.0
        self.ramp_rad_s2 = 1.0
        self.braking = False
        self._slip, self._lag = slip, max(lag_s, 1e-3)
        self._steps = 0
        self._state = np.zeros(8)
        self._state[3] = math.pi
        self._rotor = np.zeros(3)  # ψ, ω, commanded ω
        self._phase = np.zeros(3)
        self._free = np.zeros(2)
        self._angles = np.array([0.0, math.pi])
        self._held = False
        self._held_at = np.zeros(2)
        self._last = np.concatenate([self._state, [0.0, 0.0]])

    @property
    def speed_rad_s(self) -> float:
        """True rotor speed."""
        return float(self._rotor[1])

    @property
    def angles_rad(self) -> NDArray[np.floating]:
        """True θ3, θ4."""
        return self._state[2:4].copy()

    @property
    def displacement_m(self) -> NDArray[np.floating]:
        """True x, y."""
        return self._state[:2].copy()

    def held(self, pendulum: int) -> bool:
        """Whether a pendulum is locked, or on its way there."""
        return bool(self._free[pendulum] == 0.0)

    def lock(self, pendulum: int, play_rad: float) -> None:
        """Carry a pendulum to its locked position (0 for A, half a turn for B) and hold it there."""
        base = math.pi * pendulum
        turns = round((self._state[2 + pendulum] - base) / (2 * math.pi))
        self._angles[pendulum] = base + 2 * math.pi * turns + play_rad
        self._free[pendulum] = 0.0

    def locked_in(self, pendulum: int) -> bool:
        """Whether a locked pendulum has reached its position."""
        return self._free[pendulum] == 0.0 and abs(self._state[2 + pendulum] - self._angles[pendulum]) < 1e-9

    def release(self, pendulum: int) -> None:
        """Let a pendulum go with the rotor's speed."""
        self._free[pendulum] = 1.0

    def hold(self, x_m: float, y_m: float) -> None:
        """Hold the column displaced."""
        self._held, self._held_at[:] = True, (x_m, y_m)

    def let_go(self) -> None:
        """End a hold."""
        self._held = False

    def flick(self, pendulum: int, speed_rad_s: float) -> bool:
        """Give a free pendulum a speed; False when it is locked."""
        if self._free[pendulum] == 0.0:
            return False
        self._state[6 + pendulum] = speed_rad_s
        return True

    def advance(self, until_s: float) -> Trajectory | None:
        """Integrate up to the last grid point not after until_s; None when there is none."""
        n = int(until_s / GRID_S) - self._steps
        if n <= 0:
            return None
        rows = np.empty((n + 1, 10))
        rows[0] = self._last
        lag = min(self._lag, _BRAKE_LAG_S) if self.braking else self._lag
        rate = fastest_rate(self.physics, max(abs(self.speed_rad_s), abs(self.target_rad_s)))
        substeps = max(1, math.ceil(rate * GRID_S / 0.5))
        _advance(
            self._state,
            self._rotor,
            self._phase,
            self.target_rad_s,
            self.ramp_rad_s2,
            self._slip,
            lag,
            n,
            substeps,
            self.physics.packed(),
            self.physics.has_friction,
            self._free,
            self._held,
            self._held_at,
            self._angles,
            2 * math.pi,
            rows[1:],
        )
        times = (self._steps + np.arange(n + 1)) * GRID_S
        self._steps += n
        self.time_s = self._steps * GRID_S
        self._last = rows[-1].copy()
        return Trajectory(times, rows)
