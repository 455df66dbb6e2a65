"""The true motion of the simulated rig on a fixed 4 kHz grid of rig time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled_code import compiled
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.friction_steps import friction_step
from dynamics.motions.integrate import fastest_rate
from rig_basics.arrays import Array

GRID_S = 250e-6
"""Period of the grid, s."""
_MAX_BRAKE_LAG_S = 0.01  # time constant of the speed while the drive brakes at its current limit


@compiled(part=True)
def _turn(rotor: Array, h: float, target: float, ramp: float, slip: float, lag: float, out: Array) -> None:
    """Advance phase, speed and commanded speed by h; write (ψ, ω, α) at the end to out.

    Args:
        rotor: ψ in rad, ω and commanded ω in rad/s, shape (3,); changed in place.
        h: step, s.
        target, ramp: target speed, rad/s, and slope of the commanded speed, rad/s².
        slip: slip of the drive, relative.
        lag: time constant of the speed loop, s.
        out: ψ, ω, α at the end of the step, shape (3,).
    """
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


@compiled(part=True)
def _constrain(y: Array, free: Array, held: bool, held_at: Array, angles: Array, drift: float) -> None:
    """Move locked pendulums towards their locks by one grid step, and keep a held column at its place.

    Args: see `_advance`.
    """
    for j in range(2):
        if free[j] == 0.0:
            gap = angles[j] - y[2 + j]
            y[2 + j] += min(max(gap, -drift * GRID_S), drift * GRID_S)
            y[6 + j] = 0.0
    if held:
        y[0], y[1], y[4], y[5] = held_at[0], held_at[1], 0.0, 0.0


# More than eight parameters: numba compiles scalars and arrays, not objects.
@compiled
def _advance(
    y: Array,
    rotor: Array,
    phase: Array,
    target: float,
    ramp: float,
    slip: float,
    lag: float,
    n: int,
    substeps: int,
    p: Array,
    free: Array,
    held: bool,
    held_at: Array,
    angles: Array,
    drift: float,
    out: Array,
) -> None:
    """Integrate n grid steps.

    Args:
        y: state of the motion, shape (8,); changed in place.
        rotor, target, ramp, slip, lag: see `_turn`.
        phase: ψ, ω, α, shape (3,); changed in place.
        n, substeps: number of grid steps, and of integration steps in each of them.
        p: packed parameters (`RotorParameters.packed`).
        free: 1 for a free pendulum, 0 for a locked one, shape (2,).
        held, held_at: whether the column is held, and its displacement, m, shape (2,).
        angles: positions of the locks, rad, shape (2,).
        drift: speed at which a lock moves a pendulum to its position, rad/s.
        out: state (8), ψ, ω after each grid step, shape (n, 10).
    """
    h = GRID_S / substeps
    k = np.empty((5, 8))
    modes, signed = np.empty(2), p.copy()
    ph = np.empty((3, 3))
    for j in range(3):
        ph[0, j] = phase[j]
    for i in range(n):
        for _ in range(substeps):
            _turn(rotor, h / 2, target, ramp, slip, lag, ph[1])
            _turn(rotor, h / 2, target, ramp, slip, lag, ph[2])
            friction_step(y, h, ph[0], ph[1], ph[2], p, free, modes, signed, k[0], k[1], k[2], k[3], k[4])
            for j in range(3):
                ph[0, j] = ph[2, j]
        _constrain(y, free, held, held_at, angles, drift)
        for j in range(8):
            out[i, j] = y[j]
        out[i, 8], out[i, 9] = ph[0, 0], ph[0, 1]
    for j in range(3):
        phase[j] = ph[0, j]


@compiled
def _hermite(time_s: Array, first_s: float, rows: Array, value: int, rate: int) -> Array:
    """Interpolate a column of rows; see Trajectory.at."""
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
class StepTrajectory:
    """The motion over the last step on the grid. Its first row is the last row of the step before.

    Attributes:
        time_s: rig time, s, shape (n + 1,).
        rows: x, y in m, θ3, θ4 in rad, their rates, ψ in rad and ω in rad/s, shape (n + 1, 10).
    """

    time_s: Array
    rows: Array

    def at(self, time_s: NDArray[np.floating], value: int, rate: int) -> NDArray[np.floating]:
        """Interpolate one column with cubic Hermite polynomials.

        Args:
            time_s: rig times, s, shape (m,).
            value, rate: numbers of the column and of the column of its rate.

        Returns:
            Interpolated values, shape (m,).
        """
        return _hermite(np.asarray(time_s, np.float64), float(self.time_s[0]), self.rows, value, rate)


class SimulatedMotion:
    """Rotor, column and pendulums of the simulated rig.

    Args:
        physics: true parameters.
        slip: slip of the drive, relative.
        lag_s: time constant of the speed loop, s.

    Attributes:
        physics: true parameters.
        time_s: rig time reached, s.
        target_rad_s, ramp_rad_s2: target speed and ramp of the drive.
        braking: whether the drive brakes at its current limit, which makes the speed follow faster than the speed loop.
    """

    def __init__(self, physics: RotorParameters, slip: float, lag_s: float) -> None:
        self.physics = physics
        self.time_s: float = 0.0
        self.target_rad_s: float = 0.0
        self.ramp_rad_s2: float = 1.0
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
        """True rotor speed, rad/s."""
        return float(self._rotor[1])

    @property
    def angles_rad(self) -> NDArray[np.floating]:
        """True θ3, θ4, rad, shape (2,)."""
        return self._state[2:4].copy()

    @property
    def displacement_m(self) -> NDArray[np.floating]:
        """True x, y, m, shape (2,)."""
        return self._state[:2].copy()

    def held(self, pendulum: int) -> bool:
        """Return whether a pendulum is locked, or is being moved to its lock."""
        return bool(self._free[pendulum] == 0.0)

    def lock(self, pendulum: int, play_rad: float) -> None:
        """Move a pendulum to its lock (0 for A, half a turn for B) and hold it there.

        Args:
            pendulum: 0 for A, 1 for B.
            play_rad: position within the play of the lock, rad.
        """
        base = math.pi * pendulum
        turns = round((self._state[2 + pendulum] - base) / (2 * math.pi))
        self._angles[pendulum] = base + 2 * math.pi * turns + play_rad
        self._free[pendulum] = 0.0

    def locked_in(self, pendulum: int) -> bool:
        """Return whether a locked pendulum has reached its lock."""
        return self._free[pendulum] == 0.0 and abs(self._state[2 + pendulum] - self._angles[pendulum]) < 1e-9

    def release(self, pendulum: int) -> None:
        """Release a pendulum with the speed of the rotor."""
        self._free[pendulum] = 1.0

    def hold(self, x_m: float, y_m: float) -> None:
        """Hold the column at a displacement."""
        self._held, self._held_at[:] = True, (x_m, y_m)

    def release_column(self) -> None:
        """Release the column."""
        self._held = False

    def flick(self, pendulum: int, speed_rad_s: float) -> bool:
        """Give a free pendulum a speed. Return False if it is locked."""
        if self._free[pendulum] == 0.0:
            return False
        self._state[6 + pendulum] = speed_rad_s
        return True

    def advance(self, until_s: float) -> StepTrajectory | None:
        """Integrate up to the last grid point not after until_s. Return None if no new grid point is reached."""
        n = int(until_s / GRID_S) - self._steps
        if n <= 0:
            return None
        rows = np.empty((n + 1, 10))
        rows[0] = self._last
        lag = min(self._lag, _MAX_BRAKE_LAG_S) if self.braking else self._lag
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
            self._free,
            self._held,
            self._held_at,
            self._angles,
            2 * math.pi,
            rows[1:],
        )
        times = (self._steps + np.arange(n + 1, dtype=np.float64)) * GRID_S
        self._steps += n
        self.time_s = self._steps * GRID_S
        self._last = rows[-1].copy()
        return StepTrajectory(times, rows)
