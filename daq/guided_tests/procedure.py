"""Guided tests of an open session.

Every test ends with a finished log and the rotor at rest, or with an error and a stop of the rotor.
"""

from __future__ import annotations

from pathlib import Path

from daq.acquisition.session import Session
from daq.guided_test_kinds import GuidedTestRequest
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.controls import Controls
from daq.guided_tests.hands import CommandedLocks, Operator, Progress
from daq.guided_tests.runner import NotReached, Runner, TestDone
from daq.guided_tests.test_inputs import requested_test
from rig_basics.units import TO_RPM
from rig_configs.schema import Rig

_ZEROED_S = 0.2  # wait before and after the counters are zeroed, s


class Procedures:
    """Runs guided tests; for the other arguments see daq.guided_tests.commands.RigCommands.

    Args:
        controls: passes the requests of the operator; a new object if None.

    Attributes:
        controls: see above.
    """

    def __init__(
        self,
        session: Session,
        operator: Operator,
        folder: Path,
        progress: Progress,
        note: str = "",
        controls: Controls | None = None,
    ) -> None:
        self.controls: Controls = controls or Controls()
        self._rig = session.rig
        self._runner = Runner(lambda wait: RigCommands(session, operator, folder, progress, note, wait), self.controls)

    def run(
        self, test: str, rig: Rig | None = None, *, point: str = "", parameters: str = "", **numbers: float
    ) -> TestDone:
        """Run one guided test.

        Args:
            test: name of the test, as in `test_inputs.requested_test`.
            rig: rig with the (identified) parameters from which the speeds follow; the session's rig if None.
            point: name of a point; empty without one.
            parameters: name of the identified parameters from which the speeds follow, for the log; empty for those of
                the rig file.
            numbers: numbers that replace the defaults, by name.

        Raises:
            GuidedTestRefused: the rig cannot run the requested test. The rotor was not turned.
            NotReached: the test ended before its log began.
            AcquisitionError: an interlock or a device ended the test.
        """
        return self.carry_out(requested_test(rig or self._rig, test, numbers, point), parameters)

    def carry_out(self, wanted: GuidedTestRequest, parameters: str = "") -> TestDone:
        """Run a requested test; see `run`."""
        if wanted.kind.combined is None:
            return self._once(wanted, "", parameters)
        count, runs = int(wanted.numbers["count"]), list[TestDone]()
        for number in range(1, count + 1):
            try:
                runs.append(self._once(wanted, f"{number} of {count}", parameters))
            except NotReached as early:
                if not runs:
                    raise
                return _whole(wanted, runs, str(early), early.aborted)
            if runs[-1].aborted:
                break
        return _whole(wanted, runs, runs[-1].missed if runs[-1].aborted else "", runs[-1].aborted)

    def _once(self, wanted: GuidedTestRequest, number: str, parameters: str) -> TestDone:
        numbers = {name: f"{value:.7g}" for name, value in wanted.numbers.items()}
        optional = {"parameters": parameters, "point": wanted.point, "run": number}
        facts = numbers | {name: text for name, text in optional.items() if text}
        return self._runner.run(wanted, wanted.kind.table(wanted), facts)

    def ring_down(self, axis: str) -> TestDone:
        """Run a ring-down: pluck along an axis, record until the amplitude has decayed to 1/50."""
        return self.run(f"ring-down-{axis}")

    def spin_down(self) -> TestDone:
        """Run a spin-down: release both pendulums at rest, flick them, record until they have slowed by e⁵."""
        return self.run("spin-down")

    def run_up(self, top_rpm: float, duration_s: float) -> TestDone:
        """Run a run-up: ramp from rest through both resonances with locked pendulums."""
        return self.run("run-up", top_rpm=top_rpm, duration_s=duration_s)

    def run_down(self, top_rpm: float, duration_s: float) -> TestDone:
        """Run a run-down: ramp from above both resonances to rest with locked pendulums."""
        return self.run("run-down", top_rpm=top_rpm, duration_s=duration_s)

    def point(self, name: str, speed_rad_s: float) -> TestDone:
        """Run a point: spin up with locked pendulums, wait for a steady orbit, release, record to the steady state."""
        return self.run(f"point-{name}", speed_rpm=speed_rad_s * TO_RPM)


def _whole(wanted: GuidedTestRequest, runs: list[TestDone], missed: str, aborted: bool) -> TestDone:
    """Combine the runs of a repeated test."""
    assert wanted.kind.combined is not None
    summary = dict(wanted.kind.combined([run.summary for run in runs]))
    warnings = tuple(f"{run.log.name}: {warning}" for run in runs for warning in run.warnings)
    return TestDone(wanted.test, runs[-1].log, summary, missed, warnings, aborted, tuple(runs))


def zero_counters(session: Session) -> None:
    """Close both locks and zero the node's counters at this position. The rotor must be at rest.

    Raises:
        DeviceError: a command was refused, a lock does not close, or the rig has no locks that can be commanded.
    """
    CommandedLocks(session, session.wait_for).lock()
    session.clock.wait(_ZEROED_S)
    session.rotor.command_locks("zero")
    session.clock.wait(_ZEROED_S)
