# pyright: strict
"""A point: spin up with locked pendulums, wait for a steady orbit, release, record until all is steady."""

from __future__ import annotations

import math

from daq.guided_tests import test_inputs
from daq.guided_tests.steps import Steps, TestDone
from daq.signals.settling import Settling

_RPM = math.pi / 30
_POINT_LIMIT_S = 90.0
_LOCKED_STEADY_S = 60.0  # rig time
# Stricter than the analysis, which asks the same again of the whole log: what is called steady here is so there.
_STEADY = {"angle_tolerance_rad": math.radians(0.05), "amplitude_tolerance_m": 2e-6}
_BEFORE_RELEASE_S = 4.0
_AFTER_STEADY_S = 2.5  # of steady state in the log; asked again after it with the analysis's own tolerances


def point(steps: Steps, name: str, speed_rad_s: float) -> TestDone:
    """See above."""
    test, rpm = f"point-{name}", speed_rad_s / _RPM
    steps.refuse(test, test_inputs.speed_refusal(steps.session.rig, rpm))
    step_rad = steps.angles.step_rad
    steps.at_rest_and_locked()
    steps.spin_up(test, rpm)

    def orbit_steady() -> bool:
        found = steps.look.locked_steady()
        steps.tell(f"{test}: waiting for a steady orbit, {found.why}", None)
        return found.settled

    steady = steps.look_until(orbit_steady, _LOCKED_STEADY_S)
    if not steady:
        steps.warn(f"the orbit was not steady {_LOCKED_STEADY_S:g} s after the spin-up, the release follows anyway")
    steps.begin(test, {"point": name, "speed_rpm": f"{rpm:.3f}"})
    steps.clock.sleep(_BEFORE_RELEASE_S)
    steps.tell(f"{test}: releasing the pendulums", None)
    released_ns = steps.locks.release(turning=True)
    last: Settling | None = None

    def all_steady() -> bool:
        nonlocal last
        since = (steps.clock.now_ns() - released_ns) * 1e-9
        if since < 3.0:
            return False
        last = steps.look.steady(released_ns, step_rad, _STEADY)
        steps.tell(f"{test}: {since:.0f} s after release, {last.why}", None)
        return last.settled

    limit_ns = released_ns + int(_POINT_LIMIT_S * 1e9)
    reached = False
    while not reached and steps.look_until(all_steady, (limit_ns - steps.clock.now_ns()) * 1e-9):
        steps.clock.sleep(_AFTER_STEADY_S)
        last = steps.look.steady(released_ns, step_rad, {})
        reached = last.settled
    why = last.why if last else "no data"
    found = reached or (_expects_slipping(steps, name) and last is not None and last.slipping)
    missed = "" if found else f"the steady state within {_POINT_LIMIT_S:g} s of the release: {why}"
    done = steps.end(test, {"steady_before_release": steady, "settled": reached, "why": why}, missed)
    steps.rotor.stop()
    steps.locks.lock()
    return done


def _expects_slipping(steps: Steps, name: str) -> bool:
    known = steps.session.rig.points.get(name)
    return known is not None and known.expected == "slipping"
