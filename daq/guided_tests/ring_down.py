"""Ring-down: pluck along an axis, record until the amplitude has decayed to 1/50."""

from __future__ import annotations

import math
from dataclasses import dataclass

from daq.acquisition.core import PAST_S
from daq.guided_test_kinds import CHANNELS, GuidedTestRequest, Number, TestKind
from daq.guided_tests.frame import framed, log_begin
from daq.guided_tests.hands import HUMAN_S
from daq.guided_tests.table import FAULT, MOTION, State, StateObservation, StateTable, StateView

_MAX_ANSWER_S = 5.0  # wait for valid samples of a device, s
_MAX_CALM_S = 30.0  # wait for the column to come to rest before the pluck, s
_MAX_PLUCK_AGE_S = 10.0  # stretch in which a pluck is searched, s; the wait may last minutes, the data stay few
_BEFORE_S, _AFTER_PLUCK_S, _WINDOW_S = 0.7, 0.8, 0.6
_MAX_RING_DOWN_S = 60.0  # s
_PLUCKED_M = 3e-4  # displacement that vibration of the building does not reach
_STILL_M = 4e-5  # peak to peak of a column at rest
_MIN_SWING_RATIO = 0.3  # swing to the other side, relative to the largest displacement, of a released column
_MAX_REST_OFFSET_RATIO = 0.1  # distance from rest, relative to the largest displacement, of a released column

PRE_TRIGGER = Number("s in the log before the motion; 0: the log begins with the wait", 0.0, 0.0, PAST_S)


