"""The test's table leads forward, and what is no slow roll is refused."""

from rig_test_slow_roll import KIND

from daq.guided_tests.table import END, StateOutcome
from daq.guided_tests.test_inputs import refusal, requested_test
from rig_configs import load_rig

RIG = load_rig("virtual")


def test_the_log_is_ended_and_the_rotor_brought_to_rest_from_every_state() -> None:
    table = KIND.table(requested_test(RIG, "slow-roll"))
    for state in table.states:
        assert table.transitions[state.name, StateOutcome.ABORT] == "finish"
    assert table.transitions["roll", StateOutcome.DONE] == "finish"
    assert table.transitions["stop", StateOutcome.DONE] == END


def test_a_fast_roll_is_refused() -> None:
    assert refusal(RIG, "slow-roll") == ""
    assert "is no slow roll, expected at most 72 rpm" in refusal(RIG, "slow-roll", {"speed_rpm": 150.0})
