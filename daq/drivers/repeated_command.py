"""The host's command of a controller that has no ramp of its own: the ramp, the repeated command, and the stop.

The controller executes the last command until its own timeout. The host therefore repeats its command from one thread,
each time further along the ramp; `RepeatedCommand.mode` is the kind of command. If the host ends, the commands end, and
the controller stops driving the rotor by itself, according to its set-up.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from typing import Protocol

from daq.drivers.contract import Pipeline, RotorGuard
from daq.drivers.ramp import SetpointRamp
from daq.drivers.run_down import wait_for_rest
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock, Repeated

UNKNOWN, RESTARTED = "UNKNOWN", "RESTARTED"
"""States of every controller: no recent report; it started again while it drove the rotor."""
UNCONFIRMED = (
    "it does not answer: the release is not confirmed. Without commands it does what is set for its own timeout. "
    "Look at its power and its line before anyone touches the rotor"
)
MAX_REPORT_AGE_S = 0.5
"""Wall s after which a report is too old."""
ANSWER_S = 0.1
"""Wall s to wait for an answer before the question is sent again."""
_ENABLE_S = 3.0  # s for the controller to obey
_RELEASE_S = 0.5  # s for the controller to confirm the command to release the rotor
_MIN_BEAT_S = 0.002  # s, shortest period of the thread
_MAX_STEP_S = 0.25  # s, longest step of the ramp


class Mode(Enum):
    """The command that the host repeats."""

    NOTHING = "none: the controller gets no command"
    SPEED = "the ramp's set-point"
    BRAKE = "brake"
    FREE = "release"


class CommandSettings(Protocol):
    """Settings of a controller that this command uses.

    Attributes:
        command_ms: period of the command, ms.
        ramp_rpm_per_s: rate of the ramp, rpm/s.
        rest_rpm: largest reading of a standing rotor, rpm.
    """

    @property
    def command_ms(self) -> int:
        """See above."""
        ...

    @property
    def ramp_rpm_per_s(self) -> float:
        """See above."""
        ...

    @property
    def rest_rpm(self) -> float:
        """See above."""
        ...


class RepeatedCommand(ABC):
    """See SpeedSource. Subclasses encode the commands and read the reports.

    `beat` sends everything that is due; a thread calls it. The lock `_deciding` protects the state and is held only
    while the state is read or changed. The lock `_sending` is held from the decision to the end of sending, so that an
    older command never follows a newer one.

    Args:
        settings: table of the controller in the rig file.
        send: writes bytes to the controller's link (and to the log).
        clock: clock for the ramp, the timeouts and the age of reports.
        guard: conditions for turning the rotor; without it only the controller's own reports are used.
        min_rpm: least speed that the controller holds, rpm.
        beat_s: longest period of the thread, s.

    Attributes:
        mode: command that is being repeated.
        faults: fault codes reported since the last `enable`.
    """

    def __init__(
        self,
        settings: CommandSettings,
        send: Callable[[bytes], None],
        clock: HostClock,
        guard: RotorGuard | None,
        *,
        min_rpm: float = 0.0,
        beat_s: float = math.inf,
    ) -> None:
        self._command_ms, self._min_rpm = settings.command_ms, min_rpm
        self._send, self._clock = send, clock
        self._beat_s = min(settings.command_ms * 1e-3, beat_s)
        self._guarded = guard or RotorGuard(
            permit=lambda rpm: None,
            at_rest=lambda: None if math.isnan(self.actual_rpm) else abs(self.actual_rpm) <= settings.rest_rpm,
            speed_rpm=lambda: abs(self.actual_rpm),
        )
        self._ramp = SetpointRamp(settings.ramp_rpm_per_s, min_rpm, _MAX_STEP_S)
        self._deciding, self._sending = threading.Lock(), threading.Lock()
        self._repeated: Repeated | None = None
        self.mode: Mode = Mode.NOTHING
        self._armed = self._ordered = False
        self._stops = 0  # number of stop commands: an `enable` that began before the last one fails
        self._reported_rpm = math.nan
        self._report_ns = 0  # time of the newest report of the speed; 0 before the first
        self._ordered_ns = 0  # time at which the newest mode was first sent
        self._command_due_ns = 0
        self.dropped_out: str | None = None
        self.was_reset = ""
        self.faults: list[int] = []

    # --- what a subclass defines ----------------------------------------------------------------------------------

    @abstractmethod
    def notice(self, pipeline: Pipeline) -> None:
        """See SpeedSource."""

    @property
    @abstractmethod
    def state(self) -> str:
        """See SpeedSource."""

    @abstractmethod
    def fault_code(self) -> int | None:
        """See SpeedSource."""

    @abstractmethod
    def _order(self, rpm: float) -> bytes:
        """Encode the command of the present mode, with the ramp's set-point, rpm. The caller holds both locks."""

    @abstractmethod
    def _is_ready(self) -> bool:
        """Return whether the newest report shows no obstacle to a command."""

    @abstractmethod
    def _obeys(self) -> bool:
        """Return whether a report that followed the command shows that it is obeyed. The caller holds `_deciding`."""

    @abstractmethod
    def _disobeys(self) -> str:
        """Return the text of the error for a controller that answers and does not obey."""

    @abstractmethod
    def _send_release(self) -> Callable[[], bool]:
        """Send the command to release the rotor; return a function that returns whether it was confirmed since."""

    def _words(self, code: int) -> str:
        """Return the meaning of a fault code."""
        return f"{code:#x}"

    def _question(self, now_ns: int) -> bytes:
        """Encode the question that is due. The caller holds both locks."""
        return b""

    # --- reports ----------------------------------------------------------------------------------------------

    def _fall(self, state: str) -> None:
        """Take that the controller has stopped obeying by itself; as soon as it obeys again it must stop.

        The caller holds `_deciding`.
        """
        self.dropped_out = self.dropped_out or state
        self._armed, self.mode = False, Mode.BRAKE

    def _is_recent(self, time_ns: int) -> bool:
        """Return whether a report of that time is recent enough to be used."""
        return bool(time_ns) and self._clock.now_ns() - time_ns <= MAX_REPORT_AGE_S * 1e9

    @property
    def actual_rpm(self) -> float:
        """See SpeedSource."""
        return self._reported_rpm if self._is_recent(self._report_ns) else math.nan

    @property
    def enabled(self) -> bool:
        """Whether speeds are commanded and the controller reports no obstacle."""
        return self._armed and self._is_recent(self._report_ns)

    def why(self) -> str:
        """See SpeedSource."""
        return "".join(f"; fault {self._words(code)}" for code in self.faults)

    # --- commands ----------------------------------------------------------------------------------------------

    def start(self) -> None:
        """See SpeedSource: start the thread; the motor receives no command yet."""
        if self._repeated is not None:  # from a line that was lost, or from an earlier start
            self._repeated.stop()
        self.beat()
        # a lost link is reported by its reader; a controller without commands stops by its own timeout
        self._repeated = self._clock.every(max(_MIN_BEAT_S, self._beat_s), self.beat, "command", lambda error: None)

    def beat(self) -> None:
        """Send the command and the question if they are due.

        Raises:
            LinkLost: the connection to the device is lost.
        """
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
        return self._order(self._ramp.at(now_ns * 1e-9) if self.mode is Mode.SPEED else 0.0)

    def _begin(self, mode: Mode) -> None:
        """Set a new mode, which is sent at the next beat; the caller holds the lock `_deciding`."""
        self.mode, self._command_due_ns, self._ordered_ns = mode, 0, 0

    def set_ramp(self, rpm_per_s: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the rate is not a positive finite number.
        """
        if not 0 < rpm_per_s < math.inf:
            raise DeviceError(f"drive: expected a ramp above 0 rpm/s, got {rpm_per_s:g}")
        with self._deciding:
            self._ramp.rpm_per_s = rpm_per_s

    def enable(self) -> None:
        """Hold speed 0; a turning rotor is slowed down along the ramp.

        Raises:
            DeviceError: the controller has a fault or does not obey.
            AcquisitionError: raised by `permit`.
        """
        deadline = self._clock.wall_s() + _ENABLE_S
        with self._deciding:
            stops, self._armed, self.dropped_out, self.faults = self._stops, False, None, []
        begun = False
        try:
            while True:
                self._guarded.permit(None)
                if begun and self._arm(stops):
                    return
                if not begun and self._is_ready() and not math.isnan(self.actual_rpm):
                    begun = self._hold(stops)
                self.beat()
                if self._clock.wall_s() > deadline:
                    raise DeviceError(self._fails())
                self._clock.wait(0.005)
        except BaseException:
            with self._deciding:
                if begun and not self._armed:
                    self._begin(Mode.BRAKE)
            raise

    def _fails(self) -> str:
        if not self._is_recent(self._report_ns):
            return "drive: it does not answer. Look at its power and its line"
        return self._disobeys()

    def _hold(self, stops: int) -> bool:
        with self._deciding:
            self._check_not_stopped(stops)
            self._ramp.begin(self._reported_rpm, self._clock.now_s())
            self._begin(Mode.SPEED)
        return True

    def _arm(self, stops: int) -> bool:
        with self._deciding:
            self._check_not_stopped(stops)
            self._armed = self._ordered_ns > 0 and self._obeys()
            return self._armed

    def _check_not_stopped(self, stops: int) -> None:
        if stops != self._stops:
            raise DeviceError("drive: a stop was commanded while it was being enabled")

    def set_speed(self, rpm: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the controller is not enabled.
            AcquisitionError: raised by `permit`.
        """
        self._guarded.permit(rpm)
        with self._deciding:
            if not self._armed:
                raise DeviceError(f"drive: {rpm:g} rpm wanted, it is not enabled ({self.state}{self.why()})")
            self._ramp.target_rpm = rpm
            self._command_due_ns = 0
        self.beat()

    def disable(self) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the controller does not answer, so the release is not confirmed.
        """
        with self._deciding:
            self._armed = False
            self._begin(Mode.FREE)
        self.beat()
        if not self._release():
            raise DeviceError(f"drive: commanded to release the rotor, {UNCONFIRMED}")

    def _release(self) -> bool:
        """Send the command to release the rotor until it is confirmed; return whether it was."""
        deadline = self._clock.wall_s() + _RELEASE_S
        while True:
            confirmed = self._send_release()
            again = self._clock.wall_s() + ANSWER_S
            while not confirmed() and self._clock.wall_s() < again:
                self._clock.wait(0.002)
            if confirmed():
                return True
            if self._clock.wall_s() > deadline:
                return False

    def quick_stop(self) -> None:
        """Brake immediately and continue to brake."""
        with self._deciding:
            self._armed = False
            self._stops += 1
            self._begin(Mode.BRAKE)
        self.beat()

    def stop(self, notify: Callable[[str], None] = lambda text: None) -> bool:
        """Brake until the rotor stands, then release it.

        The rotor is not released if it is not confirmed to stand: the commands end with a brake, and the controller's
        own timeout follows.

        Args:
            notify: called with a text about what is being waited for.

        Returns:
            Whether rest and release are confirmed.
        """
        rest = self._repeated is None and not self._ordered
        try:
            rest = rest or self._rest(notify)
        finally:
            self._end()
        if rest and self._ordered and not self._release():
            notify(f"the drive was commanded to release the rotor, {UNCONFIRMED}")
            return False
        return rest

    def _end(self) -> None:
        """End commands and questions."""
        if self._repeated is not None:
            self._repeated.stop()
            self._repeated = None
        with self._deciding:
            self._armed, self.mode = False, Mode.NOTHING

    def _rest(self, notify: Callable[[str], None]) -> bool:
        """Brake and wait until the rotor stands; see `wait_for_rest`."""
        if not self._ordered and (not self._report_ns or self._guarded.at_rest()):
            return True  # no command was sent, and the rotor is not known to turn
        self.quick_stop()
        return wait_for_rest(self._clock, self._guarded, self.beat, notify)
