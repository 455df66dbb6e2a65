"""Amplification factors of a run-up, on the suspension's principal axes.

With two different stiffnesses a sensor between the principal axes measures both resonances, and their apparent
sharpness depends on its angle. In the principal axes (virtual sensors) each resonance appears alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from analysis.quantities.orbits import turned
from analysis.quantities.order_tracking import OrderTrack
from rig_basics.arrays import Array, Complex


@dataclass(frozen=True)
class Amplification:
    """One resonance in a run-up.

    Attributes:
        peak_rad_s, peak_m: speed and amplitude of the largest response.
        lower_rad_s, upper_rad_s: speeds on both sides at 0.707 of the largest response.
        factor: peak speed / (upper − lower).
        std: standard deviation of the factor.
        axis_rad: angle of the principal axis from the sensors' x towards y.
    """

    peak_rad_s: float
    peak_m: float
    lower_rad_s: float
    upper_rad_s: float
    factor: float
    std: float
    axis_rad: float


def principal_axis(x: OrderTrack, y: OrderTrack) -> float:
    """Return the angle of one principal axis from x towards y, −π/4 … π/4, with the best separation, rad.

    On a principal axis the response over the speed is that of one resonance, u (ω0² + 2 i ζ ω0 ω − ω²) = e ω²: linear
    in ω0², 2ζω0 and e. The returned angle minimises the residual of both axes together.
    """
    speed, vx, vy = _common(x, y)
    coarse = np.linspace(-math.pi / 4, math.pi / 4, 91)
    worth = [_misfit(speed, vx, vy, float(angle)) for angle in coarse]
    best = float(coarse[int(np.argmin(worth))])
    step = float(coarse[1] - coarse[0])
    for _ in range(20):
        tried = best + step * np.array([-0.5, 0.0, 0.5])
        best = float(tried[int(np.argmin([_misfit(speed, vx, vy, float(angle)) for angle in tried]))])
        step *= 0.6
    return best


def amplification_factors(
    x: OrderTrack, y: OrderTrack, *, axis_rad: float | None = None, draws: int = 200, seed: int = 0
) -> tuple[Amplification | None, Amplification | None]:
    """Return the amplification factor of the resonance along each principal axis; None if the run-up is incomplete.

    Args:
        x, y: 1× of two sensors at right angles through the run-up, without slow roll.
        axis_rad: angle of the first principal axis from x towards y; by default found by `principal_axis`.
        draws: number of draws of the vectors within their deviations, for the standard deviation of the factor.
        seed: seed of the draws.
    """
    axis = principal_axis(x, y) if axis_rad is None else axis_rad
    speed, vx, vy = _common(x, y)
    stds = [_over_speed(track, track.of(1)[1].astype(np.complex128)) for track in (x, y)]
    spread = np.hypot(*(np.interp(speed, at, std.real) for at, std in stds)) / math.sqrt(2)
    rng = np.random.default_rng(seed)
    found: list[Amplification | None] = []
    for number, along in enumerate(turned(vx, vy, axis)):
        sizes = np.abs(along)
        one = _half_power(speed, sizes)
        if one is None:
            found.append(None)
            continue
        noise = rng.standard_normal((draws, len(speed))) * spread
        tried = [_half_power(speed, np.abs(sizes + row)) for row in noise]
        factors = np.array([t[0] for t in tried if t is not None])
        std = float(factors.std(ddof=1)) if len(factors) > 2 else float("nan")
        factor, at, size, lower, upper = one
        angle = axis + number * math.pi / 2
        found.append(Amplification(at, size, lower, upper, factor, std, angle))
    return found[0], found[1]


def _over_speed(track: OrderTrack, values: Complex) -> tuple[Array, Complex]:
    order = np.argsort(track.speed_rad_s)
    return track.speed_rad_s[order], values[order]


def _common(x: OrderTrack, y: OrderTrack) -> tuple[Array, Complex, Complex]:
    """Return the common speeds of both tracks and the vectors of both at these speeds."""
    (sx, vx), (sy, vy) = (_over_speed(track, track.of(1)[0]) for track in (x, y))
    speed = np.asarray(sx[(sx >= sy[0]) & (sx <= sy[-1])], np.float64)
    if len(speed) < 8:
        raise ValueError(f"amplification: expected 8 rows of speeds that both sensors have, got {len(speed)}")
    first = np.interp(speed, sx, vx.real) + 1j * np.interp(speed, sx, vx.imag)
    return speed, first, np.interp(speed, sy, vy.real) + 1j * np.interp(speed, sy, vy.imag)


def _misfit(speed: Array, x: Complex, y: Complex, angle: float) -> float:
    """Return the relative residual of both motions with one resonance on each axis."""
    left = 0.0
    scale = float(np.median(speed))
    w = speed / scale
    for u in turned(x, y, angle):
        weight = 1 / (np.abs(u) + 0.05 * np.abs(u).max())
        columns = np.stack([u, 1j * w * u, -(w**2), -1j * w**2], axis=1) * weight[:, None]
        wanted = u * w**2 * weight
        matrix = np.concatenate([columns.real, columns.imag])
        right = np.concatenate([wanted.real, wanted.imag])
        fit = np.linalg.lstsq(matrix, right, rcond=None)[0]
        left += float(np.sum((right - matrix @ fit) ** 2) / np.sum(right**2))
    return left


def _half_power(speed: Array, size: Array) -> tuple[float, float, float, float, float] | None:
    """Return factor, speed and size of the peak, speeds at 0.707 of it; None if one side stays above that level."""
    top = int(np.argmax(size))
    if not 0 < top < len(size) - 1:
        return None
    parabola = cast("Array", np.polyfit(speed[top - 1 : top + 2] - speed[top], size[top - 1 : top + 2], 2))
    a, b, c = (float(p) for p in parabola)
    shift = float(np.clip(-b / (2 * a), speed[top - 1] - speed[top], speed[top + 1] - speed[top])) if a < 0 else 0.0
    peak = float(a * shift**2 + b * shift + c)
    level = peak / math.sqrt(2)
    below, above = np.flatnonzero(size[:top] < level), np.flatnonzero(size[top:] < level)
    if not len(below) or not len(above):
        return None
    i, j = int(below[-1]), top + int(above[0])
    lower = float(np.interp(level, [size[i], size[i + 1]], [speed[i], speed[i + 1]]))
    upper = float(np.interp(level, [size[j], size[j - 1]], [speed[j], speed[j - 1]]))
    at = float(speed[top] + shift)
    return at / (upper - lower), at, peak, lower, upper
