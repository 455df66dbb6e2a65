"""Common beginning and ending of all guided tests: rotor at rest, pendulums locked, log finished."""

from __future__ import annotations

import math
from collections.abc import Callable

from daq.guided_test_kinds import GuidedTestRequest
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.hands import HAND_RAMP_RPM_S
from daq.guided_tests.table import State, StateObservation, StateTable, StateView, no_commands
from daq.signals.speed_agreement import SPEED_TOLERANCE
from rig_basics.units import RPM
from rig_configs.schema import Rig

_MAX_STATUS_S = 2.5  # wait for a device's description; it is sent every second, and one message may be lost
_LOCKED_LOOK_S = 0.2  # stretch over which closed locks are observed before the counters are checked, s
_SPIN_UP_S = 60.0  # permitted in addition to the duration of the ramp, s
_HELD_S = 1.0  # for which a drive must hold a speed, so that a ramp that passes it does not count, s
_BY_HAND_S = 240.0  # the same if a person turns the rotor, s
_NEAR_RESONANCE = 0.1  # relative distance from a resonance below which the orbit is several times as large

ASK_TO_LOCK = "with the rotor at rest, lock both pendulums: A at 0°, B at 180°"


def framed(request: GuidedTestRequest, *states: State, releases: bool = False) -> StateTable:
    """Return the table of a test: common beginning, own states, common ending.

    Args:
        request: the requested test.
        states: the test's own states.
        releases: whether the test releases the pendulums, so that they are locked again at the end.
    """
    beginning = (REST, LOCK, LOCKS_SEEN, COUNTERS) if request.rig.roles.angles is not None else (REST, LOCK)
    return StateTable((*beginning, *states), (FINISH, STOP, LOCK_AGAIN) if releases else (FINISH, STOP))


def log_begin(before_s: float, *, with_motion: bool) -> tuple[str, Callable[[RigCommands], object]]:
    """Return description and command of a state that may begin the log.

    Args:
        before_s: length of the pre-trigger, s. With one the log begins with the motion, otherwise before it.
        with_motion: whether the state is that of the motion.
    """
    begins = (before_s > 0) == with_motion
    return ("begin the log", lambda commands: commands.begin(before_s)) if begins else ("", no_commands)


def spin_up(request: GuidedTestRequest, rpm: float, free: bool = False) -> tuple[State, ...]:
    """Return the states that bring the rotor to a speed with the rig's own ramp, before the log begins.

    Args:
        request: the requested test.
        rpm: the speed.
        free: whether the pendulums are free meanwhile, as in a start-up from rest.
    """
    role = request.rig.roles.speed
    ramp, hold_s = (HAND_RAMP_RPM_S, 0.0) if role is None else (role.ramp_rpm_per_s, _HELD_S)

    def at_speed(view: StateView) -> StateObservation:
        off = max(abs(speed - rpm) for speed in speeds_of(view))
        if math.isnan(view.rpm):
            return StateObservation(False, f"spinning up to {rpm:.0f} rpm: the speed is not measured yet")
        since_ns = view.memory.get("at_speed_ns") or view.now_ns if off < speed_tolerance_rpm(rpm) else None
        held = since_ns is not None and view.now_ns >= since_ns + hold_s * 1e9
        return StateObservation(
            held and not view.measures.speed_doubt(),
            f"spinning up, {view.rpm:.0f} of {rpm:.0f} rpm",
            share_of(view.rpm, rpm),
            store={"at_speed_ns": since_ns},
        )

    ready = State(
        "make ready", does="make ready to turn the rotor", enter=RigCommands.make_ready, actor="rotor", usual_s=0.2
    )
    up = State(
        "spin up",
        does=f"ramp the rotor to {rpm:.0f} rpm",
        enter=lambda commands: commands.turn(rpm, ramp, free),
        actor="rotor",
        asks=f"turn the rotor to {rpm:.0f} rpm, by about {ramp:.0f} rpm per second, and hold this speed",
        waits_for=f"{rpm:.0f} rpm, to 1 % and 2 rpm",
        look=at_speed,
        rpm=rpm,
        usual_s=rpm / ramp + 1.0,
        limit_s=1.5 * rpm / ramp + (_SPIN_UP_S if role else _BY_HAND_S),
        missed=lambda view: (
            f"{rpm:.0f} rpm: {view.rpm:.0f} rpm after {view.in_state_s:.0f} s" + (speed_advice(view) if role else "")
        ),
        no_pause="the rotor passes through resonances",
    )
    return ready, up


