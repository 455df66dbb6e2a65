"""The separable model of one or more ring-down records: two modes, two rotated sensors.

In the stiffness axes the motion is x = Re(a1 e^{λ1 t}), y = Re(a2 e^{λ2 t}). Sensor x points at the angle β from
stiffness x, and laser y's clock lags laser x's by a delay d:

    x_s = x cos β + y sin β,        y_s = ρ (−x sin β + y cos β) at t − d,

each plus an offset and a slope. ρ is the ratio of the sensors' gains. θ = (ln ω1, ln ζ1, ln ω2, ln ζ2, β, ln ρ, d of
each record); a1, a2, offsets and slopes are linear and each record's own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.least_squares import Block
from identification.ring_down.modes import averaged_decay, rate, rate_derivatives
from identification.samples import Averages

SHARED = 6  # parameters before the delays


@dataclass(frozen=True)
class DecayRecord:
    """Both channels of one ring-down from its release on."""

    x: Averages
    y: Averages
    zero_s: float


def blocks(records: Sequence[DecayRecord], theta: np.ndarray) -> list[Block]:
    """The model at θ, one block per record."""
    return [_block(record, i, len(records), theta) for i, record in enumerate(records)]


def _block(record: DecayRecord, index: int, count: int, theta: np.ndarray) -> Block:
    omegas, zetas = np.exp(theta[[0, 2]]), np.exp(theta[[1, 3]])
    beta, ratio, delay = theta[4], np.exp(theta[5]), theta[SHARED + index]
    cos, sin = np.cos(beta), np.sin(beta)
    mix = np.array([[cos, sin], [-ratio * sin, ratio * cos]])
    turned = np.array([[-sin, cos], [-ratio * cos, -ratio * sin]])  # ∂mix/∂β
    channels = (record.x, record.y)
    lams = [rate(w, z) for w, z in zip(omegas, zetas, strict=True)]
    nx = len(record.x.time_s)
    waves, slopes, columns = [], [], []
    for lam in lams:
        parts = []
        for channel, shift in zip(channels, (0.0, delay), strict=True):
            parts.append(averaged_decay(lam, channel.time_s - record.zero_s - shift, channel.spread_s2))
        waves.append([p[0] for p in parts])
        slopes.append([p[1] for p in parts])
    for mode in range(2):
        signal = np.concatenate([mix[i, mode] * waves[mode][i] for i in range(2)])
        columns += [np.real(signal), -np.imag(signal)]
    weight = np.concatenate([c.weight for c in channels])
    drift = _drift_columns(record, nx)
    basis = np.column_stack([*columns, drift]) * weight[:, None]
    data = np.concatenate([c.value for c in channels]) * weight

    def tangent(c: np.ndarray) -> np.ndarray:
        out = np.zeros((len(data), SHARED + count))
        for mode in range(2):
            amplitude = complex(c[2 * mode], c[2 * mode + 1])
            d_omega, d_zeta = rate_derivatives(omegas[mode], zetas[mode])
            moved = np.concatenate([mix[i, mode] * amplitude * slopes[mode][i] for i in range(2)])
            out[:, 2 * mode] = (d_omega * moved).real
            out[:, 2 * mode + 1] = (d_zeta * moved).real
            signal = [(amplitude * wave).real for wave in waves[mode]]
            out[:, 4] += np.concatenate([turned[i, mode] * signal[i] for i in range(2)])
            out[nx:, 5] += mix[1, mode] * signal[1]
            out[nx:, SHARED + index] -= mix[1, mode] * (lams[mode] * amplitude * waves[mode][1]).real
        return out * weight[:, None]

    return Block(data, basis, tangent)


def _drift_columns(record: DecayRecord, nx: int) -> np.ndarray:
    """Offset and slope of each channel, shape (n, 4)."""
    t = np.concatenate([record.x.time_s, record.y.time_s]) - record.zero_s
    out = np.zeros((len(t), 4))
    out[:nx, 0] = out[nx:, 2] = 1.0
    out[:nx, 1], out[nx:, 3] = t[:nx], t[nx:]
    return out


def single_block(channel: Averages, zero_s: float, theta: np.ndarray) -> Block:
    """One mode in one channel: θ = (ln ω, ln ζ); amplitude, offset and slope are linear."""
    omega, zeta = np.exp(theta)
    t = channel.time_s - zero_s
    wave, slope = averaged_decay(rate(omega, zeta), t, channel.spread_s2)
    weight = channel.weight
    basis = np.column_stack([np.real(wave), -np.imag(wave), np.ones_like(t), t]) * weight[:, None]

    def tangent(c: np.ndarray) -> np.ndarray:
        moved = complex(c[0], c[1]) * slope
        d_omega, d_zeta = rate_derivatives(omega, zeta)
        return np.column_stack([(d_omega * moved).real, (d_zeta * moved).real]) * weight[:, None]

    return Block(channel.value * weight, basis, tangent)


def model_of(records: Sequence[DecayRecord]) -> Callable[[np.ndarray], list[Block]]:
    """The model as least squares takes it."""
    return lambda theta: blocks(records, theta)
