# pyright: strict
"""Run-up and run-down: a ramp through both resonances with locked pendulums."""

from __future__ import annotations

from daq.guided_tests import test_inputs
from daq.guided_tests.steps import Steps, TestDone

_SLOW_SHARE = 0.03  # of the top speed: below it a run-down has too few index marks to go on


def run_up(steps: Steps, top_rpm: float, duration_s: float) -> TestDone:
    """Ramp from rest to above both resonances."""
    test, rotor = "run-up", steps.rotor
    steps.refuse(test, test_inputs.ramp_refusal(steps.session.rig, top_rpm, duration_s))
    steps.at_rest_and_locked()
    steps.warn(test_inputs.ramp_warning(steps.session.rig, top_rpm))
    steps.warn(rotor.begin())
    steps.begin(test, {"top_rpm": f"{top_rpm:.0f}", "duration_s": f"{duration_s:g}"})
    steps.clock.sleep(0.5)
    rotor.go(top_rpm, top_rpm / duration_s)

    def there() -> bool:
        now = rotor.speed_rpm
        steps.tell(f"{test}: {now:.0f} rpm", now / top_rpm)
        return now > 0.985 * top_rpm

    reached = steps.look_until(there, 1.5 * duration_s)
    steps.clock.sleep(1.0)
    seen = f"{rotor.speed_rpm:.0f} of {top_rpm:.0f} rpm after {1.5 * duration_s:g} s"
    done = steps.end(test, {"reached_top": reached}, "" if reached else f"the top speed: {seen}")
    rotor.stop()
    return done


def run_down(steps: Steps, top_rpm: float, duration_s: float) -> TestDone:
    """Ramp from above both resonances to rest."""
    test, rotor = "run-down", steps.rotor
    steps.refuse(test, test_inputs.ramp_refusal(steps.session.rig, top_rpm, duration_s))
    steps.at_rest_and_locked()
    steps.warn(test_inputs.ramp_warning(steps.session.rig, top_rpm))
    steps.spin_up(test, top_rpm)
    steps.begin(test, {"top_rpm": f"{top_rpm:.0f}", "duration_s": f"{duration_s:g}"})
    steps.clock.sleep(1.0)
    rotor.go(0.0, top_rpm / duration_s)

    def slow() -> bool:
        now = rotor.speed_rpm
        steps.tell(f"{test}: {now:.0f} rpm", 1 - now / top_rpm)
        return now < _SLOW_SHARE * top_rpm

    reached = steps.look_until(slow, 1.5 * duration_s)
    seen = f"still {rotor.speed_rpm:.0f} rpm after {1.5 * duration_s:g} s"
    done = steps.end(test, {"reached_rest": reached}, "" if reached else f"the rotor to come to rest: {seen}")
    rotor.stop()
    return done
