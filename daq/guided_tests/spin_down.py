# pyright: strict
"""Spin-down: release both pendulums at rest, flick them, record until they have slowed by e⁵."""

from __future__ import annotations

import math

import numpy as np

from daq.guided_tests.hands import HUMAN_S
from daq.guided_tests.steps import Steps, TestDone

_SEEN_S = 10.0  # how far back to look for what a person did
_SPIN_DOWN_S = 120.0  # rig time
_FLICKED_RAD = 0.5


def spin_down(steps: Steps) -> TestDone:
    """See above."""
    test, look = "spin-down", steps.look
    steps.refuse(test)
    steps.at_rest_and_locked()
    steps.locks.release(turning=False)
    steps.begin(test, {})
    steps.clock.sleep(0.7)
    steps.tell(f"{test}: flick both pendulums, slower than two turns a second", None)
    asked = steps.clock.now_ns()
    steps.operator.flick()
    steps.until(
        lambda: bool(np.all(look.turned_since(max(asked, look.since(_SEEN_S)))[0] > _FLICKED_RAD)),
        HUMAN_S,
        "both pendulums to be flicked",
    )

    def slowed() -> bool:
        rates = np.abs(look.rates())
        _, peak = look.turned_since(asked)
        if not np.all(np.isfinite(rates)):
            return False  # radio silence says nothing about the pendulums
        share = float(np.min(np.log(peak / np.maximum(rates, 1e-3)))) / 5.0
        steps.tell(f"{test}: {rates[0]:.2f} and {rates[1]:.2f} rad/s", min(1.0, max(0.0, share)))
        return share >= 1.0

    reached = steps.look_until(slowed, _SPIN_DOWN_S)
    a, b = np.abs(look.rates())
    seen = "their angles are missing" if math.isnan(a + b) else f"{a:.2f} and {b:.2f} rad/s were left"
    missed = "" if reached else f"the pendulums to slow down by e⁵ within {_SPIN_DOWN_S:g} s: {seen}"
    done = steps.end(test, {"slowed_down": reached}, missed)
    steps.locks.lock()
    return done
