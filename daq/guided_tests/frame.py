# pyright: strict
"""How every guided test begins and ends: the rotor at rest, the pendulums locked, the log finished."""

from __future__ import annotations

import math

from daq.guided_tests.hands import HAND_RAMP_RPM_S
from daq.guided_tests.kinds import Asked
from daq.guided_tests.orders import Orders
from daq.guided_tests.table import Look, State, Table, View
from rig_configs.schema import Rig

_STATUS_S = 2.5  # a device describes itself each second; one of these messages may be lost
_LOCKED_LOOK_S = 0.2  # how long closed locks are looked at before they are believed
_SPIN_UP_S = 60.0  # beside what the ramp takes, rig time
_BY_HAND_S = 240.0  # the same where a person turns the rotor, wall s
_NEAR_RESONANCE = 0.1  # of its speed: the orbit is several times as large there
_RPM = math.pi / 30
ASK_TO_LOCK = "the rotor at rest: lock both pendulums, A at 0° and B at 180°"


def framed(asked: Asked, *states: State, releases: bool = False) -> Table:
    """A test's own states between the beginning and the ending that all tests share.

    Args:
        releases: whether it lets the pendulums go, so that they are locked again at the end.
    """
    beginning = (REST, LOCK, LOCKS_SEEN, COUNTERS) if asked.rig.roles.angles is not None else (REST, LOCK)
    return Table((*beginning, *states), (FINISH, STOP, LOCK_AGAIN) if releases else (FINISH, STOP))


def spin_up(asked: Asked, rpm: float, free: bool = False) -> tuple[State, ...]:
    """Bring the rotor to a speed by the ramp it has for that, before the log begins.

    Args:
        free: whether the pendulums are free meanwhile, as a start-up from rest has them.
    """
    role = asked.rig.roles.speed
    ramp = HAND_RAMP_RPM_S if role is None else role.ramp_rpm_per_s

    def at_speed(view: View) -> Look:
        off = abs(view.rpm - rpm)
        if math.isnan(view.rpm):
            return Look(False, f"spinning up to {rpm:.0f} rpm: nothing shows the speed yet")
        return Look(off < 0.01 * rpm + 2, f"spinning up, {view.rpm:.0f} of {rpm:.0f} rpm", share_of(view.rpm, rpm))

    ready = State(
        "make ready", does="make ready to turn the rotor", enter=Orders.make_ready, actor="rotor", usual_s=0.2
    )
    up = State(
        "spin up",
        does=f"ramp the rotor to {rpm:.0f} rpm",
        enter=lambda orders: orders.turn(rpm, ramp, free),
        actor="rotor",
        asks=f"turn the rotor to {rpm:.0f} rpm, by about {ramp:.0f} rpm a second, and hold it there",
        waits_for=f"{rpm:.0f} rpm, to 1 % and 2 rpm",
        look=at_speed,
        rpm=rpm,
        usual_s=rpm / ramp + 1.0,
        limit_s=1.5 * rpm / ramp + (_SPIN_UP_S if role else _BY_HAND_S),
        wall=role is None,
        missed=lambda view: (
            f"{rpm:.0f} rpm: {view.rpm:.0f} rpm after {view.in_state_s:.0f} s"
            + ("" if role is None else ". Look at the drive")
        ),
        no_pause="the rotor passes through resonances",
    )
    return ready, up


def near_resonance(rig: Rig, rpm: float) -> str:
    """Why a test must not wait at a speed; empty when it may."""
    for natural in (w / _RPM for w in rig.physics.natural_frequencies_rad_s):
        if abs(rpm / natural - 1) < _NEAR_RESONANCE:
            return (
                f"{rpm:.0f} rpm is within {100 * _NEAR_RESONANCE:.0f} % of the resonance expected at {natural:.0f} rpm"
            )
    return ""


def share_of(now: float, whole: float) -> float | None:
    """A share for a progress bar; None where nothing is measured."""
    return min(1.0, max(0.0, now / whole)) if math.isfinite(now) else None


def _described(view: View) -> Look:
    """Whether the encoders' device has described itself; after a while its silence is no obstacle."""
    late = view.in_state_s > _STATUS_S + view.measures.patience_s(_STATUS_S)
    seen = late or view.measures.angles_described()
    return Look(view.in_state_s >= _LOCKED_LOOK_S and seen, "looking at the locks")


def _believe(orders: Orders) -> None:
    orders.believe_locked(0.5 * _LOCKED_LOOK_S)


REST = State(
    "rest",
    does="bring the rotor to rest",
    enter=Orders.rest,
    actor="rotor",
    asks="stop the rotor",
    usual_s=0.5,
    no_pause="the rotor may turn",
)
LOCK = State(
    "lock", does="hold both pendulums at their places", enter=Orders.hold, actor="locks", asks=ASK_TO_LOCK, usual_s=1.0
)
LOCKS_SEEN = State(
    "locks seen",
    waits_for="the encoders' device to describe itself",
    look=_described,
    period_s=_LOCKED_LOOK_S,
    limit_s=4 * _STATUS_S,
    wall=True,
    usual_s=0.4,
    late="counters",
)
COUNTERS = State("counters", does="hold the counters against the closed locks, refuse what cannot be", enter=_believe)
_ENDING = "the test is ending"
FINISH = State("finish", does="end the log", enter=Orders.finish, no_pause=_ENDING)
STOP = State(
    "stop",
    does="bring the rotor to rest",
    enter=Orders.rest,
    actor="rotor",
    asks="stop the rotor",
    usual_s=2.0,
    no_pause=_ENDING,
)
LOCK_AGAIN = State(
    "lock again",
    does="lock the pendulums",
    enter=Orders.hold_again,
    actor="locks",
    asks=ASK_TO_LOCK,
    usual_s=1.0,
    no_pause=_ENDING,
)
