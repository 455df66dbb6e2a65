"""The host's command of a controller that has no ramp of its own: the ramp, and the repeated command.

The controller executes the last command until its own timeout. The host therefore repeats its command from one thread,
each time further along the ramp; `RepeatedCommand.mode` is the kind of command. If the host ends, the commands end, and
the controller stops driving the rotor by itself, according to its set-up.
"""

from __future__ import annotations

import math
import threading
from abc import abstractmethod
from collections.abc import Callable
from enum import Enum

from typing_extensions import override

from daq.drivers.contract import RotorGuard
from daq.drivers.host_command import UNCONFIRMED, HostCommand, Steps
from daq.drivers.motors import RepeatedSettings
from daq.drivers.ramp import SetpointRamp
from daq.transports.host_clock import HostClock

RESTARTED = "RESTARTED"
"""State of a controller that started again while it drove the rotor."""
_MIN_BEAT_S = 0.002  # s, shortest period of the thread
_MAX_STEP_S = 0.25  # s, longest step of the ramp


class Mode(Enum):
    """The command that the host repeats."""

    NOTHING = "none: the controller gets no command"
    SPEED = "the ramp's set-point"
    BRAKE = "brake"
    FREE = "release"


class RepeatedCommand(HostCommand):
    """See HostCommand. Subclasses encode the commands and read the reports.

    `beat` sends everything that is due; a thread calls it. The lock `_sending` is held from the decision to the end of
    sending, so that an older command never follows a newer one.

    Args:
        settings: table of the controller in the rig file.
        send, clock, guard: see HostCommand.
        min_rpm: least speed that the controller holds, rpm.
        beat_s: longest period of the thread, s.

    Attributes:
        mode: command that is being repeated.
        faults: fault codes reported since the last `enable`.
    """

    def __init__(
        self,
        settings: RepeatedSettings,
        send: Callable[[bytes], None],
        clock: HostClock,
        guard: RotorGuard | None,
        *,
        min_rpm: float = 0.0,
        beat_s: float = math.inf,
    ) -> None:
        super().__init__(settings, send, clock, guard)
        self._command_ms = settings.command_ms
        self._beat_s = min(settings.command_ms * 1e-3, beat_s)
        self._ramp = SetpointRamp(settings.ramp_rpm_per_s, min_rpm, _MAX_STEP_S)
        self._sending = threading.Lock()
        self.mode: Mode = Mode.NOTHING
        self._ordered_ns = 0  # time at which the newest mode was first sent
        self._command_due_ns = 0
        self.faults: list[int] = []

    # --- what a subclass defines ----------------------------------------------------------------------------------

    @abstractmethod
    def _speed_command(self, rpm: float) -> bytes:
        """Encode the command of the present mode, with the ramp's set-point, rpm. The caller holds both locks."""

    @abstractmethod
    def _is_ready(self) -> bool:
        """Return whether the newest report shows no obstacle to a command."""

    @abstractmethod
    def _obeys(self) -> bool:
        """Return whether a report that followed the command shows that it is obeyed. The caller holds `_deciding`."""

    @abstractmethod
    def _disobeys(self) -> str:
        """Return a clause about a controller that answers and does not obey."""

    @abstractmethod
    def _send_release(self) -> Callable[[], bool]:
        """Send the command to release the rotor; return a function that returns whether it was confirmed since."""

    def _words(self, code: int) -> str:
        """Return the meaning of a fault code."""
        return f"{code:#x}"

    def _question(self, now_ns: int) -> bytes:
        """Encode the question that is due. The caller holds both locks."""
        return b""

    # --- commands ----------------------------------------------------------------------------------------------

    @override
    def why(self) -> str:
        return "".join(f"; fault {self._words(code)}" for code in self.faults)

    @override
    def start(self) -> None:
        """Start the thread; the motor receives no command yet."""
        self._cease("command")
        self.beat()
        self._repeat(max(_MIN_BEAT_S, self._beat_s), self.beat, "command")

    @override
    def beat(self) -> None:
        with self._sending:
            now_ns = self._clock.now_ns()
            data = b""
            with self._deciding:
                if now_ns >= self._command_due_ns:
                    data += self._command(now_ns)
                data += self._question(now_ns)
            if data:
                self._send(data)

    def _command(self, now_ns: int) -> bytes:
        """Return the mode's command and schedule the next one; the caller holds both locks."""
        self._command_due_ns = now_ns + self._command_ms * 1_000_000
        if self.mode is Mode.NOTHING:
            return b""
        self._ordered = True
        self._ordered_ns = self._ordered_ns or now_ns
        return self._speed_command(self._ramp.at(now_ns * 1e-9) if self.mode is Mode.SPEED else 0.0)

    def _begin(self, mode: Mode) -> None:
        """Set a new mode, which is sent at the next beat; the caller holds the lock `_deciding`."""
        self.mode, self._command_due_ns, self._ordered_ns = mode, 0, 0

    @override
    def _brake(self) -> None:
        if self.mode is not Mode.BRAKE:
            self._begin(Mode.BRAKE)
        self._command_due_ns = 0

    @override
    def _set_ramp(self, rpm_per_s: float) -> None:
        with self._deciding:
            self._ramp.rpm_per_s = rpm_per_s

    @override
    def _enabling(self) -> Steps:
        """Hold speed 0; a turning rotor is slowed down along the ramp."""
        self.faults = []
        while not self._is_ready() or math.isnan(self.actual_rpm):
            self.beat()
            yield self._fails()
        with self._deciding:
            self._check_not_stopped()
            self._ramp.begin(self._reported_rpm, self._clock.now_ns() * 1e-9)
            self._begin(Mode.SPEED)
        try:
            while not self._holds():
                self.beat()
                yield self._fails()
        except BaseException:
            with self._deciding:
                self._brake()
            raise

    def _holds(self) -> bool:
        with self._deciding:
            return self._ordered_ns > 0 and self._obeys()

    def _fails(self) -> str:
        if not self._is_recent(self._report_ns):
            return "it does not answer. Look at its power and its line"
        return self._disobeys()

    @override
    def set_speed(self, rpm: float) -> None:
        self._guarded.permit(rpm)
        with self._deciding:
            self._check_armed(rpm)
            self._ramp.target_rpm = rpm
            self._command_due_ns = 0
        self.beat()

    @override
    def disable(self) -> None:
        with self._deciding:
            self._armed = False
            self._begin(Mode.FREE)
        self.beat()
        super().disable()

    @override
    def _switch_off(self) -> str:
        return "" if self._confirm(self._send_release) else UNCONFIRMED

    @override
    def _finish(self) -> str:
        self._end()
        return self._switch_off() if self._ordered else ""

    @override
    def _end(self) -> None:
        super()._end()
        with self._deciding:
            self.mode = Mode.NOTHING
