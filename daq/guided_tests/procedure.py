# pyright: strict
"""The guided tests of an open session, by name.

Every test ends with a finished log and the rotor at rest, or with the error that ended it and the rotor stopping.
"""

from __future__ import annotations

import math
from pathlib import Path

from daq.acquisition.session import Session
from daq.channels import LOCKS_CLOSED
from daq.guided_tests.controls import Controls
from daq.guided_tests.hands import Operator
from daq.guided_tests.kinds import Asked
from daq.guided_tests.orders import Orders, Progress
from daq.guided_tests.runner import NotReached, Runner, TestDone
from daq.guided_tests.test_inputs import asked
from rig_configs.schema import Rig

_LOCK_S = 10.0  # wall s
_ZEROED_S = 0.2  # rig time between a lock that closes and counters that are zeroed there


class Procedures:
    """See Orders for the arguments.

    Args:
        controls: through which the operator pauses, resumes, aborts and notes; one of its own where nobody does.

    Attributes:
        controls: see above.
        parameters: which identified parameters the speeds follow from; "" for the rig file's own. Kept in every log.
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
        self.controls = controls or Controls()
        self._rig = session.rig
        self._orders = Orders(session, operator, folder, progress, note)
        self._runner = Runner(self._orders, self.controls)

    @property
    def parameters(self) -> str:
        """See above."""
        return self._orders.parameters

    @parameters.setter
    def parameters(self, label: str) -> None:
        self._orders.parameters = label

    def run(self, test: str, rig: Rig | None = None, *, point: str = "", **numbers: float) -> TestDone:
        """One guided test by its name.

        Args:
            test: as `test_inputs.asked` takes it.
            rig: whose (identified) parameters its speeds follow from; None: the session's.
            point: name of a point.
            numbers: those that are not to be the kind's own.

        Raises:
            Refused: the rig cannot run it as asked for; nothing was turned.
            NotReached: it ended before a log began.
            RigError: an interlock or a device ended it.
        """
        return self.carry_out(asked(rig or self._rig, test, numbers, point))

    def carry_out(self, wanted: Asked) -> TestDone:
        """See `run`."""
        if wanted.kind.summed is None:
            return self._once(wanted, "")
        count, runs = int(wanted.numbers["count"]), list[TestDone]()
        for number in range(1, count + 1):
            try:
                runs.append(self._once(wanted, f"{number} of {count}"))
            except NotReached as early:
                if not runs:
                    raise
                return _whole(wanted, runs, str(early), early.aborted)
            if runs[-1].aborted:
                break
        return _whole(wanted, runs, runs[-1].missed if runs[-1].aborted else "", runs[-1].aborted)

    def _once(self, wanted: Asked, number: str) -> TestDone:
        numbers = {name: f"{value:.7g}" for name, value in wanted.numbers.items()}
        facts = numbers | ({"point": wanted.point} if wanted.point else {}) | ({"run": number} if number else {})
        return self._runner.run(wanted, wanted.kind.table(wanted), facts)

    def ring_down(self, axis: str) -> TestDone:
        """Pluck along an axis, record until it has rung down to a fiftieth."""
        return self.run(f"ring-down-{axis}")

    def spin_down(self) -> TestDone:
        """Release both pendulums at rest, flick them, record until they have slowed by e⁵."""
        return self.run("spin-down")

    def run_up(self, top_rpm: float, duration_s: float) -> TestDone:
        """Ramp from rest through both resonances with locked pendulums."""
        return self.run("run-up", top_rpm=top_rpm, duration_s=duration_s)

    def run_down(self, top_rpm: float, duration_s: float) -> TestDone:
        """Ramp from above both resonances to rest with locked pendulums."""
        return self.run("run-down", top_rpm=top_rpm, duration_s=duration_s)

    def point(self, name: str, speed_rad_s: float) -> TestDone:
        """Spin up with locked pendulums, wait until the orbit is steady, release, record until all is steady."""
        return self.run(f"point-{name}", speed_rpm=speed_rad_s * 30 / math.pi)


def _whole(wanted: Asked, runs: list[TestDone], missed: str, aborted: bool) -> TestDone:
    """A repeated test of its runs."""
    assert wanted.kind.summed is not None
    summary = dict(wanted.kind.summed([run.summary for run in runs]))
    warnings = tuple(f"{run.log.name}: {warning}" for run in runs for warning in run.warnings)
    return TestDone(wanted.test, runs[-1].log, summary, missed, warnings, aborted, tuple(runs))


def zero_counters(session: Session) -> None:
    """Close both locks and zero the node's counters there, where their zero belongs; the rotor must be at rest.

    Raises:
        DeviceError: refused, a lock does not close, or the rig has no locks that can be commanded.
    """
    session.command_node("lock both")

    def closed() -> bool:
        _, (flags,) = session.recent.last("pendulums", ("flags",), session.clock.now_ns() - 2_000_000_000)
        return len(flags) > 0 and flags[-1] & LOCKS_CLOSED == LOCKS_CLOSED

    session.wait_for(closed, _LOCK_S, "both locks to close")
    session.clock.sleep(_ZEROED_S)
    session.command_node("zero")
    session.clock.sleep(_ZEROED_S)
