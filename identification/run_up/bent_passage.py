"""Passage of a rig with an amplitude-dependent suspension, as measured by a sensor and linearised about one motion.

The readings of a sensor are its gain times the motion. In the scale of the sensor the equations are valid with the
terms that ring-downs found with the same sensor, so that the gain cancels. Source: docs/theory/run_up.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from identification.run_up.bent_oscillator import BentDirection, bent_response, forcing
from identification.run_up.forced_oscillator import Excitation, Instants, Response
from identification.run_up.slow_roll import turning
from rig_basics.arrays import Array, Complex

FREE = 2  # index of the free oscillations in a sensor's linear unknowns, after the amplitude of the imbalance
MOTION = 6  # number of leading linear unknowns of the motion: amplitude, free oscillations of both modes; then a bow


@dataclass(frozen=True)
class KnownSuspension:
    """Parameters of the suspension from ring-downs, as start values of a passage.

    Attributes:
        terms: H1, H2 (1/m²), Q1, Q2 (s/m), shape (4,).
        terms_std: standard deviations of the terms, 0 for absent terms, shape (4,).
        omegas, zetas: natural frequencies, rad/s, and damping ratios at zero amplitude.
        angle_rad: angle from the stiffness x axis to the sensor x axis, rad.
        amplitude_m: eccentricity of the rotor by the rig file relative to ψ, m; one of two start values.
    """

    terms: Array
    terms_std: Array
    omegas: tuple[float, float]
    zetas: tuple[float, float]
    angle_rad: float
    amplitude_m: complex


@dataclass(frozen=True)
class Sensed:
    """Signal of both modes in a sensor, linearised about a motion.

    Attributes:
        responses: responses of the modes: h is the derivative by the amplitude, the other fields are relative to it.
        whole: motion of each mode over its amplitude, complex.
        offset: signal minus the amplitudes times the responses, m, shape (n,).
        by_terms: derivatives of the signal by H1, H2, Q1, Q2, shape (n, 4).
        by_ratio: derivative of the signal by the logarithm of the gains' ratio, shape (n,).
        bow: derivative by the amplitude of the bow, complex, shape (n,); zero for a straight shaft.
    """

    responses: list[Response]
    whole: list[Complex]
    offset: Array
    by_terms: Array
    by_ratio: Array
    bow: Complex


@dataclass(frozen=True)
class BentPassage:
    """Additional data of a passage with an amplitude-dependent suspension.

    Attributes:
        force: force of the drive by `forcing`.
        amplitude_m: start value of the amplitude, m.
        starts: sensor → linear unknowns of the motion that were last found, as start values.
    """

    force: Complex
    amplitude_m: complex
    starts: dict[int, Array] = field(default_factory=dict[int, Array])

    @classmethod
    def of(cls, drive: Excitation, amplitude_m: complex) -> BentPassage:
        """Build the data for a drive."""
        return cls(forcing(drive), amplitude_m)

    def sensed(
        self,
        drive: Excitation,
        axis: int,
        angle_rad: float,
        oscillators: list[tuple[float, float]],
        terms: Array,
        gain_ratio: float,
        instants: Instants,
        c: Array,
    ) -> Sensed:
        """Linearise the signal of a sensor about the motion of its linear unknowns.

        Args:
            drive: drive.
            axis: 0 for sensor x, 1 for y.
            angle_rad: angle between stiffness axes and sensors, rad.
            oscillators: ω, rad/s, and ζ of both modes.
            terms: H1, H2, Q1, Q2, each in the scale of the sensor of its direction.
            gain_ratio: gain of sensor y over that of sensor x.
            instants: times of the sensor's blocks.
            c: amplitude, free oscillations and, for a bent shaft, amplitude of the bow, shape (6,) or (8,), m.
        """
        cos, sin = float(np.cos(angle_rad)), float(np.sin(angle_rad))
        share = ((cos, sin), (-sin, cos))[axis]
        amplitude, bowed = complex(c[0], c[1]), complex(c[MOTION], c[MOTION + 1]) if len(c) > MOTION else None
        n, turn = len(instants[0]), turning(drive, *instants)
        none = np.zeros(n, np.complex128)
        found = Sensed([], [], np.zeros(n), np.zeros((n, 4)), np.zeros(n), none.copy())
        for mode, oscillator in enumerate(oscillators):
            toward = (1.0, -1j)[mode]
            b, bow = amplitude * toward, None if bowed is None else bowed * toward
            own = mode == axis  # the other mode's free oscillation is too weak for an amplitude dependence
            at = FREE + 2 * mode
            free = complex(c[at], c[at + 1]) / share[mode] if own else 0j
            powers = (mode - axis) * np.array([2.0, 1.0])  # exponents of the ratio: H scales with its square
            scale = gain_ratio**powers
            h, q = (scale * terms[[mode, 2 + mode]]).tolist()
            seen = bent_response(instants[1], turn, drive, self.force, BentDirection(oscillator, (h, q), b, free, bow))
            plain = (b * seen.by_drive).real + (free * seen.by_free).real
            if bow is not None and seen.by_bow is not None:
                plain += (bow * seen.by_bow).real
                found.bow[:] += share[mode] * toward * seen.by_bow
            found.offset[:] += share[mode] * (seen.motion - plain)
            by_terms = share[mode] * scale[:, None] * np.array(seen.by_terms)
            found.by_terms[:, [mode, 2 + mode]] = by_terms.T
            found.by_ratio[:] += (powers * terms[[mode, 2 + mode]]) @ by_terms
            found.whole.append(seen.motion / b)
            found.responses.append(
                Response(seen.by_drive, seen.rate / b, seen.by_omega / b, seen.by_zeta / b, seen.by_free, none)
            )
        return found
