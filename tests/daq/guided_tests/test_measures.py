"""The values that a guided test looks at while it records."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from daq import channels
from daq.acquisition.recent import Recent
from daq.acquisition.session import Session
from daq.guided_tests.measures import Measures
from daq.items import Batch
from daq.signals.settling import RotorSignals, SettlingLimits, settled

BEGIN_NS = 1_800_000_000_000_000_000
RELEASE_S, END_S, TURN_S = 1.5, 35.0, 0.125


def recorded(signals: RotorSignals) -> Measures:
    """Measures of a session that has just received the signals."""
    recent = Recent(90.0)

    def add(topic: str, time_s: np.ndarray, **columns: np.ndarray) -> None:
        time_ns, count = BEGIN_NS + np.round(1e9 * time_s).astype(np.int64), np.arange(len(time_s), dtype=np.uint32)
        recent.add(Batch(channels.CHANNELS[topic], time_ns, count, columns))

    angles = {"theta3_rad": signals.angle_rad[:, 0], "theta4_rad": signals.angle_rad[:, 1]}
    add("pendulums", signals.angle_time_s, **angles)
    add("tacho", signals.mark_time_s, revolutions=np.round(signals.mark_phase_rad / (2 * np.pi)).astype(np.int64))
    add("laser/x", signals.x_time_s, displacement_m=signals.x_m)
    add("laser/y", signals.y_time_s, displacement_m=signals.y_m)
    clock = SimpleNamespace(now_ns=lambda: BEGIN_NS + int(END_S * 1e9))
    return Measures(cast(Session, SimpleNamespace(channels=SimpleNamespace(recent=recent), clock=clock)))


def test_a_look_and_the_analysis_of_the_log_judge_the_same_windows() -> None:
    """Errors of the marks give amplitudes a wide noise: the decision depends on all windows since the release."""
    rng = np.random.default_rng(4)
    t, laser = np.arange(0.0, END_S, 0.01), np.arange(0.0, END_S, 0.001)
    true = np.arange(0.0, END_S, TURN_S)
    size = 3e-3 + 4e-5 * np.exp(-(laser - RELEASE_S) / 4)
    x, y = (size * f(2 * np.pi * laser / TURN_S) for f in (np.cos, np.sin))
    angles = np.column_stack([2.0 + 0.3 * np.exp(-np.maximum(t - RELEASE_S, 0)), 4.0 + 0 * t])
    marks = true + 2e-4 * rng.standard_normal(len(true))
    signals = RotorSignals(t, angles, marks, 2 * np.pi * np.arange(len(true)), laser, x, laser, y)
    step = 2 * np.pi / 4096
    look = recorded(signals).steady(BEGIN_NS + int(RELEASE_S * 1e9), step, SettlingLimits())
    log = settled(signals, release_time_s=RELEASE_S, angle_step_rad=step)
    assert look.span_s == pytest.approx(log.span_s)
    assert look.span_s > 25.0
    assert look.remaining_m == pytest.approx(log.remaining_m, rel=0.1)
