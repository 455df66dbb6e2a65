"""Simulation of a planned ramp: motion of the model, evaluated by the page's own 1× vectors."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics import Scene, SpeedHistory, simulate
from dynamics.errors import DynamicsError
from dynamics.motions.integrate import locked_state
from live.model import LiveModel
from live.signals import Signals
from live.vectors import LiveVectors
from rig_basics.arrays import Array
from rig_basics.units import RPM
from rig_configs.schema import Rig

_SAMPLES_PER_TURN, _MIN_RATE_HZ = 32, 400.0
_KNOTS_PER_S = 10.0
_ACCURACY = 1e-3
_MAX_DURATION_S = 1200.0  # a longer ramp is nearly steady, and slow to simulate
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SpeedRamp:
    """A constant change of speed with the pendulums locked at 0° and 180°.

    Attributes:
        start_rpm, end_rpm: speeds at its ends.
        duration_s: duration, > 0.
    """

    start_rpm: float
    end_rpm: float
    duration_s: float

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> SpeedRamp | None:
        """Return the ramp of the running test from its numbers; None if it is not a ramp, or longer than 20 minutes."""
        numbers: Mapping[str, float] = facts.get("numbers", {})
        top, duration = numbers.get("top_rpm", 0.0), numbers.get("duration_s", 0.0)
        if not (top > 0 and 0 < duration <= _MAX_DURATION_S):
            return None
        ends = {"run-up": (0.0, top), "run-down": (top, 0.0)}.get(str(facts.get("test")))
        return None if ends is None else cls(*ends, duration)


def simulated_ramp(rig: Rig, model: LiveModel, ramp: SpeedRamp) -> Array:
    """Return the 1× vectors of a ramp as the page will measure them, without noise and run-out.

    Returns:
        Rows (rpm, Re X, Im X, Re Y, Im Y), mm, shape (n, 5); no rows if the simulation fails.
    """
    speeds = (ramp.start_rpm * RPM, ramp.end_rpm * RPM)
    rate_hz = max(_MIN_RATE_HZ, _SAMPLES_PER_TURN * max(speeds) / (2 * math.pi))
    time_s = np.arange(0.0, ramp.duration_s, 1 / rate_hz)
    knots = np.linspace(0.0, ramp.duration_s, max(8, round(_KNOTS_PER_S * ramp.duration_s)))
    change = (speeds[1] - speeds[0]) / ramp.duration_s
    try:
        history = SpeedHistory.from_phases(knots, speeds[0] * knots + 0.5 * change * knots**2)
        phase = history.phase(time_s).T[0]
        begin = locked_state(model.physics, speeds[0], 0.0, 0.0, math.pi)
        motion = simulate(model.physics, Scene(history, (False, False), begin, None), time_s, _ACCURACY)
    except DynamicsError as error:
        _log.info("simulation of the planned ramp, the page displays none: %s", error)
        return np.empty((0, 5))
    signals = Signals(rig, 0, len(time_s))
    for axis, values in zip("xy", model.shown(motion.displacement_m[:, 0], motion.displacement_m[:, 1]), strict=True):
        signals.by_name[axis].add(time_s, values)
    index = math.radians(rig.roles.phase.index_angle_deg if rig.roles.phase else 0.0)
    first, last = ((float(phase[at]) - index) / (2 * math.pi) for at in (0, -1))
    turns = np.asarray(range(math.ceil(first), math.floor(last) + 1), np.float64)
    signals.by_name["turns"].add(np.interp(2 * math.pi * turns + index, phase, time_s), turns)
    vectors = LiveVectors(signals)
    vectors.follow(ramp.duration_s)
    return vectors.between(0.0, ramp.duration_s)
