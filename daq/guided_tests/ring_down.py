# pyright: strict
"""Ring-down: pluck along an axis, record until it has rung down to a fiftieth."""

from __future__ import annotations

import math

from daq.acquisition.core import PAST_S
from daq.guided_tests.frame import framed
from daq.guided_tests.hands import HUMAN_S
from daq.guided_tests.kinds import CHANNELS, Asked, Number, TestKind
from daq.guided_tests.table import FAULT, MOTION, Look, State, Table, View, no_orders

_ANSWER_S = 5.0  # how long a device may take, wall s
_CALM_S = 30.0  # how long a column that rings at first may take to come to rest, rig s
_SEEN_S = 10.0  # how far back to look for what a person did; a person may take minutes, the signals must stay few
_BEFORE_S, _AFTER_PLUCK_S, _WINDOW_S = 0.7, 0.8, 0.6
_RING_DOWN_S = 60.0  # rig time
_PLUCKED_M = 3e-4  # a displacement that is no longer vibration of the building
_STILL_M = 4e-5  # peak to peak
_SWUNG = 0.3  # of the farthest to one side a column that was let go swings at least so far to the other
_BACK = 0.1  # of it: so near to rest has come back who is not held any more

PRE_TRIGGER = Number("s in the log before the motion; 0: the log begins with the wait", 0.0, 0.0, PAST_S)


def _table(axis: str, asked: Asked) -> Table:
    topic, before_s = CHANNELS[axis], asked.numbers["pre_trigger_s"]
    later = before_s > 0

    def calm(view: View) -> Look:
        now = view.measures.peak_to_peak(topic, _WINDOW_S)
        words = f"waiting for the column to come to rest: {now * 1e3:.2f} mm peak to peak"
        return Look(not now >= _PLUCKED_M, words)  # of a blocked sensor the next state says it

    def quiet(view: View) -> Look:
        enough = view.in_state_s >= _BEFORE_S and view.measures.valid(topic, 0.5) > 0.4
        return Look(enough, "looking at the column at rest", remember={"rest_m": view.measures.rest_m(topic, 0.5)})

    def plucked(view: View) -> Look:
        since = max(view.asked_ns, view.measures.since(_SEEN_S))
        farthest = view.measures.largest_since(topic, since, view.memory["rest_m"])
        return Look(farthest > _PLUCKED_M, f"pluck the column along {axis} by 2 to 3 mm and let go")

    def rung_down(view: View) -> Look:
        """Still again, near where it was at rest, after a swing to both sides: a hand that holds it is no ring-down."""
        low, high = view.measures.extremes(topic, _WINDOW_S)
        if view.in_state_s < _AFTER_PLUCK_S or not math.isfinite(high - low):
            return Look(False)  # a blocked sensor shows nothing of the column
        rest, now = view.memory["rest_m"], high - low
        peak = max(view.memory.get("peak_m", 0.0), now)
        least, most = min(view.memory.get("low_m", 0.0), low - rest), max(view.memory.get("high_m", 0.0), high - rest)
        far = max(-least, most)
        swung = min(-least, most) > _SWUNG * far
        back = abs(0.5 * (low + high) - rest) < max(_BACK * far, _STILL_M)
        still = now < peak / 50 or now < _STILL_M
        share = min(1.0, math.log(max(peak, 1e-9) / max(now, 1e-9)) / math.log(50)) if swung else 0.0
        words = f"{now * 1e3:.2f} mm peak to peak"
        if still and not back:
            words = f"let go of the column: it is held {(0.5 * (low + high) - rest) * 1e3:+.2f} mm from rest"
        elif still and not swung:
            words = f"the column came back without a swing: pluck it along {axis} again and let go at once"
        remember = {"peak_m": peak, "low_m": least, "high_m": most}
        return Look(still and back and swung, words, share, remember)

    def left(view: View) -> str:
        now, peak = view.measures.peak_to_peak(topic, _WINDOW_S), view.memory.get("peak_m", 0.0)
        seen = "the sensor sees nothing" if math.isnan(now) else f"{now * 1e3:.2f} of {peak * 1e3:.2f} mm were left"
        if now < _STILL_M or now < peak / 50:
            seen = "it was held, or brought back by hand"
        return f"the column to be let go and ring down to a fiftieth within {_RING_DOWN_S:g} s: {seen}"

    return framed(
        asked,
        State(
            "calm",
            does="",
            waits_for=f"less than {_PLUCKED_M * 1e3:g} mm peak to peak",
            look=calm,
            period_s=0.1,
            usual_s=0.2,
            limit_s=_CALM_S,
            missed=lambda view: (
                f"the column to come to rest within {_CALM_S:g} s: "
                f"{view.measures.peak_to_peak(topic, _WINDOW_S) * 1e3:.2f} mm peak to peak left. Find what shakes it"
            ),
        ),
        State(
            "quiet",
            does="" if later else "begin the log",
            enter=no_orders if later else lambda orders: orders.begin(before_s),
            waits_for="half a second of valid samples",
            look=quiet,
            period_s=0.1,
            usual_s=1.0,
            limit_s=_ANSWER_S,
            wall=True,
            late=FAULT,
            missed=lambda view: f"waited {_ANSWER_S:g} s for half a second of valid samples of {topic}",
        ),
        State(
            "pluck",
            does="ask for the pluck",
            enter=lambda orders: orders.operator.pluck(axis),
            actor="operator",
            asks=f"displace the column by 2 to 3 mm along {axis} and let go",
            waits_for=f"{_PLUCKED_M * 1e3:g} mm from rest",
            look=plucked,
            period_s=0.02,
            usual_s=10.0,
            limit_s=HUMAN_S,
            wall=True,
            missed=lambda view: f"a pluck along {axis} within {HUMAN_S:g} s",
        ),
        State(
            "ring",
            does="begin the log" if later else "",
            waits_for="a swing, then a fiftieth of it, or 0.04 mm",
            enter=(lambda orders: orders.begin(before_s)) if later else no_orders,
            look=rung_down,
            usual_s=15.0,
            limit_s=_RING_DOWN_S,
            missed=left,
            fact="rung_down",
            no_pause=MOTION,
        ),
    )


_SUSPENSION = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2")  # a hand never pulls along one axis alone


def _kind(axis: str) -> TestKind:
    return TestKind(
        f"ring-down-{axis}",
        f"pluck the column along {axis}, record until it has rung down to a fiftieth",
        (axis,),
        turns=False,
        table=lambda asked: _table(axis, asked),
        gives=_SUSPENSION,
        numbers={"pre_trigger_s": PRE_TRIGGER},
    )


KIND_X = _kind("x")
KIND_Y = _kind("y")
