"""Common methods for a run-up, each sensor for one mode, with the passage treated as a steady state."""

from __future__ import annotations

from dynamics.equations.speed_history import SpeedHistory
from identification.bench.ramps import RampRecord
from identification.bench.trials import MethodResult
from identification.run_up import naive
from identification.samples import Averages, block_averages, white_noise

_BLOCK_S = 4e-3


def half_power(record: RampRecord) -> MethodResult:
    """Estimate by the peak of the order-1 amplitude over speed squared, and its width at 1/√2."""
    channels, history = _prepared(record)
    return _answer([naive.half_power(channel, history) for channel in channels])


def vold_kalman(record: RampRecord) -> MethodResult:
    """Fit the resonance curve of a steady state to the amplitude of a Vold–Kalman filter."""
    channels, history = _prepared(record)
    return _answer([naive.vold_kalman(channel, history) for channel in channels])


def _prepared(record: RampRecord) -> tuple[list[Averages], SpeedHistory]:
    every = round(_BLOCK_S / (record.time_s[1] - record.time_s[0]))
    channels = [block_averages(record.time_s, y, _BLOCK_S, white_noise(y)) for y in record.displacement_m.T]
    return channels, SpeedHistory.from_phases(record.time_s[::every], record.phase_rad[::every])


def _answer(modes: list[tuple[float, float]]) -> MethodResult:
    return MethodResult(
        {name: v for i, pair in enumerate(modes, 1) for name, v in zip((f"f{i}_Hz", f"zeta{i}"), pair, strict=True)}
    )