@dataclass(frozen=True)
class _RingDown:
    """The states of one ring-down.

    Attributes:
        axis: "x" or "y".
        topic: channel of the displacement along the axis.
        before_s: length of the pre-trigger, s; 0 if the log begins with the wait for the pluck.
    """

    axis: str
    topic: str
    before_s: float

    # --- looks -------------------------------------------------------------------------------------------------

    def calm(self, view: StateView) -> StateObservation:
        """Wait until the column is nearly at rest. Without valid samples the next state reports it."""
        now = view.measures.peak_to_peak(self.topic, _WINDOW_S)
        words = f"waiting for the column to come to rest: {now * 1e3:.2f} mm peak to peak"
        return StateObservation(not now >= _PLUCKED_M, words)

    def quiet(self, view: StateView) -> StateObservation:
        """Measure the column at rest."""
        done = view.in_state_s >= _BEFORE_S and view.measures.valid(self.topic, 0.5) > 0.4
        return StateObservation(
            done, "measuring the column at rest", store={"rest_m": view.measures.rest_m(self.topic, 0.5)}
        )

    def plucked(self, view: StateView) -> StateObservation:
        """Wait for a displacement since the request."""
        since = max(view.entry_began_ns, view.measures.since(_MAX_PLUCK_AGE_S))
        largest = view.measures.largest_since(self.topic, since, view.memory["rest_m"])
        return StateObservation(largest > _PLUCKED_M, f"pluck the column along {self.axis} by 2 to 3 mm and release it")

    def rung_down(self, view: StateView) -> StateObservation:
        """Wait until the displacement is at rest near the rest position after swings to both sides.

        A column that is held by hand does not meet these conditions. While the sensor is blocked the look is not done.
        """
        low, high = view.measures.extremes(self.topic, _WINDOW_S)
        if view.in_state_s < _AFTER_PLUCK_S or not math.isfinite(high - low):
            return StateObservation(False)
        rest, now = view.memory["rest_m"], high - low
        peak = max(view.memory.get("peak_m", 0.0), now)
        least, most = min(view.memory.get("low_m", 0.0), low - rest), max(view.memory.get("high_m", 0.0), high - rest)
        largest, offset = max(-least, most), 0.5 * (low + high) - rest
        has_swung = min(-least, most) > _MIN_SWING_RATIO * largest
        is_back = abs(offset) < max(_MAX_REST_OFFSET_RATIO * largest, _STILL_M)
        is_still = now < peak / 50 or now < _STILL_M
        share = min(1.0, math.log(max(peak, 1e-9) / max(now, 1e-9)) / math.log(50)) if has_swung else 0.0
        words = f"{now * 1e3:.2f} mm peak to peak"
        if is_still and not is_back:
            words = f"release the column: it is held {offset * 1e3:+.2f} mm from rest"
        elif is_still and not has_swung:
            words = f"the column returned without a swing: pluck along {self.axis} again, release at once"
        store = {"peak_m": peak, "low_m": least, "high_m": most}
        return StateObservation(is_still and is_back and has_swung, words, share, store)

    # --- texts after the time limit ----------------------------------------------------------------------------

    def not_calm(self, view: StateView) -> str:
        """Return what was not reached in the state "calm"."""
        now_mm = view.measures.peak_to_peak(self.topic, _WINDOW_S) * 1e3
        return (
            f"the column to come to rest within {_MAX_CALM_S:g} s: {now_mm:.2f} mm peak to peak left. "
            "Find the source of the vibration"
        )

    def not_rung_down(self, view: StateView) -> str:
        """Return what was not reached in the state "ring"."""
        now, peak = view.measures.peak_to_peak(self.topic, _WINDOW_S), view.memory.get("peak_m", 0.0)
        if math.isnan(now):
            found = "the sensor gives no valid samples"
        elif now < _STILL_M or now < peak / 50:
            found = "it was held, or brought back by hand"
        else:
            found = f"{now * 1e3:.2f} of {peak * 1e3:.2f} mm were left"
        return f"the column to be released and ring down to a fiftieth within {_MAX_RING_DOWN_S:g} s: {found}"

    # --- states ------------------------------------------------------------------------------------------------

    def all(self) -> tuple[State, ...]:
        """Return the states from the rest before the pluck to the end of the ring-down."""
        return (
            State(
                "calm",
                waits_for=f"less than {_PLUCKED_M * 1e3:g} mm peak to peak",
                look=self.calm,
                period_s=0.1,
                usual_s=0.2,
                limit_s=_MAX_CALM_S,
                missed=self.not_calm,
            ),
            State(
                "quiet",
                *log_begin(self.before_s, with_motion=False),
                waits_for="half a second of valid samples",
                look=self.quiet,
                period_s=0.1,
                usual_s=1.0,
                limit_s=_MAX_ANSWER_S,
                late=FAULT,
                missed=lambda view: f"waited {_MAX_ANSWER_S:g} s for half a second of valid samples of {self.topic}",
            ),
            State(
                "pluck",
                does="request the pluck",
                enter=lambda commands: commands.operator.pluck(self.axis),
                actor="operator",
                asks=f"displace the column by 2 to 3 mm along {self.axis} and release it",
                waits_for=f"{_PLUCKED_M * 1e3:g} mm from rest",
                look=self.plucked,
                period_s=0.02,
                usual_s=10.0,
                limit_s=HUMAN_S,
                missed=lambda view: f"a pluck along {self.axis} within {HUMAN_S:g} s",
            ),
            State(
                "ring",
                *log_begin(self.before_s, with_motion=True),
                waits_for="a swing, then a fiftieth of it, or 0.04 mm",
                look=self.rung_down,
                usual_s=15.0,
                limit_s=_MAX_RING_DOWN_S,
                missed=self.not_rung_down,
                fact="rung_down",
                no_pause=MOTION,
            ),
        )


def _table(axis: str, request: GuidedTestRequest) -> StateTable:
    return framed(request, *_RingDown(axis, CHANNELS[axis], request.numbers["pre_trigger_s"]).all())


_SUSPENSION = (
    "k1_N_per_m",
    "k2_N_per_m",
    "zeta1",
    "zeta2",
)  # both directions, since a hand does not pull exactly along one axis


def _kind(axis: str) -> TestKind:
    return TestKind(
        f"ring-down-{axis}",
        f"pluck the column along {axis}, record until the amplitude has decayed to 1/50",
        (axis,),
        turns=False,
        table=lambda request: _table(axis, request),
        gives=_SUSPENSION,
        numbers={"pre_trigger_s": PRE_TRIGGER},
    )


KIND_X = _kind("x")
KIND_Y = _kind("y")
