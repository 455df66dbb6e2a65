"""The separable model of a run-up: two forced oscillators seen by two rotated, delayed sensors.

θ = (ln ω1, ln ζ1, ln ω2, ln ζ2, β, delay x, delay y, drift x, drift y). A sensor's sample stamped t shows the motion at
t − delay − drift (t − middle): its clock against the tachometer's. Each sensor has its own complex amplitude (gain,
and what the phase's zero leaves), free oscillations of both modes, offset and slope, all linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.least_squares import Block
from identification.ring_down.modes import averaged_decay, rate, rate_derivatives
from identification.run_up.forced_oscillator import Drive, Response, march, response_at
from identification.samples import Averages

ANGLE, DELAYS, DRIFTS, PARAMETERS = 4, slice(5, 7), slice(7, 9), 9


@dataclass(frozen=True)
class RunUpRecord:
    """Both sensors' block averages and the drive that covers them."""

    x: Averages
    y: Averages
    drive: Drive

    @property
    def channels(self) -> tuple[Averages, Averages]:
        """x and y."""
        return self.x, self.y


def run_up_blocks(record: RunUpRecord, theta: np.ndarray) -> list[Block]:
    """The model at θ, one block per sensor."""
    omegas, zetas = np.exp(theta[[0, 2]]), np.exp(theta[[1, 3]])
    grids = [march(record.drive, w, z) for w, z in zip(omegas, zetas, strict=True)]
    return [_sensor_block(record, axis, theta, omegas, zetas, grids) for axis in range(2)]


def _sensor_block(
    record: RunUpRecord, axis: int, theta: np.ndarray, omegas: np.ndarray, zetas: np.ndarray, grids: list[np.ndarray]
) -> Block:
    channel = record.channels[axis]
    drive = record.drive
    from_middle = channel.time_s - 0.5 * (drive.start_s + drive.end_s)
    when = channel.time_s - theta[DELAYS][axis] - theta[DRIFTS][axis] * from_middle
    cos, sin = np.cos(theta[ANGLE]), np.sin(theta[ANGLE])
    mix = ((cos, sin), (-sin, cos))[axis]
    turned = ((-sin, cos), (-cos, -sin))[axis]
    seen = [response_at(when, drive, g, w, z) for g, w, z in zip(grids, omegas, zetas, strict=True)]
    half = 0.5 * channel.spread_s2
    forced = [r.h + half * r.curve for r in seen]
    since = channel.time_s - drive.start_s
    decays = [averaged_decay(rate(w, z), since, channel.spread_s2) for w, z in zip(omegas, zetas, strict=True)]
    weight = channel.weight
    # x = Re(A h1), y = Im(A h2) = Re(−i A h2): both are Re(A times a complex signal)
    signal = mix[0] * forced[0] - 1j * mix[1] * forced[1]
    columns = [np.real(signal), -np.imag(signal)]
    for wave, _ in decays:
        columns += [np.real(wave), -np.imag(wave)]
    basis = np.column_stack([*columns, np.ones_like(since), since]) * weight[:, None]

    def tangent(c: np.ndarray) -> np.ndarray:
        return _tangent(c, axis, seen, forced, decays, mix, turned, (omegas, zetas), from_middle) * weight[:, None]

    return Block(channel.value * weight, basis, tangent)


def _tangent(
    c: np.ndarray,
    axis: int,
    seen: list[Response],
    forced: list[np.ndarray],
    decays: list[tuple[np.ndarray, np.ndarray]],
    mix: tuple[float, float],
    turned: tuple[float, float],
    oscillators: tuple[np.ndarray, np.ndarray],
    from_middle: np.ndarray,
) -> np.ndarray:
    amplitude = complex(c[0], c[1])
    out = np.zeros((len(from_middle), PARAMETERS))
    moving = np.zeros(len(from_middle))
    for mode, turn in enumerate((1.0, -1j)):
        factor = amplitude * turn
        free = complex(c[2 + 2 * mode], c[3 + 2 * mode])
        d_omega, d_zeta = rate_derivatives(oscillators[0][mode], oscillators[1][mode])
        slope = free * decays[mode][1]
        out[:, 2 * mode] = mix[mode] * (factor * seen[mode].by_omega).real + (d_omega * slope).real
        out[:, 2 * mode + 1] = mix[mode] * (factor * seen[mode].by_zeta).real + (d_zeta * slope).real
        out[:, ANGLE] += turned[mode] * (factor * forced[mode]).real
        moving += mix[mode] * (factor * seen[mode].rate).real
    out[:, DELAYS.start + axis] = -moving
    out[:, DRIFTS.start + axis] = -moving * from_middle
    return out
