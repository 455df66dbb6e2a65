"""Automatic start values of a turned pair of modes.

Well separated modes come one after the other from the damped periodogram. A close pair has a single peak; its modes
come from a matrix pencil over the decay and from each sensor alone. The assignment of the modes to the directions and
the angle of the axes follow from the mode shapes. Least squares starts from the candidates with the smallest χ².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from identification.least_squares import solve_separable
from identification.ring_down.model import BETA, DecayModel, DecayRecord
from identification.ring_down.modes import Start, averaged_decay, damped_periodogram, rate, without_modes
from identification.samples import Averages

_PENCIL_SAMPLES = 160
_ANGLES = np.radians(np.arange(-45.0, 45.1, 5.0))


def pair_starts(model: DecayModel) -> list[np.ndarray]:
    """Candidates of θ for a turned pair in order of χ², smallest first."""
    records = model.records
    plain = [list(r.channels) for r in records]
    leader = damped_periodogram(plain)
    pairs: list[tuple[complex, ...]] = [(lam, _follower(records, lam)) for lam in {leader.lam, _refined(model, leader)}]
    pairs.append(tuple(damped_periodogram([[r.channels[i]] for r in records]).lam for i in range(2)))
    pairs += pencil_pairs(records, leader)
    found: list[tuple[float, np.ndarray]] = []
    for pair in pairs:
        for order in (pair, pair[::-1]):
            costs = _costs_over_angle(records, order)
            k = int(np.argmin(costs))
            theta = np.zeros(model.size)
            for i, lam in enumerate(order):
                theta[2 * i : 2 * i + 2] = np.log(abs(lam)), -lam.real / abs(lam)
            theta[BETA] = _ANGLES[k]
            found.append((float(costs[k]), theta))
    return [theta for _, theta in sorted(found, key=lambda f: f[0])]


def _follower(records: Sequence[DecayRecord], lam: complex) -> complex:
    """Strongest mode after another mode is removed."""
    return damped_periodogram([[without_modes(c, [lam], r.zero_s) for c in r.channels] for r in records]).lam


def _refined(model: DecayModel, leader: Start) -> complex:
    """Rate of the strongest mode from a fit of its own, since its residual could hide a much weaker mode."""
    alone = replace(model, modes=1, turned=False, delays=False)
    free = np.full(2, np.inf)
    start = np.array([np.log(leader.omega), leader.zeta])
    theta = solve_separable(alone, start, np.zeros(2), free, max_iterations=8).minimum.theta
    return rate(float(np.exp(theta[0])), float(theta[1]))


def _costs_over_angle(records: Sequence[DecayRecord], pair: Sequence[complex]) -> np.ndarray:
    """χ² of a pair of rates at each of the axis angles _ANGLES, minimised over amplitudes and offsets.

    Every turned model is a combination of the same ten columns, so that their Gram matrix suffices.
    """
    total = np.zeros(len(_ANGLES))
    for record in records:
        gram, right, energy = np.zeros((10, 10)), np.zeros(10), 0.0
        for i, (channel, t) in enumerate(zip(record.channels, record.times, strict=True)):
            waves = [averaged_decay(lam, t, channel.spread_s2)[0] for lam in pair]
            basis = np.column_stack([p for w in waves for p in (np.real(w), -np.imag(w))] + [np.ones_like(t)])
            basis *= channel.weight[:, None]
            data = (channel.value - channel.value.mean()) * channel.weight
            own = slice(5 * i, 5 * i + 5)
            gram[own, own], right[own], energy = basis.T @ basis, basis.T @ data, energy + float(data @ data)
        for k, beta in enumerate(_ANGLES):
            turn = _turn(float(beta))
            normal, side = turn.T @ gram @ turn, turn.T @ right
            ridge = 1e-11 * np.trace(normal) * np.eye(6)
            best = cast(NDArray[np.float64], np.linalg.solve(normal + ridge, side))
            total[k] += energy - float(side @ best)
    return total


def _turn(beta: float) -> np.ndarray:
    """Matrix from (a1, a2, both offsets) to (mode 1, mode 2, offset) of each channel, shape (10, 6)."""
    out = np.zeros((10, 6))
    for part in range(2):
        out[part, part], out[2 + part, 2 + part] = np.cos(beta), np.sin(beta)
        out[5 + part, part], out[7 + part, 2 + part] = -np.sin(beta), np.cos(beta)
    out[4, 4] = out[9, 5] = 1.0
    return out


def pencil_pairs(records: Sequence[DecayRecord], leader: Start) -> list[tuple[complex, complex]]:
    """Two rates close to the strongest mode, by a matrix pencil over both channels of each record.

    For few cycles in the decay the pencil is applied to the signals, with an offset as a fifth exponential. For many
    cycles it is applied to their envelopes, shifted by the frequency of the strongest mode and averaged over whole
    cycles, which limits the size of the matrix.
    """
    out: list[tuple[complex, complex]] = []
    for record in records:
        decay = max(-leader.lam.real, 1e-6)
        span = min(*(float(t[-1]) for t in record.times), 4.0 / decay)
        cycles = span * leader.lam.imag / (2 * np.pi)
        if cycles < 4 or len(record.channels) < 2:
            continue
        if cycles <= 20:
            step = span / _PENCIL_SAMPLES
            rows = [_mean_grid(c, t, step, _PENCIL_SAMPLES, 0.0) for c, t in _with_times(record)]
            poles = _pencil(np.array(rows), 5)
            rates = [p for p in np.log(poles) / step if p.imag > 0.2 * leader.lam.imag]
        else:
            whole = int(np.ceil(cycles / 60))
            step = whole * 2 * np.pi / leader.lam.imag
            count = int(span / step)
            rows = [_mean_grid(c, t, step, count, leader.lam.imag) for c, t in _with_times(record)]
            rates = list(np.log(_pencil(np.array(rows), 2)) / step + 1j * leader.lam.imag)
        rates = [r for r in rates if -0.9 * abs(r) < r.real < 0]
        rates.sort(key=lambda r: abs(r - leader.lam))
        if len(rates) >= 2:
            out.append((complex(rates[0]), complex(rates[1])))
    return out


def _with_times(record: DecayRecord) -> list[tuple[Averages, np.ndarray]]:
    return list(zip(record.channels, record.times, strict=True))


def _mean_grid(channel: Averages, t: np.ndarray, step: float, count: int, shift: float) -> np.ndarray:
    """Means over `count` steps of a channel's deviation from rest, shifted down by a frequency; zero in gaps."""
    label = np.maximum(np.floor(t / step), 0).astype(int)  # channels start a fraction of a block apart
    used = label < count
    value = (channel.value - np.mean(channel.value[3 * len(t) // 4 :]))[used] * np.exp(-1j * shift * t[used])
    number = np.bincount(label[used], minlength=count)
    total = np.bincount(label[used], value.real, count) + 1j * np.bincount(label[used], value.imag, count)
    return total / np.maximum(number, 1)


def _pencil(rows: np.ndarray, order: int) -> np.ndarray:
    """Common poles z of signals Σ c z^k, shape (order,), by total least squares on the signal subspace."""
    n = rows.shape[1]
    length = n // 2
    blocks = [np.lib.stride_tricks.sliding_window_view(row, length).T for row in rows]
    left = np.linalg.svd(np.concatenate(blocks, axis=1), full_matrices=False)[0][:, :order]
    vectors = np.linalg.svd(np.column_stack([left[:-1], left[1:]]))[2].conj().T
    upper, lower = vectors[:order, order:], vectors[order:, order:]
    return np.linalg.eigvals(-upper @ np.linalg.pinv(lower)).astype(complex)
