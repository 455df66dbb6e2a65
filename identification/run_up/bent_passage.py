# pyright: strict
"""A passage of a rig whose suspension depends on the motion, as a sensor sees it, linear about one motion.

Each sensor's readings are its gain times the motion. In a sensor's own scale the equations hold with the terms as the
ring-downs found them through the same sensor, so its gain drops out. Source: docs/theory/run_up.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from identification.run_up.bent_oscillator import bent_response, forcing
from identification.run_up.forced_oscillator import Drive, Instants, Response
from identification.run_up.slow_roll import turning

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FREE = 2  # place of the free oscillations among a sensor's linear unknowns, after the imbalance's amplitude
MOTION = 6  # first linear unknowns, which the motion depends on: amplitude, free oscillations of both modes; then a bow


@dataclass(frozen=True)
class KnownSuspension:
    """What ring-downs have found before a passage.

    Attributes:
        terms: H1, H2 (1/m²), Q1, Q2 (s/m), shape (4,).
        terms_std: standard deviations, 0 where there is none, shape (4,).
        omegas, zetas: at zero amplitude, to start from.
        angle_rad: from the stiffness x axis to the sensor x axis.
        amplitude_m: eccentricity of all that turns by the rig file, against ψ: one of two places to start from.
    """

    terms: Array
    terms_std: Array
    omegas: tuple[float, float]
    zetas: tuple[float, float]
    angle_rad: float
    amplitude_m: complex


@dataclass(frozen=True)
class Sensed:
    """What a sensor sees of both modes, linear about a motion.

    Attributes:
        responses: as of linear oscillators: h goes with a change of the amplitude, the others with it as a whole.
        whole: per mode the motion over its amplitude, complex.
        offset: what the sensor shows beside its amplitudes times the responses, m, shape (n,).
        by_terms: derivatives of what it shows by H1, H2, Q1, Q2, shape (n, 4).
        by_ratio: derivative by ln of the gains' ratio, shape (n,).
        bow: what goes with a change of the bow's amplitude, complex, shape (n,); zero for a straight shaft.
    """

    responses: list[Response]
    whole: list[Complex]
    offset: Array
    by_terms: Array
    by_ratio: Array
    bow: Complex


@dataclass(frozen=True)
class BentPassage:
    """What a passage with terms needs beside its record.

    Attributes:
        force: of the drive, as forcing has it.
        amplitude_m: to start from.
        starts: per sensor the linear unknowns last found that the motion depends on, to start from.
    """

    force: Complex
    amplitude_m: complex
    starts: dict[int, Array] = field(default_factory=dict[int, Array])

    @classmethod
    def of(cls, drive: Drive, amplitude_m: complex) -> BentPassage:
        """On a drive."""
        return cls(forcing(drive), amplitude_m)

    def sensed(
        self,
        drive: Drive,
        axis: int,
        angle_rad: float,
        oscillators: list[tuple[float, float]],
        terms: Array,
        gain_ratio: float,
        instants: Instants,
        c: Array,
    ) -> Sensed:
        """What a sensor sees about the motion of its linear unknowns.

        Args:
            axis: 0 for sensor x, 1 for y.
            terms: H1, H2, Q1, Q2, each in its own sensor's scale.
            gain_ratio: of sensor y over sensor x.
            instants: of its blocks.
            c: amplitude and free oscillations, and the bow's amplitude where the shaft may be bent, shape (6,) or (8,).
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
            own = mode == axis  # the other mode's free oscillation is seen too weakly to bend it
            at = FREE + 2 * mode
            free = complex(c[at], c[at + 1]) / share[mode] if own else 0j
            powers = (mode - axis) * np.array([2.0, 1.0])  # of the ratio: H goes with its square
            scale = gain_ratio**powers
            h, q = (scale * terms[[mode, 2 + mode]]).tolist()
            seen = bent_response(instants[1], turn, drive, self.force, oscillator, (h, q), b, free, bow)
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
