"""Passages through resonance against the Cramér–Rao bound: efficiency, bias, coverage, convergence, time, peers.

    python -m benchmarks.run_up_bound [--runs 1000] [--quick] [--only NAME] [--seed 1]

Records come from a simulator of its own: q̇ = λq + u with u = (ψ̇² − iψ̈) e^{iψ} from a closed form of ψ, exact from
sample to sample (five Gauss points an interval). Every draw has its own noise, speed ripple (0.5 % in all: once and
twice per revolution and a slow wander), axis angle within ±20°, imbalance direction and offsets. The bound is the
inverse of a numerical Fisher information of that simulator with free oscillations, amplitudes, offsets and slopes
unknown too. Printed per cell: converged; rms error over bound (efficiency is its inverse square), bias in standard
deviations, coverage of the 95 % interval, for f and ζ; then half-power and Vold–Kalman for the first axis.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from identification import IdentificationError, RunUpFit, fit_run_up

NOISE_M = 10e-6
RIPPLE = 0.005
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
NAMES = ("f1_Hz", "zeta1", "f2_Hz", "zeta2", "axis_angle_deg")


@dataclass(frozen=True)
class Cell:
    """One kind of passage.

    Attributes:
        name: printed.
        f_Hz, zeta: of both directions.
        turns: t/T → (revolutions per T, and two derivatives by t/T) in Hz, see `linear`.
        eccentricity_m, record_s, rate_Hz: of the record.
        resolution_rad, phase_noise_rad: quantisation and white noise of the phase.
        passed: which resonances the speed passes.
    """

    name: str
    f_Hz: tuple[float, float]
    zeta: float
    turns: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
    eccentricity_m: float = 50e-6
    record_s: float = 60.0
    rate_Hz: float = 1000.0
    resolution_rad: float = 0.0
    phase_noise_rad: float = 0.0
    passed: tuple[int, ...] = (1, 2)


def power(first: float, last: float, exponent: float = 1.0) -> Callable:
    """Speed first + (last − first) s^exponent in Hz over s = t/T: its integral, itself, its derivative."""

    def turns(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        d, n = last - first, exponent
        return first * s + d * s ** (n + 1) / (n + 1), first + d * s**n, d * n * s ** (n - 1)

    return turns


def coast(first: float, last: float) -> Callable:
    """A rotor left alone: speed falls exponentially."""
    rate = np.log(first / last)

    def turns(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        speed = first * np.exp(-rate * s)
        return (first - speed) / rate, speed, -rate * speed

    return turns


CELLS = [
    *(Cell(f"3, 5 Hz, ζ {z:g}", (3.0, 5.0), z, power(0.5, 7.0)) for z in (0.001, 0.01, 0.05, 0.2)),
    *(Cell(f"3, 11.6 Hz, ζ {z:g}, 350 µm", (3.0, 11.6), z, power(0.5, 14.0), 350e-6) for z in (0.001, 0.02, 0.2)),
    *(Cell(f"coast-down, ζ {z:g}", (3.0, 5.0), z, coast(7.0, 1.0)) for z in (0.001, 0.02)),
    Cell("quickening ramp, ζ 0.01", (3.0, 5.0), 0.01, power(0.5, 7.0, 2.0)),
    Cell("starts in resonance 1, ζ 0.01", (3.0, 5.0), 0.01, power(2.97, 7.0)),
    Cell("alike, ζ 0.01", (3.0, 3.0), 0.01, power(0.5, 7.0)),
    Cell("0.5 half-bandwidths apart, ζ 0.02", (3.0, 3.03), 0.02, power(0.5, 7.0), 150e-6),
    Cell("second not reached, ζ 0.01", (3.0, 11.6), 0.01, power(0.5, 7.0), 150e-6, passed=(1,)),
    Cell("phase of 2048 steps, ζ 0.01", (3.0, 5.0), 0.01, power(0.5, 7.0), resolution_rad=2 * np.pi / 2048),
    Cell("phase noise 10 mrad, ζ 0.01", (3.0, 5.0), 0.01, power(0.5, 7.0), 150e-6, phase_noise_rad=0.01),
]


@dataclass(frozen=True)
class Draw:
    """One record's random facts: axis angle, amplitude A, offsets, and the ripple's phases and shares."""

    angle_rad: float
    amplitude: complex
    offset: np.ndarray
    ripple: np.ndarray

    @classmethod
    def of(cls, cell: Cell, rng: np.random.Generator) -> Draw:
        """Return the draw of one record."""
        angle = 0.0 if cell.f_Hz[0] == cell.f_Hz[1] else np.radians(rng.uniform(-20, 20))
        share = rng.dirichlet(np.ones(3)) * RIPPLE
        ripple = np.r_[share, rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.03, 0.3)]
        direction = np.exp(1j * rng.uniform(-np.pi, np.pi))
        return cls(angle, cell.eccentricity_m * direction, 1e-3 * rng.uniform(-1, 1, 2), ripple)


def phase_of(cell: Cell, draw: Draw, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ψ and two derivatives: the base, ripple once and twice per revolution, a slow wander of the speed."""
    a, b, v = cell.turns(t / cell.record_s)
    base, speed, bend = 2 * np.pi * a * cell.record_s, 2 * np.pi * b, 2 * np.pi * v / cell.record_s
    once, twice, slow, p1, p2, p3, f = draw.ripple
    psi = base + once * np.sin(base + p1) + 0.5 * twice * np.sin(2 * base + p2)
    k = 1 + once * np.cos(base + p1) + twice * np.cos(2 * base + p2)
    dk = -(once * np.sin(base + p1) + 2 * twice * np.sin(2 * base + p2))
    w = 2 * np.pi * f
    wander = slow * 2 * np.pi * 4.0 / w  # share of 4 Hz
    return (
        psi + wander * np.sin(w * t + p3),
        speed * k + wander * w * np.cos(w * t + p3),
        bend * k + speed**2 * dk - wander * w * w * np.sin(w * t + p3),
    )


