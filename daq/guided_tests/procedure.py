# pyright: strict
"""The guided tests of an open session, by name.

Every test ends with a finished log and the rotor at rest, or with the error that ended it and the rotor stopping.
"""

from __future__ import annotations

from pathlib import Path

from daq.acquisition.session import Session
from daq.channels import LOCKS_CLOSED
from daq.guided_tests import point, ramps, ring_down, spin_down
from daq.guided_tests.hands import Operator
from daq.guided_tests.steps import Progress, Steps, TestDone

_LOCK_S = 10.0  # wall s
_ZEROED_S = 0.2  # rig time between a lock that closes and counters that are zeroed there


class Procedures:
    """See Steps for the arguments.

    Attributes:
        parameters: which identified parameters the speeds follow from; "" for the rig file's own. Kept in every log.
    """

    def __init__(self, session: Session, operator: Operator, folder: Path, progress: Progress, note: str = "") -> None:
        self._steps = Steps(session, operator, folder, progress, note)

    @property
    def parameters(self) -> str:
        """See above."""
        return self._steps.parameters

    @parameters.setter
    def parameters(self, label: str) -> None:
        self._steps.parameters = label

    def ring_down(self, axis: str) -> TestDone:
        """Pluck along an axis, record until it has rung down to a fiftieth."""
        return ring_down.ring_down(self._steps, axis)

    def spin_down(self) -> TestDone:
        """Release both pendulums at rest, flick them, record until they have slowed by e⁵."""
        return spin_down.spin_down(self._steps)

    def run_up(self, top_rpm: float, duration_s: float) -> TestDone:
        """Ramp from rest through both resonances with locked pendulums."""
        return ramps.run_up(self._steps, top_rpm, duration_s)

    def run_down(self, top_rpm: float, duration_s: float) -> TestDone:
        """Ramp from above both resonances to rest with locked pendulums."""
        return ramps.run_down(self._steps, top_rpm, duration_s)

    def point(self, name: str, speed_rad_s: float) -> TestDone:
        """Spin up with locked pendulums, wait until the orbit is steady, release, record until all is steady."""
        return point.point(self._steps, name, speed_rad_s)


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
