"""Spin-down: release both pendulums at rest, flick them, record until they have slowed by e⁵."""

from __future__ import annotations

import math

import numpy as np

from daq.guided_test_kinds import GuidedTestRequest, TestKind
from daq.guided_tests.frame import RELEASE_AT_REST, framed, log_begin
from daq.guided_tests.hands import HUMAN_S
from daq.guided_tests.ring_down import PRE_TRIGGER
from daq.guided_tests.table import MOTION, State, StateObservation, StateTable, StateView, after

_MAX_FLICK_AGE_S = 10.0  # stretch of the angles in which a flick is searched, s
_BEFORE_S = 0.7  # at rest before the flick, s
_MAX_SPIN_DOWN_S = 120.0  # s
_FLICKED_RAD = 0.5  # turn of a pendulum that counts as a flick


def _flicked(view: StateView) -> StateObservation:
    since = max(view.entry_began_ns, view.measures.since(_MAX_FLICK_AGE_S))
    turned = view.measures.turned_since(since)[0]
    words = "flick both pendulums, slower than two turns a second"
    return StateObservation(bool(np.all(turned > _FLICKED_RAD)), words, store={"flick_since_ns": view.entry_began_ns})


def _slowed(view: StateView) -> StateObservation:
    rates, (_, peak) = np.abs(view.measures.rates()), view.measures.turned_since(view.memory["flick_since_ns"])
    if not np.all(np.isfinite(rates)):
        return StateObservation(False)  # the angles are missing while the radio is silent
    share = float(np.min(np.log(peak / np.maximum(rates, 1e-3)))) / 5.0
    return StateObservation(share >= 1.0, f"{rates[0]:.2f} and {rates[1]:.2f} rad/s", min(1.0, max(0.0, share)))


def _left(view: StateView) -> str:
    a, b = np.abs(view.measures.rates())
    seen = "their angles are missing" if math.isnan(a + b) else f"{a:.2f} and {b:.2f} rad/s were left"
    return f"the pendulums to slow down by e⁵ within {_MAX_SPIN_DOWN_S:g} s: {seen}"


def _table(request: GuidedTestRequest) -> StateTable:
    before_s = request.numbers["pre_trigger_s"]
    return framed(
        request,
        RELEASE_AT_REST,
        State(
            "quiet",
            *log_begin(before_s, with_motion=False),
            waits_for=f"{_BEFORE_S:g} s at rest",
            look=after(_BEFORE_S, "the pendulums at rest"),
            period_s=0.1,
            limit_s=60.0,
            usual_s=_BEFORE_S,
        ),
        State(
            "flick",
            does="request the flick",
            enter=lambda commands: commands.operator.flick(),
            actor="operator",
            asks="flick both pendulums, slower than two turns a second",
            waits_for="half a radian of both",
            look=_flicked,
            period_s=0.02,
            usual_s=10.0,
            limit_s=HUMAN_S,
            missed=lambda view: f"a flick of both pendulums within {HUMAN_S:g} s",
        ),
        State(
            "swing",
            *log_begin(before_s, with_motion=True),
            waits_for="both slower by e⁵",
            look=_slowed,
            usual_s=25.0,
            limit_s=_MAX_SPIN_DOWN_S,
            missed=_left,
            fact="slowed_down",
            no_pause=MOTION,
        ),
        releases=True,
    )


KIND = TestKind(
    "spin-down",
    "flick both pendulums, record until they have slowed by e⁵",
    ("angles",),
    turns=False,
    table=_table,
    gives=("c3_Nms_per_rad", "c4_Nms_per_rad"),
    numbers={"pre_trigger_s": PRE_TRIGGER},
)