@dataclass(frozen=True)
class Drive:
    """u at the Gauss points of every interval, shape (n − 1, 5), with the instants of the samples."""

    time_s: np.ndarray
    force: np.ndarray
    step_s: float

    @classmethod
    def of(cls, cell: Cell, draw: Draw) -> Drive:
        """For one record."""
        step = 1 / cell.rate_Hz
        time_s = step * np.arange(round(cell.record_s * cell.rate_Hz))
        psi, speed, bend = phase_of(cell, draw, time_s[:-1, None] + 0.5 * step * (_NODES + 1))
        return cls(time_s, (speed**2 - 1j * bend) * np.exp(1j * psi), step)


def response(drive: Drive, f_Hz: float, zeta: float) -> np.ndarray:
    """h at the samples, from rest; shape (n,)."""
    lam = 2 * np.pi * f_Hz * complex(-zeta, np.sqrt(1 - zeta * zeta))
    rest = 0.5 * drive.step_s * (1 - _NODES)
    out = []
    for rate in (lam, np.conj(lam)):
        push = drive.force @ (0.5 * drive.step_s * _WEIGHTS * np.exp(rate * rest))
        out.append(lfilter([1.0], [1.0, -np.exp(rate * drive.step_s)], np.r_[0.0, push]))
    return (out[0] - out[1]) / (lam - np.conj(lam))


def seen(drive: Drive, draw: Draw, theta: np.ndarray) -> np.ndarray:
    """Both sensors without noise; θ = f1, ζ1, f2, ζ2, β; shape (n, 2)."""
    x = (draw.amplitude * response(drive, theta[0], theta[1])).real
    y = (draw.amplitude * response(drive, theta[2], theta[3])).imag
    c, s = np.cos(theta[4]), np.sin(theta[4])
    return np.column_stack([c * x + s * y, -s * x + c * y])