def speed_tolerance_rpm(rpm: float) -> float:
    """Return the deviation from a requested speed that counts as reached, rpm."""
    share, more = SPEED_TOLERANCE
    return share * rpm + more


def speeds_of(view: StateView) -> tuple[float, ...]:
    """Return the measured speed and the drive's report, if it has one, rpm.

    Both must have reached a speed: on a ramp of a drive with a wrong setting, either of them passes it.
    """
    return (view.rpm,) if math.isnan(view.reported_rpm) else (view.rpm, abs(view.reported_rpm))


def speed_advice(view: StateView) -> str:
    """Return where to look if the drive has not brought the rotor to the speed, as the end of a sentence."""
    return f". {view.measures.speed_doubt() or view.measures.host_doubt() or 'Look at the drive'}"


def near_resonance(rig: Rig, rpm: float) -> str:
    """Return the reason why a test must not wait at a speed; empty if it may."""
    for natural in (w / RPM for w in rig.physics.natural_frequencies_rad_s):
        if abs(rpm / natural - 1) < _NEAR_RESONANCE:
            return (
                f"{rpm:.0f} rpm is within {100 * _NEAR_RESONANCE:.0f} % of the resonance expected at {natural:.0f} rpm"
            )
    return ""


def share_of(now: float, whole: float) -> float | None:
    """Return a completed share, 0 … 1, or None if `now` is not finite."""
    return min(1.0, max(0.0, now / whole)) if math.isfinite(now) else None


def _described(view: StateView) -> StateObservation:
    """Wait until the encoders' device has described itself, at most for a limited time."""
    late = view.in_state_s > 2 * _MAX_STATUS_S
    described = late or view.measures.angles_described()
    return StateObservation(view.in_state_s >= _LOCKED_LOOK_S and described, "checking the locks")


REST = State(
    "rest",
    does="bring the rotor to rest",
    enter=RigCommands.rest,
    actor="rotor",
    asks="stop the rotor",
    usual_s=0.5,
    no_pause="the rotor may turn",
)
LOCK = State("lock", does="lock both pendulums", enter=RigCommands.hold, actor="locks", asks=ASK_TO_LOCK, usual_s=1.0)
RELEASE_AT_REST = State(
    "release",
    does="release both pendulums with the rotor at rest",
    enter=lambda commands: commands.release(turning=False),
    actor="locks",
    asks="release both pendulums",
    usual_s=0.5,
)
LOCKS_SEEN = State(
    "locks seen",
    waits_for="the description of the encoders' device",
    look=_described,
    period_s=_LOCKED_LOOK_S,
    limit_s=4 * _MAX_STATUS_S,
    usual_s=0.4,
    late="counters",
)
COUNTERS = State("counters", does="check the counters at the closed locks", enter=RigCommands.check_counters)
_ENDING = "the test is ending"
FINISH = State("finish", does="end the log", enter=RigCommands.finish, no_pause=_ENDING)
STOP = State(
    "stop",
    does="bring the rotor to rest",
    enter=RigCommands.rest,
    actor="rotor",
    asks="stop the rotor",
    usual_s=2.0,
    no_pause=_ENDING,
)
LOCK_AGAIN = State(
    "lock again",
    does="lock the pendulums",
    enter=RigCommands.hold_again,
    actor="locks",
    asks=ASK_TO_LOCK,
    usual_s=1.0,
    no_pause=_ENDING,
)
