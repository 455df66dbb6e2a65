"""State of the rig at the release: both pendulums are locked, and the imbalance drives the disk at the recorded speed.

The locked rig is two linear oscillators, ḧ + 2ζω ḣ + ω² h = (ψ̇² − iψ̈) e^{iψ} per direction, x = Re(A h1),
y = Im(A h2), A = (S_P + S_A e^{iθ3} + S_B e^{iθ4})/M_S. A bow b adds b h_b, which follows from h
(identification.run_up.slow_roll). Since h is independent of the locked angles and the imbalance, the state's
derivatives by them are products. Derivatives by stiffness and damping are differences of h at neighbouring ω and ζ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from dynamics.equations.parameters import RotorParameters
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.locked_motion import locked_orbit
from rig_basics.arrays import Complex

_STEP_S = 2e-3
_EQUIVALENT = 4  # iterations of the equivalent linear suspension
_DIFFERENCE = 1e-5  # step of ln ω and ln ζ


@dataclass(frozen=True)
class LockedStart:
    """Drive of the locked rig up to a release.

    Attributes:
        history: recorded rotor phase.
        begin_s: start of the recorded phase, s.
        release_s: recorded instant of the release, s.
    """

    history: SpeedHistory
    begin_s: float
    release_s: float

    @property
    def speed_rad_s(self) -> float:
        """Rotor speed at the release, rad/s."""
        return float(self.history.phase(self.release_s)[0, 1])

    def along(self, history: SpeedHistory) -> LockedStart:
        """Return the same with another rotor phase."""
        return LockedStart(history, self.begin_s, self.release_s)

    def at(
        self, physics: RotorParameters, theta3_rad: float, theta4_rad: float, shift_s: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the state at the release and its derivatives.

        Args:
            physics: parameters, of which suspension and imbalance have an effect.
            theta3_rad, theta4_rad: true locked angles, rad.
            shift_s: instant of the release minus `release_s`, s.
        Returns:
            State (8,), and derivatives (8, 8) by θ3, θ4, shift, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P.
        """
        p, turn = self._equivalent(physics, theta3_rad, theta4_rad), np.exp(1j * np.array([theta3_rad, theta4_rad]))
        moments = np.array([p.a.first_moment_kg_m, p.b.first_moment_kg_m]) * turn
        moment, mass = (p.forcing_moment_kg_m + moments.sum()) / p.total_mass_kg, p.total_mass_kg
        by_moment = np.r_[1j * moments, p.imbalance_moment_kg_m] / mass  # by θ3, θ4, ln S_P
        state, derivatives = np.zeros(8), np.zeros((8, 8))
        state[2:4] = theta3_rad, theta4_rad
        derivatives[2, 0] = derivatives[3, 1] = 1.0
        for axis, (w, zeta) in enumerate(zip(p.natural_frequencies_rad_s, (p.zeta1, p.zeta2), strict=True)):
            h, by_omega, by_zeta = self._response(w, zeta, shift_s)
            bow, bow_by_omega, bow_by_zeta = self._of_bow(p.bow_m, (h, by_omega, by_zeta), w, zeta, shift_s)
            for row, order in ((axis, 0), (4 + axis, 1)):
                state[row] = _part(axis, moment * h[order] + bow[order])
                derivatives[row, [0, 1, 7]] = [_part(axis, b * h[order]) for b in by_moment]
                derivatives[row, 2] = _part(axis, moment * h[order + 1] + bow[order + 1])
                derivatives[row, 3 + axis] = 0.5 * _part(axis, moment * by_omega[order] + bow_by_omega[order])
                derivatives[row, 5 + axis] = _part(axis, moment * by_zeta[order] + bow_by_zeta[order])
        sag = mass * p.gravity_m_per_s2 / p.k2_N_per_m
        state[1] -= sag
        derivatives[1, 4] += sag
        return state, derivatives

    def _equivalent(self, physics: RotorParameters, theta3_rad: float, theta4_rad: float) -> RotorParameters:
        """Return the parameters with the equivalent linear suspension on the locked orbit at the release's speed.

        A spring k u (1 + H u²) at the amplitude a is equivalent to k (1 + ¾ H a²), a damper c v (1 + Q |v|) to
        c (1 + 8/(3π) Q a ω). The remaining third harmonic of at most H a²/32 is far below the uncertainty of the disk's
        position in a release.
        """
        p = physics
        if p.suspension_is_linear:
            return p
        speed = self.speed_rad_s
        linear = replace(p, hardening_per_m2=(0.0, 0.0), damping_growth_s_per_m=(0.0, 0.0))
        found = linear
        for _ in range(_EQUIVALENT):  # each iteration reduces the error by the relative change of stiffness and damping
            x, y = locked_orbit(found, speed, theta3_rad, theta4_rad)
            stretch, going = (abs(x - p.bow_m), abs(y - p.bow_m)), (abs(x) * speed, abs(y) * speed)
            stiffer = [1 + 0.75 * h * a**2 for h, a in zip(p.hardening_per_m2, stretch, strict=True)]
            damped = [1 + 8 / (3 * np.pi) * q * v for q, v in zip(p.damping_growth_s_per_m, going, strict=True)]
            found = linear.with_values(
                k1_N_per_m=p.k1_N_per_m * stiffer[0],
                k2_N_per_m=p.k2_N_per_m * stiffer[1],
                zeta1=p.zeta1 * damped[0] / stiffer[0] ** 0.5,
                zeta2=p.zeta2 * damped[1] / stiffer[1] ** 0.5,
            )
        return found

    def _of_bow(
        self,
        bow: complex,
        response: tuple[np.ndarray, np.ndarray, np.ndarray],
        omega: float,
        zeta: float,
        shift_s: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return b h_b with its first two rates, and derivatives of the first two by ln ω and ln ζ; 0 without a bow."""
        if bow == 0:
            return np.zeros(3), np.zeros(2), np.zeros(2)
        h, by_omega, by_zeta = response
        psi, speed, _ = self.history.phase(self.release_s + shift_s)[0]
        p = np.exp(1j * psi)
        lag, width = 2 * zeta / omega, 2 * zeta * omega
        moved = h[1] + 1j * speed * p
        answer, rate = (1 - lag * width) * h[0] + p - lag * moved, moved + width * h[0]
        bent = omega**2 * (p - answer) - width * rate
        of_omega = [
            (1 - lag * width) * by_omega[0] - lag * (by_omega[1] - moved),
            by_omega[1] + width * (h[0] + by_omega[0]),
        ]
        of_zeta = [
            (1 - lag * width) * by_zeta[0] - lag * (by_zeta[1] + moved) - 2 * lag * width * h[0],
            by_zeta[1] + width * (h[0] + by_zeta[0]),
        ]
        return bow * np.array([answer, rate, bent]), bow * np.array(of_omega), bow * np.array(of_zeta)

    def _response(self, omega: float, zeta: float, shift_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return complex h, ḣ, ḧ at the release, and derivatives of h, ḣ by ln ω and ln ζ."""
        base = self._march(omega, zeta, shift_s)
        more = np.exp(_DIFFERENCE)
        by_omega = (self._march(omega * more, zeta, shift_s) - base) / _DIFFERENCE
        by_zeta = (self._march(omega, zeta * more, shift_s) - base) / _DIFFERENCE
        return base, by_omega[:2], by_zeta[:2]

    def _march(self, omega: float, zeta: float, shift_s: float) -> np.ndarray:
        """Return h, ḣ, ḧ at the release, starting with the steady orbit at `begin_s`."""
        force, step = self._force
        psi, speed, _ = self.history.phase(self.begin_s)[0]
        g = 2 * zeta * omega
        turn = np.exp(1j * psi) * speed**2 / (omega**2 - speed**2 + 1j * g * speed)
        h, rate = _oscillate(force, step, omega**2, g, turn, 1j * speed * turn)
        if shift_s:
            last = self._drive(self.release_s + shift_s * np.array([0.0, 0.5, 1.0]))
            h, rate = _oscillate(last, shift_s, omega**2, g, h, rate)
            return np.array([h, rate, last[2] - g * rate - omega**2 * h])
        return np.array([h, rate, force[-1] - g * rate - omega**2 * h])

    @cached_property
    def _force(self) -> tuple[np.ndarray, float]:
        """Drive on a grid of half steps, which is the same for every trial, and the step, s."""
        n = max(1, int(np.ceil((self.release_s - self.begin_s) / _STEP_S)))
        step = (self.release_s - self.begin_s) / n
        return self._drive(self.begin_s + 0.5 * step * np.arange(2 * n + 1)), step

    def _drive(self, time_s: np.ndarray) -> np.ndarray:
        psi, speed, acceleration = self.history.phase(time_s).T
        return (speed**2 - 1j * acceleration) * np.exp(1j * psi)


def _part(axis: int, value: complex) -> float:
    return float(value.imag if axis else value.real)


@njit(cache=True, nogil=True, error_model="numpy")
def _oscillate(force: Complex, step: float, w2: float, g: float, h: complex, rate: complex) -> tuple[complex, complex]:
    """Return h, ḣ after all steps of the force by classical Runge–Kutta; the force includes the mid-points."""
    for i in range((len(force) - 1) // 2):
        u0, u1, u2 = force[2 * i], force[2 * i + 1], force[2 * i + 2]
        a1 = u0 - g * rate - w2 * h
        r2 = rate + 0.5 * step * a1
        a2 = u1 - g * r2 - w2 * (h + 0.5 * step * rate)
        r3 = rate + 0.5 * step * a2
        a3 = u1 - g * r3 - w2 * (h + 0.5 * step * r2)
        r4 = rate + step * a3
        a4 = u2 - g * r4 - w2 * (h + step * r3)
        h += step / 6.0 * (rate + 2.0 * r2 + 2.0 * r3 + r4)
        rate += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return h, rate