def bound(cell: Cell, draw: Draw) -> np.ndarray:
    """Standard deviations of f1, ζ1, f2, ζ2, β (rad) that no unbiased estimator undercuts."""
    drive = Drive.of(cell, draw)
    theta = np.array([cell.f_Hz[0], cell.zeta, cell.f_Hz[1], cell.zeta, draw.angle_rad])
    every = 4
    columns = []
    for j, step in enumerate((1e-6, 1e-4 * cell.zeta, 1e-6, 1e-4 * cell.zeta, 1e-6)):
        shift = np.eye(5)[j] * step
        change = seen(drive, draw, theta + shift) - seen(drive, draw, theta - shift)
        columns.append((change / (2 * step))[::every].T.ravel())
    s = np.linspace(-1, 1, len(drive.time_s))
    t = drive.time_s
    h = [response(drive, theta[0], theta[1]), response(drive, theta[2], theta[3])]
    c, si = np.cos(theta[4]), np.sin(theta[4])
    for sensor, mix in enumerate(((c, -1j * si), (-si, -1j * c))):
        own = mix[0] * h[0] + mix[1] * h[1]
        linear = [own.real, own.imag, np.ones_like(s), s]
        for f, z in {(theta[0], theta[1]), (theta[2], theta[3])}:
            free = np.exp(2 * np.pi * f * complex(-z, np.sqrt(1 - z * z)) * t)
            linear += [free.real, free.imag]
        for one in linear:
            both = np.zeros((2, len(t[::every])))
            both[sensor] = one[::every]
            columns.append(both.ravel())
    matrix = np.column_stack(columns) * np.sqrt(every) / NOISE_M
    size = np.linalg.norm(matrix, axis=0)
    inverse = np.linalg.pinv((matrix / size).T @ (matrix / size), rcond=1e-13, hermitian=True)
    return np.sqrt(np.diag(inverse))[:5] / size[:5]


