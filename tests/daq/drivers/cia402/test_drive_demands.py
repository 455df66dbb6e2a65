"""What a drive must take and state: settings, targets, the network's start, its unit and its reaction."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import NMT_START
from daq.drivers.checks import Checks
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.status_checks import drive_checks
from daq.errors import DeviceError
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, encode
from daq.transports.host_clock import Repeated
from tests.daq.drivers.cia402.test_drive_setup import CONFIG, NODE, MappedDrive


def test_a_target_that_did_not_reach_the_drive_is_sent_again() -> None:
    drive = MappedDrive({})
    drive.host.start()
    drive.host.enable()
    for rpm in (100, 0):
        drive.lost_orders = 2
        drive.host.set_speed(rpm)
        assert drive.value(cia402.TARGET_VELOCITY, 0) == rpm
    drive.host.stop()


def test_a_target_that_the_drive_limits_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    drive = MappedDrive({})
    drive.host.start()
    drive.host.enable()
    drive.lost_orders = 100
    drive.host.set_speed(100)
    assert drive.lost_orders == 97
    assert "100 rpm were commanded, its target (6042h) is 0 rpm. Look at its limits" in caplog.text
    drive.lost_orders = 0
    drive.host.stop()


def test_no_target_is_sent_again_after_a_stop() -> None:
    drive = MappedDrive({})
    drive.host.start()
    drive.host.enable()
    stop = threading.Thread(target=drive.host.quick_stop)

    def another_thread_stops(index: int) -> None:
        drive.at_read = lambda index: None
        stop.start()
        time.sleep(0.05)

    drive.lost_orders, drive.at_read = 1, another_thread_stops
    drive.host.set_speed(100)
    stop.join()
    assert drive.orders[-1] == cia402.QUICK_STOP
    drive.host.stop()


def test_a_start_of_the_network_that_was_lost_is_sent_again() -> None:
    drive = MappedDrive({})
    drive.lost_starts = 2
    drive.host.start()
    end = time.monotonic() + 3.0
    while not drive.started and time.monotonic() < end:
        drive.shows(cia301.Heartbeat.PRE_OPERATIONAL)
        time.sleep(0.02)
    assert drive.network_orders == [NMT_START]
    drive.host.stop()


@pytest.mark.parametrize(
    ("period", "identifier", "requested"),
    [(None, 0x185, True), (None, 0x4000_0185, False), (20, 0x185, False), (0, 0x185, False)],
)
def test_a_drive_without_a_period_is_asked_for_its_reports(
    period: int | None, identifier: int, requested: bool
) -> None:
    """It may report changes only. Bit 30 of its COB-ID means that it does not answer remote frames."""
    drive = MappedDrive({(cia301.TPDO1, 1): identifier, (cia301.TPDO1, 5): period or 0})
    if period is None:
        del drive.objects[cia301.TPDO1, 5]
    drive.host.start()
    time.sleep(0.3)
    drive.host.stop()
    asked = list(drive.requests)
    assert (len(asked) > 2) is requested
    assert set(asked) <= {(0x185, 4)}
    time.sleep(0.1)
    assert drive.requests == asked  # none after the end


@pytest.mark.parametrize(
    ("index", "words"),
    [
        (cia301.CONSUMER_HEARTBEAT, r"watch the heartbeat of node 1 for 500 ms: .* \(heartbeat_timeout_ms\)"),
        (cia301.PRODUCER_HEARTBEAT, r"send a heartbeat each 100 ms.*\(heartbeat_ms\)"),
        (
            cia402.MODE_OF_OPERATION,
            'does not take mode = "velocity" of the rig file. By 6502h it has "profile velocity"',
        ),
    ],
)
def test_a_drive_that_refuses_a_setting_is_refused_with_what_to_do(index: int, words: str) -> None:
    drive = MappedDrive({})
    drive.objects[cia402.SUPPORTED_MODES, 0] = (0x1E5, "<I")
    drive.refused = {index}
    with pytest.raises(DeviceError, match=words):
        drive.host.start()
    drive.host.stop()


def test_a_missing_answer_is_not_called_a_wrong_mapping() -> None:
    drive = MappedDrive({})
    drive.silent_at = (cia301.RPDO1_MAPPING, 0)
    with pytest.raises(DeviceError, match="no answer to reading 1600h") as error:
        drive.host.start()
    assert "maker's tool" not in str(error.value)
    drive.host.stop()


class _QuickClock(HostClock):
    """Time that passes ten times as fast."""

    def now_ns(self) -> int:
        return 10 * super().now_ns()

    def wait(self, seconds: float) -> None:
        super().wait(seconds / 10.0)

    def every(
        self, seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        return super().every(seconds / 10.0, do, name, failed)


def test_a_drive_may_need_seconds_to_be_enabled() -> None:
    """It looks for the position of its motor, or charges its link."""
    drive, clock = MappedDrive({}), _QuickClock()
    begun_s = clock.now_s()

    def hear_slowly(data: bytes) -> None:
        enabling = encode(CanFrame(cia301.cob_rpdo(1, NODE), cia402.VELOCITY.pack(0x0F, 0)))
        if data == enabling and clock.now_s() < begun_s + 6.0:
            drive.reports()
        else:
            drive.hear(data)

    drive.host = DriveControl(CONFIG, hear_slowly, clock)
    drive.host.start()
    drive.host.enable()
    assert drive.host.state == cia402.OPERATION_ENABLED
    assert clock.now_s() > begun_s + 6.0
    drive.host.stop()


def checks_of(objects: dict[tuple[int, int], tuple[int, str]], settings: MotorDrive = CONFIG) -> Checks:
    """Checks of a drive after its time-out was measured; it only sends the emergency."""
    drive = MappedDrive({}, settings=settings)
    drive.objects.update(objects)
    drive.host.start()

    def speak() -> None:
        drive.reports()
        if drive.beat_s < time.monotonic() - 0.3:
            emergency = cia301.Emergency(cia301.HEARTBEAT_ERROR, 0x11, bytes(5))
            drive.answer(cia301.cob_emergency(NODE), cia301.pack_emergency(emergency))

    speak()
    repeated = HostClock().every(0.01, speak, "reports", lambda error: None)
    try:
        assert drive.host.measure_time_out().measured_s is not None
        return drive_checks(drive.host, [])
    finally:
        drive.host.stop()
        repeated.stop()


@pytest.mark.parametrize(("reaction", "passed"), [(0, False), (1, True), (3, True), (None, True)])
def test_a_drive_that_would_go_on_without_its_host_fails_the_check(reaction: int | None, passed: bool) -> None:
    checks = checks_of({} if reaction is None else {(cia402.ABORT_REACTION, 0): (reaction, "<h")})
    assert all(check.passed for check in checks.values()) is passed
    if not passed:
        assert "6007h to 1 (fault) or 3 (quick stop)" in checks["reaction"].note


@pytest.mark.parametrize(
    ("unit", "units_per_rpm", "passed"),
    [
        (0x00B44700, 1.0, True),
        (0xFFB44700, 10.0, True),
        (0xFDB44700, 1.0, False),
        (0x00B44700, 1000.0, False),
        (0x00B44700, 3.5, True),  # a gear
        (0x00B40300, 1.0, None),  # revolutions per second
    ],
)
def test_another_unit_of_speed_fails_the_check(unit: int, units_per_rpm: float, passed: bool | None) -> None:
    settings = MotorDrive.model_validate(
        CONFIG.model_dump() | {"mode": "profile velocity", "units_per_rpm": units_per_rpm}
    )
    check = checks_of({(cia402.UNIT_OF_SPEED, 0): (unit, "<I")}, settings).get("units_per_rpm")
    assert (None if check is None else check.passed) is passed


class _Counted(HostClock):
    """A clock that moves only while the host waits."""

    def __init__(self, passes: Callable[[float], None]) -> None:
        super().__init__()
        self.at_s = self.begun_s = 1000.0
        self.passes = passes

    def now_ns(self) -> int:
        return round(self.at_s * 1e9)

    def wait(self, seconds: float) -> None:
        self.at_s += seconds
        self.passes(self.at_s)

    def every(
        self, seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        do()
        return _Ended()


class _Ended:
    def stop(self, seconds: float | None = 2.0) -> None:
        """Nothing runs."""


def test_a_time_out_is_measured() -> None:
    drive = MappedDrive({})

    def passes(at_s: float) -> None:
        drive.reports()
        if at_s - clock.begun_s > 0.5:
            emergency = cia301.Emergency(cia301.HEARTBEAT_ERROR, 0x11, bytes(5))
            drive.answer(cia301.cob_emergency(NODE), cia301.pack_emergency(emergency))

    clock = _Counted(passes)
    drive.host = DriveControl(CONFIG, drive.hear, clock)
    drive.host.start()
    drive.host.emergencies = []
    clock.begun_s = clock.at_s
    found = drive.host.measure_time_out()
    assert found.measured_s == pytest.approx(0.5, abs=0.05)
    drive.host.stop()
