# pyright: strict
"""Ring-down: pluck along an axis, record until it has rung down to a fiftieth."""

from __future__ import annotations

import math

import numpy as np

from daq.guided_tests.hands import HUMAN_S
from daq.guided_tests.kinds import CHANNELS
from daq.guided_tests.steps import Steps, TestDone

_ANSWER_S = 5.0  # how long a device may take, wall seconds
_SEEN_S = 10.0  # how far back to look for what a person did; a person may take minutes, the signals must stay few
_RING_DOWN_S = 60.0  # rig time
_PLUCKED_M = 3e-4  # a displacement that is no longer vibration of the building


def ring_down(steps: Steps, axis: str) -> TestDone:
    """See above."""
    test, topic, look = f"ring-down-{axis}", CHANNELS[axis], steps.look
    steps.refuse(test)
    steps.at_rest_and_locked(angles_needed=False)
    steps.begin(test, {})
    steps.clock.sleep(0.7)
    steps.tell(f"{test}: pluck the column along {axis} by 2 to 3 mm and let go", None)
    steps.until(lambda: look.valid(topic, 0.5) > 0.4, _ANSWER_S, f"half a second of valid samples of {topic}")
    rest = float(np.nanmedian(steps.session.newest(topic, ("displacement_m",), 0.5)[1][0]))
    asked = steps.clock.now_ns()
    steps.operator.pluck(axis)
    steps.until(
        lambda: look.largest_since(topic, max(asked, look.since(_SEEN_S)), rest) > _PLUCKED_M,
        HUMAN_S,
        f"the column to be plucked along {axis}",
    )
    steps.clock.sleep(0.8)
    peak = 0.0

    def rung_down() -> bool:
        nonlocal peak
        now = look.peak_to_peak(topic, 0.6)
        if not math.isfinite(now):
            return False  # a blocked sensor says nothing about the column
        peak = max(peak, now)
        share = math.log(max(peak, 1e-9) / max(now, 1e-9)) / math.log(50)
        steps.tell(f"{test}: {now * 1e3:.2f} mm peak to peak", min(1.0, share))
        return now < peak / 50 or now < 4e-5

    reached = steps.look_until(rung_down, _RING_DOWN_S)
    left = look.peak_to_peak(topic, 0.6)
    seen = "the sensor sees nothing" if math.isnan(left) else f"{left * 1e3:.2f} of {peak * 1e3:.2f} mm were left"
    missed = "" if reached else f"the column to ring down to a fiftieth within {_RING_DOWN_S:g} s: {seen}"
    return steps.end(test, {"rung_down": reached}, missed)