def record(cell: Cell, draw: Draw, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """time, displacement with noise, measured phase."""
    drive = Drive.of(cell, draw)
    theta = np.array([cell.f_Hz[0], cell.zeta, cell.f_Hz[1], cell.zeta, draw.angle_rad])
    signal = seen(drive, draw, theta) + draw.offset + NOISE_M * rng.normal(size=(len(drive.time_s), 2))
    phase = phase_of(cell, draw, drive.time_s)[0] + cell.phase_noise_rad * rng.normal(size=len(drive.time_s))
    if cell.resolution_rad:
        phase = np.round(phase / cell.resolution_rad) * cell.resolution_rad
    return drive.time_s, signal, phase


def one_cell(cell: Cell, runs: int, seed: int, setting: str) -> None:
    """Run and print one cell."""
    rng = np.random.default_rng([seed, sum(map(ord, cell.name))])
    errors: dict[str, list[float]] = {n: [] for n in NAMES}
    scaled: dict[str, list[float]] = {n: [] for n in NAMES}
    inside: dict[str, list[bool]] = {n: [] for n in NAMES}
    failed, wrong, seconds, naive = [], 0, [], []
    # the bound differs from draw to draw; what squared errors are to be compared with is its mean square
    limits = np.sqrt(np.mean([bound(cell, Draw.of(cell, rng)) ** 2 for _ in range(8)], axis=0))
    for run in range(runs):
        draw = Draw.of(cell, rng)
        data = record(cell, draw, rng)
        began = time.process_time()
        try:
            fit = fit_run_up(*data, setting=setting)
        except IdentificationError as error:
            failed.append(f"run {run}: {error}")
            continue
        seconds.append(time.process_time() - began)
        truth = dict(
            zip(NAMES, (cell.f_Hz[0], cell.zeta, cell.f_Hz[1], cell.zeta, np.degrees(draw.angle_rad)), strict=True)
        )
        _collect(fit, truth, errors, scaled, inside)
        wrong += any((f"f{i}_Hz" in fit.values) != (i in cell.passed) for i in (1, 2))
        naive.append([*fit.half_power["x"], *fit.vold_kalman["x"]])
    print(
        f"\n{cell.name}: {runs - len(failed)}/{runs} converged, {wrong} with a wrong set of values, "
        f"{1e3 * np.median(seconds or [np.nan]):.0f} ms of processor time"
    )
    for text in failed[:3]:
        print(f"  {text}")
    for i, name in enumerate(NAMES):
        if len(errors[name]) < 0.5 * runs:
            continue
        e, z = np.array(errors[name]), np.array(scaled[name])
        limit = np.degrees(limits[4]) if i == 4 else limits[i]
        value = 1.0 if i == 4 else truth[name]
        print(
            f"  {name:15} rms {np.sqrt(np.mean(e**2)) / value:9.2e}  rms/bound {np.sqrt(np.mean(e**2)) / limit:6.3f}  "
            f"bias {np.mean(z):+.3f} sd  sd of z {np.std(z):.3f}  covers {100 * np.mean(inside[name]):.1f} %  "
            f"worst |z| {np.abs(z).max():.1f}"
        )
    peers = np.nanmedian(np.array(naive), axis=0) if naive else np.full(4, np.nan)
    f, z = cell.f_Hz[0], cell.zeta
    print(
        f"  half-power: f {peers[0] / f - 1:+.2%}, ζ {peers[1] / z - 1:+.0%};  "
        f"Vold–Kalman: f {peers[2] / f - 1:+.2%}, ζ {peers[3] / z - 1:+.0%}",
        flush=True,
    )


def _collect(fit: RunUpFit, truth: dict, errors: dict, scaled: dict, inside: dict) -> None:
    for name, true in truth.items():
        if name in fit.values:
            low, high = fit.intervals[name]
            errors[name].append(fit.values[name] - true)
            scaled[name].append((fit.values[name] - true) / fit.std[name])
            inside[name].append(low <= true <= high)


def plain_least_squares(cell: Cell, seed: int) -> None:
    """The same record by scipy's least_squares on the plain model, all samples, from a start 1 % off."""
    rng = np.random.default_rng(seed)
    draw = Draw.of(cell, rng)
    t, signal, phase = record(cell, draw, rng)
    drive = Drive.of(cell, draw)

    def residual(p: np.ndarray) -> np.ndarray:
        moved = Draw(0.0, complex(p[5], p[6]) * cell.eccentricity_m, draw.offset, draw.ripple)
        return ((seen(drive, moved, p) + p[7:9] * 1e-3 - signal) / NOISE_M).ravel()

    for off in (0.001, 0.01, 0.05):
        start = np.r_[
            cell.f_Hz[0] * (1 + off),
            cell.zeta * 1.3,
            cell.f_Hz[1] * (1 + off),
            cell.zeta * 1.3,
            0.0,
            1.0,
            0.0,
            0.0,
            0.0,
        ]
        start[5:7] = [(draw.amplitude / cell.eccentricity_m).real, (draw.amplitude / cell.eccentricity_m).imag]
        began = time.process_time()
        found = least_squares(residual, start, x_scale="jac", max_nfev=30)
        print(
            f"  scipy least_squares from {off:.1%} off in f: {time.process_time() - began:.2f} s, "
            f"f1 {found.x[0] / cell.f_Hz[0] - 1:+.1e}, ζ1 {found.x[1] / cell.zeta - 1:+.1e}"
        )
    began = time.process_time()
    fit = fit_run_up(t, signal, phase)
    print(
        f"  ours, no start value: {time.process_time() - began:.2f} s, "
        f"f1 {fit.values['f1_Hz'] / cell.f_Hz[0] - 1:+.1e}, "
        f"ζ1 {fit.values['zeta1'] / cell.zeta - 1:+.1e}"
    )


def speed(seed: int) -> None:
    """60 s, two channels: 1 kHz and 10 kHz, every setting; wall time, medians of five."""
    for rate in (1000.0, 10000.0):
        cell = Cell("speed", (3.0, 5.0), 0.01, power(0.5, 7.0), rate_Hz=rate)
        rng = np.random.default_rng(seed)
        data = record(cell, Draw.of(cell, rng), rng)
        for setting in ("fast", "balanced", "reference"):
            taken = []
            for _ in range(5):
                began, cpu = time.perf_counter(), time.process_time()
                fit_run_up(*data, setting=setting)
                taken.append((time.perf_counter() - began, time.process_time() - cpu))
            wall, cpu = np.median(taken, axis=0)
            print(f"  {rate / 1000:.0f} kHz, {setting}: {wall:.3f} s, processor {cpu:.3f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--quick", action="store_true", help="30 runs a cell")
    parser.add_argument("--only", default="", help="cells whose name holds this")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--setting", default="balanced")
    arguments = parser.parse_args()
    runs = 30 if arguments.quick else arguments.runs
    print(f"seed {arguments.seed}, {runs} runs a cell, {arguments.setting}")
    if not arguments.only:
        speed(arguments.seed)
        plain_least_squares(CELLS[1], arguments.seed)
    for cell in CELLS:
        if arguments.only in cell.name:
            one_cell(cell, runs, arguments.seed, arguments.setting)


if __name__ == "__main__":
    main()
