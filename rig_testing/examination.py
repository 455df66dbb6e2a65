"""All tests of a driver in sequence."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
import unittest
from collections.abc import Callable, Generator
from dataclasses import dataclass
from types import FrameType

from daq.drivers.driver import Driver
from rig_testing import command_checks, decoding_checks, device_checks, measured_checks, mutations
from rig_testing.report import CaseOutcome, DriverReport, Failed, NotTried
from rig_testing.subject import Subject

CHECKS: dict[str, Callable[[Subject], str]] = {
    "settings": device_checks.check_settings,
    "roles": device_checks.check_roles,
    "opening dialogue": device_checks.check_opening,
    "silent device": device_checks.check_silence,
    "waits": device_checks.check_waits,
    "stream": device_checks.check_streaming,
    "displacement": measured_checks.check_displacement,
    "pendulum angles": measured_checks.check_angles,
    "rotor phase": measured_checks.check_phase,
    "speed": measured_checks.check_speed,
    "replay": decoding_checks.check_replay,
    "split": decoding_checks.check_split,
    "garbage": decoding_checks.check_garbage,
    "damage": decoding_checks.check_damage,
    "lost reads": decoding_checks.check_lost_reads,
    "end": decoding_checks.check_end,
    "restart": decoding_checks.check_restart,
    "counter wrap": decoding_checks.check_counter_wrap,
    "clock wrap": decoding_checks.check_clock_wrap,
    "memory": decoding_checks.check_memory,
    "mutations": mutations.check_mutations,
    "stop": device_checks.check_stop,
    "link lost": device_checks.check_link_lost,
    "speed source": command_checks.check_speed_source,
    "stops by itself": command_checks.check_stops_by_itself,
    "locks": command_checks.check_locks,
    "played": device_checks.check_played,
}
"""All tests by name; each returns what it measured, or raises Failed or NotTried."""

_LONGEST_S, _LONGEST_THOROUGH_S = 120.0, 7200.0


@dataclass(frozen=True)
class ContractCase:
    """One test of one driver.

    Attributes:
        name: of the test.
    """

    name: str
    _subject: Subject

    def __str__(self) -> str:
        return self.name

    def run(self) -> CaseOutcome:
        """Run it. Any exception of the driver is a failure."""
        began = time.perf_counter()
        passed, tried = True, True
        try:
            with _in_time(_LONGEST_THOROUGH_S if self._subject.thorough else _LONGEST_S):
                why = CHECKS[self.name](self._subject)
        except NotTried as reason:
            tried, why = False, str(reason)
        except Failed as failed:
            passed, why = False, str(failed)
        except Exception as error:
            passed, why = False, f"{type(error).__name__}: {error} ({_where(error)})"
        return CaseOutcome(self.name, passed, why, time.perf_counter() - began, tried)

    def __call__(self) -> None:
        """Run it as a test of pytest or unittest.

        Raises:
            Failed: an AssertionError with the reason.
            unittest.SkipTest: the test does not apply.
        """
        outcome = self.run()
        if not outcome.tried:
            raise unittest.SkipTest(outcome.why)
        if not outcome.passed:
            raise Failed(f"{self.name}: {outcome.why}")


def cases(
    driver: Driver,
    *,
    thorough: bool = False,
    processes: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> list[ContractCase]:
    """Return all tests of a driver, for any order; they share recordings that take long.

    Args:
        thorough: 10⁶ damaged inputs in place of 10⁴.
        processes: number of processes that decode damaged inputs. With several the main module must be importable, as
            always with `multiprocessing`.
        progress: called with the completed share, 0 … 1, of the damaged inputs.
    """
    subject = Subject(driver, thorough, processes, progress)
    return [ContractCase(name, subject) for name in CHECKS]


def examine(
    driver: Driver, *, thorough: bool = False, notify: Callable[[str], None] = lambda name: None
) -> DriverReport:
    """Run all tests on a driver.

    Args:
        thorough: 10⁶ damaged inputs in place of 10⁴; minutes.
        notify: called with the name of each test before it begins.

    Returns:
        One outcome per test. A test that the driver prevents by an exception is a failed one.
    """
    outcomes: list[CaseOutcome] = []
    for case in cases(driver, thorough=thorough):
        notify(case.name)
        outcomes.append(case.run())
    return DriverReport(driver.name, tuple(outcomes))


def _where(error: Exception) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"


@contextlib.contextmanager
def _in_time(seconds: float) -> Generator[None]:
    """End a test after a time limit, if the system can: in the main thread of a POSIX process."""
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise Failed(f"it hangs: not at its end after {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
