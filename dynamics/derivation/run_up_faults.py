"""Effect of the two faults of the source's run-up script on a release.

(a) The script evaluates the disk's accelerations before the pendulums' accelerations, so θ̈3, θ̈4 are zero in them.
    The disk acts on the pendulums, but their angular acceleration does not act on the disk.
(b) While a pendulum is locked, the script holds its angle but integrates its speed. This false speed acts on the disk
    through S φ̇² and is the pendulum's initial speed at release.
The script runs at full speed from the first instant, with the disk at rest. It contains no ramp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import C1, C2, CA, CB, JA, JB, K1, K2, MASS, SA, SB, SP
from dynamics.equations.parameters import Pendulum, RotorParameters

SCRIPT_SPEED_RAD_S = 2 * math.pi * 20


@dataclass(frozen=True)
class PrintedFaults:
    """Faults contained in the equations.

    Attributes:
        no_push_back: fault (a), the disk's equations do not contain θ̈3, θ̈4.
        speed_runs_on: fault (b), the speed of a locked pendulum is integrated.
    """

    without_reaction: bool = False
    integrates_locked_speed: bool = False


@dataclass(frozen=True)
class ReleaseMotion:
    """Computed motion of a release.

    Attributes:
        time_s: shape (n,), every tenth of a revolution.
        state: shape (n, 8): x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4 (SI; angles in rad relative to the rotor).
        released: index of the instant of release.
    """

    time_s: Array
    state: Array
    released: int

    @property
    def radius_m(self) -> Array:
        """Distance of the disk centre from its rest position, m, shape (n,)."""
        return np.hypot(self.state[:, 0], self.state[:, 1])

    @property
    def speed_at_release_rad_s(self) -> tuple[float, float]:
        """θ̇3, θ̇4 in the equations at the instant of release."""
        return float(self.state[self.released, 6]), float(self.state[self.released, 7])

    @property
    def final_angles_rad(self) -> Array:
        """Means of θ3, θ4 over the last five revolutions, not reduced, shape (2,)."""
        return self.state[-50:, 2:4].mean(axis=0)

    def settling_time_s(self, band_rad: float = math.radians(1.0)) -> float:
        """Time from release until both angles, averaged over a revolution, stay within the band about their end, s."""
        mean = np.column_stack([np.convolve(self.state[:, j], np.full(10, 0.1), "valid") for j in (2, 3)])
        outside = np.flatnonzero(np.any(np.abs(mean - mean[-1]) > band_rad, axis=1))
        return 0.0 if len(outside) == 0 else max(0.0, float(self.time_s[outside[-1]] - self.time_s[self.released]))


def script_rig() -> RotorParameters:
    """The run-up script's values: 500 N/m, 10 N s/m, 0.0005 N m s/rad, M_P twice 0.1209 kg."""
    mass, k, c = 7.0 + 0.2418 + 0.15, 500.0, 10.0
    pendulum = Pendulum(0.075, 0.054, 0.0005)
    zeta = c / (2 * math.sqrt(k * mass))
    return RotorParameters(7.0, 0.2418, 40 * 25.4e-3 / 48, pendulum, pendulum, k, k, zeta, zeta)


