"""Separable models of ring-down records.

Turned pair: in the stiffness axes the motion is x = Re(a1 e^{λ1 t}), y = Re(a2 e^{λ2 t}). Sensor x is at an angle β
from stiffness x, and the clock of laser y lags that of laser x by a delay δ:

    x_s = x cos β + y sin β,        y_s = ρ (−x sin β + y cos β) at t − δ.

ρ is the ratio of the sensors' gains. θ = (ln ω1, ζ1, ln ω2, ζ2, β, ln ρ, δ of each record if the clocks differ). a1 and
a2 are linear unknowns of each record.

Free modes: every channel has its own complex amplitude of every mode, and θ = (ln ω, ζ) of each mode. With one mode
this is the model of one direction.

Rates that depend on amplitude add (η, S) of each mode at the end of θ: see identification.ring_down.backbone.

Each channel also has a drift, a polynomial of order 0, 1 or 3. The parameter is ζ and not its logarithm: ζ is nearly
linear in the data, and its interval is symmetric, even for damping close to the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from identification.colour import Colour
from identification.least_squares import SeparableBlock
from identification.ring_down.backbone import Backbone, Rates, averaged_course
from identification.ring_down.modes import averaged_decay, damping_derivative, rate
from identification.samples import Averages
from rig_basics.arrays import Complex

BETA, RATIO, DELAYS = 4, 5, 6  # places in θ of a turned pair
_MAX_ZETA, _MAX_LOG_OMEGA, _MAX_GROWTH = 0.95, 12.0, 20.0


@dataclass(frozen=True)
class DecayRecord:
    """Channels of one ring-down from its release on. A turned pair needs two channels, x and y.

    Attributes:
        channels: block means of each channel.
        zero_s: time origin, s.
        lines: columns of the lines of each channel, shape (blocks, columns); optional.
        colours: colour of the noise of each channel, None for white noise; optional.
        lacking: exact motion minus averaged solution for each channel, m; optional.
    """

    channels: tuple[Averages, ...]
    zero_s: float
    lines: tuple[np.ndarray, ...] = ()
    colours: tuple[Colour | None, ...] = ()
    lacking: tuple[np.ndarray, ...] = ()

    @cached_property
    def times(self) -> list[np.ndarray]:
        """Block times of each channel since zero_s, s."""
        return [c.time_s - self.zero_s for c in self.channels]

    @cached_property
    def weight(self) -> np.ndarray:
        """Inverse standard deviation of every block, channels concatenated."""
        return np.concatenate([c.weight for c in self.channels])

    @cached_property
    def data(self) -> np.ndarray:
        """Values in standard deviations, channels concatenated."""
        value = np.concatenate([c.value for c in self.channels])
        return self.scaled(value - np.concatenate(self.lacking) if self.lacking else value)

    def scaled(self, rows: np.ndarray) -> np.ndarray:
        """Scale rows (n,) or (n, m) of all channels to standard deviations, and whiten them."""
        rows = rows * (self.weight if rows.ndim == 1 else self.weight[:, None])
        if not any(self.colours):
            return rows
        edges = np.cumsum([len(c.time_s) for c in self.channels])[:-1]
        parts = zip(np.split(rows, edges), self.colours, strict=True)
        return np.concatenate([part if colour is None else colour.whitened(part) for part, colour in parts])

    @cached_property
    def line_columns(self) -> np.ndarray:
        """Columns of the lines, non-zero in the rows of their own channel only, shape (n, columns)."""
        out = np.zeros((len(self.weight), sum(part.shape[1] for part in self.lines)))
        row = column = 0
        for i, channel in enumerate(self.channels):
            own = self.lines[i] if self.lines else np.empty((0, 0))
            out[row : row + len(own), column : column + own.shape[1]] = own
            row, column = row + len(channel.time_s), column + own.shape[1]
        return out

    @cached_property
    def same_times(self) -> bool:
        """Whether all channels have the same sample times and masks."""
        first = self.channels[0]
        return all(
            np.array_equal(first.time_s, c.time_s) and np.array_equal(first.spread_s2, c.spread_s2)
            for c in self.channels[1:]
        )


@dataclass(frozen=True)
class DecayModel:
    """Model of a fit with its terms.

    Attributes:
        records: fitted records.
        modes: number of modes.
        turned: whether the model is a turned pair; otherwise the modes are free.
        drift: order of the polynomial of each channel.
        delays: whether the clocks of the two channels of a record may differ.
        width_s: duration of a block, s.
        backbone: amplitude dependence of the modes' rates; None for constant rates.
    """

    records: tuple[DecayRecord, ...]
    modes: int
    turned: bool
    drift: int = 0
    delays: bool = False
    width_s: float = 0.0
    backbone: Backbone | None = None

    @property
    def size(self) -> int:
        """Length of θ."""
        return self.tail + (2 * self.modes if self.backbone is not None else 0)

    @property
    def tail(self) -> int:
        """Index of the first η in θ, which is the length of θ without η and S."""
        return 2 * self.modes + (2 + (len(self.records) if self.delays else 0) if self.turned else 0)

    @property
    def free(self) -> int:
        """Number of fitted elements of θ. Terms of amplitude that are left out do not count."""
        return self.tail + (sum(self.backbone.taken) if self.backbone is not None else 0)

    def mode_rates(self, theta: np.ndarray, mode: int) -> Rates:
        """Parameters of a mode."""
        bent = (0.0, 0.0) if self.backbone is None else theta[self.tail + 2 * mode : self.tail + 2 * mode + 2]
        return Rates(float(np.exp(theta[2 * mode])), float(theta[2 * mode + 1]), float(bent[0]), float(bent[1]))

    @property
    def linear(self) -> int:
        """Number of amplitudes and drift coefficients."""
        channels = sum(len(r.channels) for r in self.records)
        own = len(self.records) if self.turned else channels
        lines = sum(part.shape[1] for r in self.records for part in r.lines)
        return own * 2 * self.modes + channels * (self.drift + 1) + lines

    def __call__(self, theta: np.ndarray) -> list[SeparableBlock]:
        """Evaluate the model at θ, one block per record. The basis is NaN for an invalid θ."""
        if self.is_absurd(theta):
            return [self._nowhere(record) for record in self.records]
        return [self._block(record, i, theta) for i, record in enumerate(self.records)]

    def is_absurd(self, theta: np.ndarray) -> bool:
        """Whether exponentials at θ overflow or do not oscillate."""
        logs, zetas = theta[0 : 2 * self.modes : 2], theta[1 : 2 * self.modes : 2]
        if not np.all(np.isfinite(theta)):
            return True
        if np.any(np.abs(zetas) > _MAX_ZETA) or np.any(np.abs(logs) > _MAX_LOG_OMEGA):
            return True
        longest = max(float(t[-1]) for record in self.records for t in record.times)
        if self.backbone is not None and any(
            self.mode_rates(theta, m).is_absurd(largest, longest) for m, largest in enumerate(self.backbone.largest_m)
        ):
            return True
        grows = float(np.max(-zetas * np.exp(logs))) * longest > _MAX_GROWTH
        return grows or (self.turned and abs(float(theta[RATIO])) > 1)

    def _nowhere(self, record: DecayRecord) -> SeparableBlock:
        """Block of NaN, from which least squares steps back."""
        n, size = len(record.weight), self.size
        columns = (
            2 * self.modes * (1 if self.turned else len(record.channels))
            + len(record.channels) * (self.drift + 1)
            + record.line_columns.shape[1]
        )
        return SeparableBlock(record.data, np.full((n, columns), np.nan), lambda c: np.full((n, size), np.nan))

    def _block(self, record: DecayRecord, index: int, theta: np.ndarray) -> SeparableBlock:
        if self.backbone is not None:
            return self._bent_block(record, index, theta, self.backbone)
        omegas, zetas = self._plain(theta)
        lams = [rate(w, z) for w, z in zip(omegas, zetas, strict=True)]
        moves = [(lam, damping_derivative(w, z)) for lam, w, z in zip(lams, omegas, zetas, strict=True)]
        delay = theta[DELAYS + index] if self.delays else 0.0
        waves, slopes = self._waves(record, lams, delay)
        others = self.other_columns(record)
        if self.turned:
            mix, turned = rotation(theta[BETA], np.exp(theta[RATIO]))
            basis = record.scaled(_turned_basis(waves, mix, others))
            delayed = index if self.delays else None

            def tangent(c: np.ndarray) -> np.ndarray:
                return record.scaled(_turned_tangent(c, waves, slopes, moves, mix, turned, self.size, delayed))
        else:
            basis = record.scaled(_free_basis(waves, others))

            def tangent(c: np.ndarray) -> np.ndarray:
                return record.scaled(_free_tangent(c, slopes, moves))

        return SeparableBlock(record.data, basis, tangent)

    def _bent_block(self, record: DecayRecord, index: int, theta: np.ndarray, backbone: Backbone) -> SeparableBlock:
        delay = theta[DELAYS + index] if self.delays else 0.0
        alike = record.same_times and not self.delays
        waves: list[list[np.ndarray]] = []
        moves: list[list[tuple[np.ndarray, ...]]] = []
        for mode, amplitude in enumerate(backbone.amplitudes_m[index]):
            rates, parts = self.mode_rates(theta, mode), list[tuple[Complex, tuple[Complex, ...]]]()
            for i, (t, channel) in enumerate(zip(record.times, record.channels, strict=True)):
                own = t - (delay if i else 0.0)
                parts.append(parts[0] if i and alike else averaged_course(rates, amplitude, own, channel.spread_s2))
            waves.append([p[0] for p in parts])
            moves.append([p[1] for p in parts])
        others = self.other_columns(record)
        mix, turned = rotation(theta[BETA], np.exp(theta[RATIO])) if self.turned else (np.eye(1), np.eye(1))
        basis = record.scaled(_turned_basis(waves, mix, others) if self.turned else _free_basis(waves, others))
        delayed = index if self.delays else None
        lams = [rate(float(w), float(z)) for w, z in zip(*self._plain(theta), strict=True)]

        def tangent(c: np.ndarray) -> np.ndarray:
            if self.turned:
                own = _turned_bent_tangent(c, waves, moves, mix, turned, self.tail, lams, delayed)
            else:
                own = _free_bent_tangent(c, moves, self.tail)
            return record.scaled(own)

        return SeparableBlock(record.data, basis, tangent)

    def _plain(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Natural frequencies, rad/s, and damping ratios at zero amplitude."""
        return np.exp(theta[0 : 2 * self.modes : 2]), theta[1 : 2 * self.modes : 2]

    def _waves(
        self, record: DecayRecord, lams: Sequence[complex], delay: float
    ) -> tuple[list[list[np.ndarray]], list[list[np.ndarray]]]:
        """e^{λt} and its derivative by λ, [mode][channel]."""
        waves, slopes = list[list[np.ndarray]](), list[list[np.ndarray]]()
        alike = record.same_times and not self.delays
        for lam in lams:
            parts: list[tuple[np.ndarray, np.ndarray]] = []
            for i, (t, channel) in enumerate(zip(record.times, record.channels, strict=True)):
                if i and alike:
                    parts.append(parts[0])
                else:
                    parts.append(averaged_decay(lam, t - (delay if i else 0.0), channel.spread_s2))
            waves.append([p[0] for p in parts])
            slopes.append([p[1] for p in parts])
        return waves, slopes

    def other_columns(self, record: DecayRecord) -> np.ndarray:
        """Columns of the linear terms other than the modes: lines, then drift, shape (n, columns)."""
        drift = self.drift_columns(record)
        return np.hstack([record.line_columns, drift]) if any(part.size for part in record.lines) else drift

    def drift_columns(self, record: DecayRecord) -> np.ndarray:
        """Legendre polynomials of the time of each channel, shape (n, channels × (order + 1))."""
        out = np.zeros((len(record.weight), len(record.channels) * (self.drift + 1)))
        at = 0
        for i, t in enumerate(record.times):
            span = max(float(t[-1] - t[0]), 1e-9)
            columns = cast(NDArray[np.float64], np.polynomial.legendre.legvander(2 * (t - t[0]) / span - 1, self.drift))
            out[at : at + len(t), i * (self.drift + 1) : (i + 1) * (self.drift + 1)] = columns
            at += len(t)
        return out


