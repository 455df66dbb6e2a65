"""Motion once per turn besides the response to the imbalance: run-out, a bent shaft, a motion that grows with speed.

Run-out r adds r e^{iψ}. A bow b turns the rest position of the springs with the shaft,

    ḧ_b + 2ζω ḣ_b + ω² h_b = ω² e^{iψ},

and adds b h_b to the motion of the disk. Let h be the response to the imbalance, driven by −d²/dt² e^{iψ}. Then
h + e^{iψ} = g is driven by ω² e^{iψ} + 2ζω d/dt e^{iψ}, hence g = h_b + (2ζ/ω) ḣ_b, ġ = ḣ_b − 2ζω h, and

    h_b = g − (2ζ/ω) (ġ + 2ζω h),    ḣ_b = ġ + 2ζω h.

The response to the bow thus follows from that to the imbalance. A force that is proportional to the square of the speed
and acts far below a resonance adds a displacement g (−d²/dt² e^{iψ})/Ω², with Ω the fastest speed of the passage: the
tilt of the disk by a couple unbalance, or a stand of the lasers that moves. Source: docs/theory/run_up.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.run_up.forced_oscillator import Excitation, Response
from rig_basics.arrays import Array, Complex


@dataclass(frozen=True)
class PhasorMeans:
    """Block means of e^{iψ} and its rate, shape (n,).

    Attributes:
        phasor: mean of e^{iψ} over each block.
        rate: its rate, 1/s.
        when_s: times of the blocks, s.
        flat: ratio of the block mean of a quantity that turns with ψ to its value at the middle.
        grown: mean of −d²/dt² e^{iψ} over each block, over the square of the fastest speed.
    """

    phasor: Complex
    rate: Complex
    when_s: Array
    flat: Array
    grown: Complex


def turning(drive: Excitation, when_s: Array, spread_s2: Array) -> PhasorMeans:
    """Average e^{iψ} over blocks.

    Args:
        drive: drive.
        when_s, spread_s2: mean times, s, and variances of the sample times, s², of the blocks, shape (n,).
    """
    psi, speed, acceleration = drive.history.phase(when_s).T
    p = np.exp(1j * psi)
    flat = 1 - 0.5 * spread_s2 * speed**2
    grown = (speed**2 - 1j * acceleration) / drive.top_rad_s**2 * p * flat
    return PhasorMeans(p * (flat + 0.5j * spread_s2 * acceleration), 1j * speed * p, when_s, flat, grown)


@dataclass(frozen=True)
class BowAnswer:
    """Response h_b to a bow, its rate, and its derivatives by ln ω and ln ζ, shape (n,)."""

    h: Complex
    rate: Complex
    by_omega: Complex
    by_zeta: Complex


def bow_answer(seen: Response, turn: PhasorMeans, omega: float, zeta: float) -> BowAnswer:
    """Compute the response to a bow from the response to the imbalance.

    The rates of ∂h/∂ln ω and ∂h/∂ln ζ come from differences of neighbouring blocks; their factor is 2ζ.
    """
    lag, square = 2 * zeta / omega, 4 * zeta**2
    moved = seen.rate + turn.rate  # ġ
    h = (1 - square) * seen.h + turn.phasor - lag * turn.flat * moved
    omega_rate, zeta_rate = np.gradient(seen.by_omega, turn.when_s), np.gradient(seen.by_zeta, turn.when_s)
    by_omega = (1 - square) * seen.by_omega - lag * (omega_rate - moved)
    by_zeta = (1 - square) * seen.by_zeta - lag * (zeta_rate + moved) - 2 * square * seen.h
    return BowAnswer(h, moved + 2 * zeta * omega * seen.h, by_omega, by_zeta)