@compiled
def script_rates(
    y: Array,
    psi: float,
    omega: float,
    p: Array,
    locked: bool,
    without_reaction: bool,
    integrates_locked_speed: bool,
    out: Array,
) -> None:
    """Write dy/dt to out: the plain rig at constant speed, correct or with the script's faults.

    Args:
        y, out: shape (8,).
        psi, omega: rotor phase (rad) and speed (rad/s).
        p: RotorParameters.packed().
        locked: whether both pendulums are locked.
        without_reaction, integrates_locked_speed: the faults.
    """
    turning = not locked or integrates_locked_speed
    coupled = turning and not without_reaction
    fx = p[SP] * omega * omega * np.cos(psi) - p[K1] * y[0] - p[C1] * y[4]
    fy = p[SP] * omega * omega * np.sin(psi) - p[K2] * y[1] - p[C2] * y[5]
    mxx, mxy, myy = p[MASS], 0.0, p[MASS]
    for theta, rate, s, j, c in ((y[2], y[6], p[SA], p[JA], p[CA]), (y[3], y[7], p[SB], p[JB], p[CB])):
        speed = omega + (rate if turning else 0.0)
        nx, ny = np.sin(psi + theta), -np.cos(psi + theta)
        fx += s * speed * speed * -ny
        fy += s * speed * speed * nx
        if coupled:  # S θ̈ n with θ̈ = (S n·q̈ − c θ̇)/J
            fx -= s * c * rate / j * nx
            fy -= s * c * rate / j * ny
            mxx -= s * s / j * nx * nx
            mxy -= s * s / j * nx * ny
            myy -= s * s / j * ny * ny
    det = mxx * myy - mxy * mxy
    ax, ay = (myy * fx - mxy * fy) / det, (mxx * fy - mxy * fx) / det
    out[0], out[1], out[4], out[5] = y[4], y[5], ax, ay
    out[2], out[3] = (0.0, 0.0) if locked else (y[6], y[7])
    out[6] = out[7] = 0.0
    if turning:
        out[6] = (p[SA] * (np.sin(psi + y[2]) * ax - np.cos(psi + y[2]) * ay) - p[CA] * y[6]) / p[JA]
        out[7] = (p[SB] * (np.sin(psi + y[3]) * ax - np.cos(psi + y[3]) * ay) - p[CB] * y[7]) / p[JB]


@compiled
def _run(
    y: Array,
    omega: float,
    p: Array,
    release_turns: int,
    turns: int,
    steps: int,
    without_reaction: bool,
    integrates_locked_speed: bool,
) -> Array:
    """States every tenth of a revolution by classical Runge–Kutta with `steps` steps a revolution (multiple of ten)."""
    h = 2.0 * np.pi / omega / steps
    out = np.empty((10 * turns + 1, 8))
    out[0] = y
    k = np.empty((4, 8))
    for i in range(turns * steps):
        locked = i < release_turns * steps
        psi = 2.0 * np.pi * (i % steps) / steps
        half = omega * h / 2
        script_rates(y, psi, omega, p, locked, without_reaction, integrates_locked_speed, k[0])
        script_rates(y + h / 2 * k[0], psi + half, omega, p, locked, without_reaction, integrates_locked_speed, k[1])
        script_rates(y + h / 2 * k[1], psi + half, omega, p, locked, without_reaction, integrates_locked_speed, k[2])
        script_rates(y + h * k[2], psi + 2 * half, omega, p, locked, without_reaction, integrates_locked_speed, k[3])
        y = y + h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
        if (i + 1) % (steps // 10) == 0:
            out[(i + 1) // (steps // 10)] = y
    return out


def release(
    parameters: RotorParameters,
    speed_rad_s: float,
    faults: PrintedFaults,
    locked_s: float = 12.0,
    free_s: float = 60.0,
    steps_per_revolution: int = 200,
) -> ReleaseMotion:
    """Run at full speed from rest with pendulums locked at 0° and 180° + 0.001 rad, as in the script, and release.

    Args:
        parameters: a plain rig: two pendulums; no pivot shift, gravity, dry friction or balls.
        speed_rad_s: running speed, rad/s.
        faults: faults of the equations.
        locked_s, free_s: times before and after the release, s (rounded up to whole revolutions).
        steps_per_revolution: steps of the Runge–Kutta method; a multiple of 10.
    """
    turn = 2 * math.pi / speed_rad_s
    locked_turns, turns = math.ceil(locked_s / turn), math.ceil(locked_s / turn) + math.ceil(free_s / turn)
    start = np.array([0.0, 0.0, 0.0, math.pi + 1e-3, 0.0, 0.0, 0.0, 0.0])
    packed = parameters.packed()
    state = _run(
        start,
        speed_rad_s,
        packed,
        locked_turns,
        turns,
        steps_per_revolution,
        faults.without_reaction,
        faults.integrates_locked_speed,
    )
    return ReleaseMotion(np.arange(len(state)) * turn / 10, state, 10 * locked_turns)