def rotation(beta: float, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Share of each mode (column) in each sensor (row), shape (2, 2), and its derivative by β."""
    cos, sin = np.cos(beta), np.sin(beta)
    return np.array([[cos, sin], [-ratio * sin, ratio * cos]]), np.array([[-sin, cos], [-ratio * cos, -ratio * sin]])


def _turned_basis(waves: list[list[np.ndarray]], mix: np.ndarray, others: np.ndarray) -> np.ndarray:
    out = np.empty((len(others), 4 + others.shape[1]))
    for mode in range(2):
        signal = np.concatenate([mix[i, mode] * waves[mode][i] for i in range(2)])
        out[:, 2 * mode], out[:, 2 * mode + 1] = np.real(signal), -np.imag(signal)
    out[:, 4:] = others
    return out


def _turned_tangent(
    c: np.ndarray,
    waves: list[list[np.ndarray]],
    slopes: list[list[np.ndarray]],
    moves: list[tuple[complex, complex]],
    mix: np.ndarray,
    turned: np.ndarray,
    size: int,
    delayed: int | None,
) -> np.ndarray:
    """∂(Φc)/∂θ with the *fitted* motion in every column, also for β: see identification.least_squares."""
    nx = len(waves[0][0])
    out = np.zeros((nx + len(waves[0][1]), size))
    for mode in range(2):
        amplitude = complex(c[2 * mode], c[2 * mode + 1])
        moved = np.concatenate([mix[i, mode] * amplitude * slopes[mode][i] for i in range(2)])
        for j, by in enumerate(moves[mode]):
            out[:, 2 * mode + j] = (by * moved).real
        signal = [(amplitude * wave).real for wave in waves[mode]]
        out[:, BETA] += np.concatenate([turned[i, mode] * signal[i] for i in range(2)])
        out[nx:, RATIO] += mix[1, mode] * signal[1]
        if delayed is not None:
            out[nx:, DELAYS + delayed] -= mix[1, mode] * (moves[mode][0] * amplitude * waves[mode][1]).real
    return out


def _free_basis(waves: list[list[np.ndarray]], others: np.ndarray) -> np.ndarray:
    count, channels = len(waves), len(waves[0])
    out = np.zeros((len(others), 2 * count * channels + others.shape[1]))
    at = 0
    for i in range(channels):
        rows = slice(at, at + len(waves[0][i]))
        at = rows.stop
        for mode in range(count):
            column = 2 * (i * count + mode)
            out[rows, column], out[rows, column + 1] = np.real(waves[mode][i]), -np.imag(waves[mode][i])
    out[:, 2 * count * channels :] = others
    return out


def _free_tangent(c: np.ndarray, slopes: list[list[np.ndarray]], moves: list[tuple[complex, complex]]) -> np.ndarray:
    count, channels = len(slopes), len(slopes[0])
    parts: list[np.ndarray] = []
    for i in range(channels):
        own = np.empty((len(slopes[0][i]), 2 * count))
        for mode in range(count):
            column = 2 * (i * count + mode)
            moved = complex(c[column], c[column + 1]) * slopes[mode][i]
            for j, by in enumerate(moves[mode]):
                own[:, 2 * mode + j] = (by * moved).real
        parts.append(own)
    return np.concatenate(parts)


def _places(mode: int, tail: int) -> tuple[int, int, int, int]:
    """Indices of a mode's ln ω, ζ, η and S in θ."""
    return 2 * mode, 2 * mode + 1, tail + 2 * mode, tail + 2 * mode + 1


def _turned_bent_tangent(
    c: np.ndarray,
    waves: list[list[np.ndarray]],
    moves: list[list[tuple[np.ndarray, ...]]],
    mix: np.ndarray,
    turned: np.ndarray,
    tail: int,
    lams: list[complex],
    delayed: int | None,
) -> np.ndarray:
    """∂(Φc)/∂θ as in `_turned_tangent`, for rates that depend on amplitude."""
    nx = len(waves[0][0])
    out = np.zeros((nx + len(waves[0][1]), tail + 4))
    for mode in range(2):
        amplitude = complex(c[2 * mode], c[2 * mode + 1])
        for place, *own in zip(_places(mode, tail), *moves[mode], strict=True):
            out[:, place] = np.concatenate([mix[i, mode] * (amplitude * own[i]).real for i in range(2)])
        signal = [(amplitude * wave).real for wave in waves[mode]]
        out[:, BETA] += np.concatenate([turned[i, mode] * signal[i] for i in range(2)])
        out[nx:, RATIO] += mix[1, mode] * signal[1]
        if delayed is not None:
            out[nx:, DELAYS + delayed] -= mix[1, mode] * (lams[mode] * amplitude * waves[mode][1]).real
    return out


def _free_bent_tangent(c: np.ndarray, moves: list[list[tuple[np.ndarray, ...]]], tail: int) -> np.ndarray:
    count, channels = len(moves), len(moves[0])
    parts: list[np.ndarray] = []
    for i in range(channels):
        own = np.empty((len(moves[0][i][0]), tail + 2 * count))
        for mode in range(count):
            column = 2 * (i * count + mode)
            amplitude = complex(c[column], c[column + 1])
            for place, by in zip(_places(mode, tail), moves[mode][i], strict=True):
                own[:, place] = (amplitude * by).real
        parts.append(own)
    return np.concatenate(parts)
