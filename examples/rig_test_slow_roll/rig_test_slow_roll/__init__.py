"""Slow roll: turn far below the first resonance with locked pendulums, record some revolutions, give the runout.

At such a speed the column hardly bends, so what the sensors see is the runout of the surface they look at.
"""

from daq.guided_test_kinds import CHANNELS, GuidedTestRequest, Number, TestKind
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.frame import framed, near_resonance, share_of, spin_up
from daq.guided_tests.table import State, StateObservation, StateTable, StateView
from daq.guided_tests.test_inputs import speed_refusal

_HIGHEST = 0.4  # of the first natural frequency: above it the orbit is more than a fifth larger than at rest
_RPM = 30 / 3.141592653589793


def table(asked: GuidedTestRequest) -> StateTable:
    """The states between the beginning and the ending that all tests share."""
    rpm, turns = asked.numbers["speed_rpm"], asked.numbers["turns"]
    turn_s = 60.0 / rpm

    def turned(view: StateView) -> StateObservation:
        done = view.measures.revolutions_since(view.entered_ns)
        runout = {f"runout_{axis}_mm": 1e3 * view.measures.peak_to_peak(CHANNELS[axis], 1.1 * turn_s) for axis in "xy"}
        return StateObservation(
            done >= turns, f"{done:.0f} of {turns:.0f} revolutions", share_of(done, turns), facts=runout
        )

    return framed(
        asked,
        *spin_up(asked, rpm),
        State(
            "roll",
            does="begin the log",
            enter=RigCommands.begin,
            waits_for=f"{turns:.0f} revolutions",
            look=turned,
            rpm=rpm,
            usual_s=turns * turn_s,
            limit_s=2 * turns * turn_s + 5.0,
            missed=lambda view: f"{turns:.0f} revolutions: {view.measures.revolutions_since(view.entered_ns):.0f} came",
            no_pause=near_resonance(asked.rig, rpm),
        ),
    )


def refusal(asked: GuidedTestRequest) -> str:
    """Why it is not run at a speed."""
    highest = _HIGHEST * min(asked.rig.physics.natural_frequencies_rad_s) * _RPM
    rpm = asked.numbers["speed_rpm"]
    if rpm > highest:
        return f"{rpm:.0f} rpm is no slow roll, expected at most {highest:.0f} rpm: nothing was turned"
    return speed_refusal(asked.rig, rpm)


KIND = TestKind(
    "slow-roll",
    "turn slowly with locked pendulums, record the runout",
    ("x", "y", "phase"),
    turns=True,
    table=table,
    refusal=refusal,
    numbers={"speed_rpm": Number("speed, rpm", 40.0), "turns": Number("revolutions", 10, 3, 1000, whole=True)},
)

__all__ = ["KIND"]
