"""Release of a drive: its watch over the host's heartbeat ends at rest and not before."""

from __future__ import annotations

import struct
import threading
import time

import pytest

from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import NMT_START, SdoServer
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.far_end import drive_objects
from daq.drivers.contract import RotorGuard
from daq.errors import DeviceError, LinkLost
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, FrameDecoder, decode, encode
from rig_configs import load_rig

CONFIG = load_rig("virtual").devices["drive"]
WATCH = (cia301.CONSUMER_HEARTBEAT, 1)


class FarEnd:
    """A drive that answers immediately and keeps the received frames in order; its reports are set by the test."""

    def __init__(self) -> None:
        self.received: list[tuple[int, bytes]] = []
        self.watched: list[tuple[int, float]] = []  # each write of 1016h, with the speed at that time
        self.rpm, self.state = 0, cia402.SWITCH_ON_DISABLED
        self.refused: set[int] = set()
        self.gone = False
        self.deaf_to_beats, self.beats_refused = False, 0
        self.brakes = True
        self.keeps_torque = False
        self.network = cia301.Heartbeat.OPERATIONAL
        self.deaf = False  # to the network's start too
        self.fixed: set[tuple[int, int]] = set()  # objects that cannot be written
        self.stray = b""  # an answer that comes before the right one
        self._lines, self._answers = FrameDecoder(), FrameDecoder()
        self.unheeded = False  # process data reaches it no more
        self.missed = 0  # frames of process data that the adapter does not take
        self.mute_reports = False  # its objects answer
        self.silent = False  # nothing comes from it any more
        self.answers_reset = 0  # error code of another fault that answers a reset
        measured = {
            (cia402.STATUSWORD, 0): lambda: struct.pack("<H", cia402.STATES[self.state][1]),
            (cia402.ACTUAL_VELOCITY, 0): lambda: struct.pack("<h", self.rpm),
        }
        self._sdo = SdoServer(drive_objects(CONFIG.node_id), measured, self._written)
        guard = RotorGuard(lambda rpm: None, lambda: self.rpm == 0, lambda: abs(self.rpm))
        self.control = DriveControl(CONFIG, self.send, HostClock(), guard)

    def _written(self, index: int, sub: int, value: int) -> None:
        if (index, sub) == WATCH:
            self.watched.append((value, self.rpm))
        if (index, sub) == (cia402.CONTROLWORD, 0):
            self._heeds(value)

    def _heeds(self, word: int) -> None:
        if word == cia402.DISABLE_VOLTAGE and not self.keeps_torque and self.state != cia402.FAULT:
            self.state = cia402.SWITCH_ON_DISABLED
        elif word == cia402.SHUTDOWN and not self.keeps_torque and self.state == cia402.OPERATION_ENABLED:
            self.state = cia402.READY
        elif word == cia402.FAULT_RESET and self.state == cia402.FAULT:
            self._sdo.objects[cia402.ERROR_CODE, 0] = (self.answers_reset, "<H")
            self.state = cia402.FAULT if self.answers_reset else cia402.SWITCH_ON_DISABLED
        elif word == cia402.QUICK_STOP and self.brakes:
            self.rpm = max(0, self.rpm - 100)
            self.state = cia402.QUICK_STOP_ACTIVE

    def shows(self, state: cia301.Heartbeat) -> None:
        """Its heartbeat."""
        self.network = state
        self.report(cia301.cob_heartbeat(CONFIG.node_id), bytes([state]))

    def _miss(self, data: bytes) -> None:
        if self.missed and any(
            frame.arbitration_id == cia301.cob_rpdo(1, CONFIG.node_id) for frame in decode(data).frames
        ):
            self.missed -= 1
            raise LinkLost("no buffer space")

    def send(self, data: bytes) -> None:
        if self.gone:
            raise LinkLost("gone")
        self._miss(data)
        for frame in self._lines.feed(data).frames:
            if self.deaf_to_beats and frame.arbitration_id == cia301.cob_heartbeat(CONFIG.host_node_id):
                self.beats_refused += 1
                raise LinkLost("no buffer space")
            self.received.append((frame.arbitration_id, frame.data))
            if frame.arbitration_id == 0 and not self.deaf:
                self.network = cia301.Heartbeat.OPERATIONAL
            if frame.arbitration_id == cia301.cob_sdo_request(CONFIG.node_id):
                if self.deaf:
                    continue
                if self.stray:
                    self.report(cia301.cob_sdo_answer(CONFIG.node_id), self.stray)
                index, sub = struct.unpack_from("<HB", frame.data, 1)
                if frame.data[0] >> 5 == 1 and (index, sub) in self.fixed:
                    answer = b"\x80" + frame.data[1:4] + struct.pack("<I", 0x06010002)
                    self.report(cia301.cob_sdo_answer(CONFIG.node_id), answer)
                    continue
                answer = self._sdo.answer(frame.data)
                if struct.unpack_from("<H", frame.data, 1)[0] in self.refused:
                    answer = b"\x80" + frame.data[1:4] + struct.pack("<I", 0x06090030)
                self.report(cia301.cob_sdo_answer(CONFIG.node_id), answer)
            if frame.arbitration_id == cia301.cob_rpdo(1, CONFIG.node_id):
                if self.unheeded:
                    self.speak()
                    continue
                if self.network != cia301.Heartbeat.OPERATIONAL:
                    continue
                word, _ = cia402.VELOCITY.unpack(frame.data)
                self._heeds(word)
                self.speak()

    def report(self, identifier: int, data: bytes) -> None:
        if self.silent:
            return
        self.control.take_frames(self._answers.feed(encode(CanFrame(identifier, data))).frames)

    def speak(self) -> None:
        if self.mute_reports:
            return
        _, word = cia402.STATES[self.state]
        self.report(cia301.cob_tpdo(1, CONFIG.node_id), cia402.VELOCITY.pack(word, self.rpm))

    def runs(self, rpm: int) -> None:
        self.control.start()
        self.rpm, self.state = rpm, cia402.OPERATION_ENABLED
        self.speak()

    def controlwords(self) -> list[int]:
        pdo = cia301.cob_rpdo(1, CONFIG.node_id)
        return [cia402.VELOCITY.unpack(data)[0] for identifier, data in self.received if identifier == pdo]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daq.drivers.ramp._MAX_CONSTANT_S", 0.3)
    monkeypatch.setattr("daq.drivers.ramp.REPEAT_S", 0.02)
    monkeypatch.setattr(DriveControl, "enable_s", 1.0)


def test_the_watch_ends_at_rest_and_the_heartbeat_after_it() -> None:
    far = FarEnd()
    far.runs(300)
    assert far.received[0][0] == cia301.cob_heartbeat(CONFIG.host_node_id)  # it beats before it is watched
    assert far.control.stop() is True
    assert [value & 0xFFFF for value, _ in far.watched] == [CONFIG.heartbeat_timeout_ms, 0]
    assert far.watched[-1] == (0, 0)
    assert far.controlwords()[-1] == cia402.DISABLE_VOLTAGE
    assert far.received[-1] == (0, bytes([0x80, CONFIG.node_id]))


def test_a_rotor_that_does_not_stop_keeps_torque_and_watch() -> None:
    far = FarEnd()
    far.runs(300)
    far.brakes = False
    assert far.control.stop() is False
    assert [value & 0xFFFF for value, _ in far.watched] == [CONFIG.heartbeat_timeout_ms]
    words = far.controlwords()
    assert set(words) == {cia402.QUICK_STOP}
    assert len(words) > 3  # again and again: one frame may be lost


def test_a_set_up_that_fails_leaves_nothing_watched() -> None:
    far = FarEnd()
    far.refused = {cia402.VELOCITY_DECELERATION}
    with pytest.raises(DeviceError, match="refused"):
        far.control.start()
    assert far.control.stop() is True
    assert far.watched[-1] == (0, 0)


def test_a_drive_that_is_gone_is_released() -> None:
    far = FarEnd()
    far.runs(0)
    far.state = cia402.SWITCH_ON_DISABLED
    far.speak()
    far.gone = True
    with pytest.raises(LinkLost):
        far.control.stop()
    assert not far.control._repeated


def test_a_speed_has_an_age_and_a_restart_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    far = FarEnd()
    far.runs(300)
    assert far.control.actual_rpm == 300
    now_ns = far.control._clock.now_ns()
    monkeypatch.setattr(far.control._clock, "now_ns", lambda: now_ns + 1_000_000_000)
    assert far.control.actual_rpm != far.control.actual_rpm
    far.speak()
    assert far.control.actual_rpm == 300
    far.report(cia301.cob_heartbeat(CONFIG.node_id), b"\x00")
    assert far.control.actual_rpm != far.control.actual_rpm
    assert far.control.state == cia402.UNKNOWN
    monkeypatch.undo()
    far.control._end()


def test_emergencies_stand_until_they_are_reset() -> None:
    far = FarEnd()
    for code, standing in ((0x3220, [0x3220]), (0x4310, [0x3220, 0x4310]), (0, [])):
        far.report(cia301.cob_emergency(CONFIG.node_id), cia301.pack_emergency(cia301.Emergency(code, 0, bytes(5))))
        assert far.control.emergencies == standing
        assert ("DC link under-voltage" in far.control.why()) == (0x3220 in standing)


def test_out_of_operation_it_is_stopped_through_its_objects() -> None:
    far = FarEnd()
    far.runs(50)
    far.shows(cia301.Heartbeat.PRE_OPERATIONAL)
    far.control.quick_stop()
    assert (far.rpm, far.state) == (0, cia402.QUICK_STOP_ACTIVE)
    assert (0, bytes([NMT_START, CONFIG.node_id])) in far.received[-3:]
    far.control.stop()


def test_a_drive_that_heeds_nothing_is_left_to_its_own_watch() -> None:
    far = FarEnd()
    far.runs(50)
    far.shows(cia301.Heartbeat.STOPPED)
    far.deaf = True
    clock = HostClock()
    for _ in range(10):
        far.control.quick_stop()
        clock.wait(0.05)
    beats = [identifier for identifier, _ in far.received].count(cia301.cob_heartbeat(CONFIG.host_node_id))
    clock.wait(3e-3 * CONFIG.heartbeat_ms)
    now = [identifier for identifier, _ in far.received].count(cia301.cob_heartbeat(CONFIG.host_node_id))
    assert (far.rpm, now) == (50, beats)


def test_nothing_turns_without_the_drives_own_watch() -> None:
    for restarts in (True, False):
        far = FarEnd()
        far.control.start()
        far.speak()
        if restarts:
            far.shows(cia301.Heartbeat.BOOT_UP)
        else:
            far._sdo.answer(struct.pack("<BHBI", 0x23, cia301.CONSUMER_HEARTBEAT, 1, 0))
        with pytest.raises(DeviceError, match="started again" if restarts else "is 0x00000000"):
            far.control.enable()
        assert cia402.ENABLE_OPERATION not in far.controlwords()
        far.control.stop()


def test_an_answer_of_another_object_answers_nothing() -> None:
    far = FarEnd()
    for stray in (b"\x60\x42\x60\x00" + bytes(4), b"\x80\x42\x60\x00" + struct.pack("<I", 0x06090030)):
        far.stray = stray
        far.control.start()
        assert far.watched[-1][0] & 0xFFFF > 0
    far.control.stop()


def test_a_ramp_whose_time_is_fixed_is_set_by_its_speed() -> None:
    far = FarEnd()
    for index in (cia402.VELOCITY_ACCELERATION, cia402.VELOCITY_DECELERATION):
        far._sdo.answer(struct.pack("<BHBHH", 0x2B, index, 2, 1, 0))
        far.fixed.add((index, 2))
    far.control.start()
    far.control.set_ramp(120.0)
    for index in (cia402.VELOCITY_ACCELERATION, cia402.VELOCITY_DECELERATION):
        found = far._sdo.answer(struct.pack("<BHBI", 0x40, index, 1, 0))
        assert struct.unpack_from("<I", found, 4)[0] == 120
    far.control.stop()


def test_a_ramp_that_a_fixed_time_does_not_allow_is_refused() -> None:
    far = FarEnd()
    for index in (cia402.VELOCITY_ACCELERATION, cia402.VELOCITY_DECELERATION):
        far._sdo.answer(struct.pack("<BHBHH", 0x2B, index, 2, 1, 0))
        far.fixed.add((index, 2))
    far.control.start()
    with pytest.raises(DeviceError, match=r"0\.3 rpm/s wanted.*fixed at 1 s.*the nearest ramp is 1 rpm/s"):
        far.control.set_ramp(0.3)
    far.control.stop()


def test_a_drive_that_keeps_its_torque_keeps_its_watch() -> None:
    far = FarEnd()
    far.runs(0)
    far.keeps_torque = True
    messages: list[str] = []
    assert far.control.stop(messages.append) is False
    assert far.watched[-1][0] & 0xFFFF == CONFIG.heartbeat_timeout_ms
    assert any("stays in QUICK STOP ACTIVE" in text for text in messages)


def test_the_command_to_remove_torque_is_repeated_until_the_drive_reports_it() -> None:
    far = FarEnd()
    far.runs(0)
    far.keeps_torque = True
    with pytest.raises(DeviceError, match="stays in OPERATION ENABLED"):
        far.control.disable()
    assert far.controlwords().count(cia402.SHUTDOWN) > 3
    far.keeps_torque = False
    far.control.disable()
    assert far.control.state == cia402.READY
    assert far.control.stop() is True


def test_a_silent_drive_is_commanded_and_not_assumed_to_be_off() -> None:
    for answers in ("nothing", "its objects"):
        far = FarEnd()
        far.runs(0)
        far.silent, far.mute_reports = answers == "nothing", True
        if answers == "its objects":
            far.control.disable()
            assert far.control.stop() is True
            continue
        with pytest.raises(DeviceError, match="it does not answer: the release is not confirmed"):
            far.control.disable()
        assert far.controlwords()[-1] == cia402.SHUTDOWN
        messages: list[str] = []
        assert far.control.stop(messages.append) is False
        assert any("the release is not confirmed" in text for text in messages)
        assert far.controlwords()[-1] == cia402.DISABLE_VOLTAGE
        assert not far.control._repeated


def test_a_heartbeat_that_did_not_go_out_once_goes_on() -> None:
    far = FarEnd()
    far.control.start()
    before = far.control._beats
    far.deaf_to_beats = True
    deadline = time.monotonic() + 5.0
    while far.beats_refused < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    far.deaf_to_beats = False
    while far.control._beats < before + 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert far.beats_refused >= 2
    assert far.control._beats >= before + 2
    far.control.stop()


def test_nothing_is_turned_while_the_heartbeat_does_not_go_out() -> None:
    """The watch of a drive begins with the next heartbeat after its set-up; without one it has no effect."""
    far = FarEnd()
    far.control.start()
    far.speak()
    far.control._beats_unwatched = far.control._beats
    far.deaf_to_beats = True
    with pytest.raises(DeviceError, match="heartbeat does not go out"):
        far.control.enable()
    far.deaf_to_beats = False
    assert cia402.ENABLE_OPERATION not in far.controlwords()
    far.control.stop()


def test_a_fault_that_comes_on_the_way_is_its_operators() -> None:
    far = FarEnd()
    far.control.start()
    far.state = cia402.FAULT
    far._sdo.objects[cia402.ERROR_CODE, 0] = (0x2320, "<H")
    far.control._statusword = cia402.STATES[cia402.FAULT_REACTION][1]
    far.control._report_ns = far.control._clock.now_ns()
    threading.Timer(0.05, far.speak).start()
    with pytest.raises(DeviceError, match="error code is 0x2320"):
        far.control.enable()
    assert cia402.FAULT_RESET not in far.controlwords()
    far.control.stop()


def test_a_drive_found_in_operation_gets_the_target_0() -> None:
    far = FarEnd()
    far.control.start()
    far.rpm, far.state = 300, cia402.OPERATION_ENABLED
    far.speak()
    far.control.enable()
    orders = [d for i, d in far.received if i == cia301.cob_rpdo(1, CONFIG.node_id)]
    assert [cia402.VELOCITY.unpack(d) for d in orders] == [(cia402.ENABLE_OPERATION, 0)]
    far.control.stop()


def test_a_watch_over_another_nodes_heartbeat_does_not_count() -> None:
    far = FarEnd()
    far.control.start()
    far.speak()
    far._sdo.objects[WATCH] = (cia402.consumer_heartbeat(7, 500), "<I")
    with pytest.raises(DeviceError, match="node 1 for 500 ms: 1016h sub 1 is 0x000701F4"):
        far.control.enable()
    far.control.stop()


def found_braking() -> FarEnd:
    """A drive that stops the rotor of a host that was killed."""
    far = FarEnd()
    far.rpm, far.state, far.network = 1000, cia402.QUICK_STOP_ACTIVE, cia301.Heartbeat.PRE_OPERATIONAL
    far.shows(far.network)
    return far


def test_nothing_is_taken_from_a_drive_found_turning_when_its_set_up_fails() -> None:
    far = found_braking()
    far.refused = {cia402.VELOCITY_DECELERATION}
    with pytest.raises(DeviceError, match="refused"):
        far.control.start()
    assert far.state == cia402.QUICK_STOP_ACTIVE
    assert far.control.stop() is True
    assert far.watched[-1] == (0, 0)  # the watch, and at what speed it ended


def test_a_silent_line_gets_no_command() -> None:
    far = FarEnd()
    far.deaf = True
    with pytest.raises(DeviceError, match="no answer"):
        far.control.start()
    assert far.control.stop() is True
    assert far.controlwords() == []


def test_a_drive_that_heeds_no_process_data_is_stopped_through_its_objects() -> None:
    far = FarEnd()
    far.runs(300)
    far.shows(cia301.Heartbeat.OPERATIONAL)
    far.unheeded = True
    clock, begun = HostClock(), time.monotonic()
    while far.state == cia402.OPERATION_ENABLED and time.monotonic() < begun + 2:
        far.control.quick_stop()
        far.speak()
        clock.wait(0.02)
    assert far.state == cia402.QUICK_STOP_ACTIVE
    assert 0.3 <= time.monotonic() - begun < 1.0
    assert "heartbeat" in far.control._repeated
    far.control.stop()


def test_a_drive_that_heeds_no_order_at_all_loses_the_heartbeat() -> None:
    far = FarEnd()
    far.runs(300)
    far.unheeded, far.brakes = True, False
    clock, begun = HostClock(), time.monotonic()
    while "heartbeat" in far.control._repeated and time.monotonic() < begun + 3:
        far.control.quick_stop()
        far.speak()
        clock.wait(0.02)
    assert 0.6 <= time.monotonic() - begun < 2.0
    far.control.stop()


def test_one_frame_that_is_not_taken_cancels_no_stop() -> None:
    far = FarEnd()
    far.runs(300)
    far.missed = 2
    assert far.control.stop() is True
    assert far.rpm == 0


@pytest.mark.parametrize(("register", "emergency"), [(0x13, 0), (0x11, 0x2320)])
def test_a_fault_behind_that_of_the_heartbeat_is_not_reset(register: int, emergency: int) -> None:
    far = FarEnd()
    far.control.start()
    far.state = cia402.FAULT
    far._sdo.objects[cia402.ERROR_CODE, 0] = (cia301.HEARTBEAT_ERROR, "<H")
    far._sdo.objects[cia301.ERROR_REGISTER, 0] = (register, "<B")
    for code in (emergency, cia301.HEARTBEAT_ERROR):
        far.report(cia301.cob_emergency(CONFIG.node_id), cia301.pack_emergency(cia301.Emergency(code, 0, bytes(5))))
    far.speak()
    with pytest.raises(DeviceError, match=f"error register 0x{register:02X}"):
        far.control.enable()
    assert cia402.FAULT_RESET not in far.controlwords()
    far.control.stop()


def test_another_fault_that_answers_a_reset_is_not_reset() -> None:
    far = FarEnd()
    far.control.start()
    far.state, far.answers_reset = cia402.FAULT, 0x2320
    far._sdo.objects[cia402.ERROR_CODE, 0] = (cia301.HEARTBEAT_ERROR, "<H")
    far._sdo.objects[cia301.ERROR_REGISTER, 0] = (0x11, "<B")
    far.speak()
    with pytest.raises(DeviceError, match="error code is 0x2320"):
        far.control.enable()
    assert far.controlwords().count(cia402.FAULT_RESET) == 1
    far.control.stop()


def test_the_watch_is_looked_at_also_when_a_fault_goes_by_itself() -> None:
    far = FarEnd()
    far.control.start()
    far._sdo.objects[WATCH] = (0, "<I")
    far.state = cia402.FAULT
    far.speak()

    def reset_at_the_keypad(rpm: float | None) -> None:
        if far.state == cia402.FAULT:
            far.state = cia402.SWITCH_ON_DISABLED
            far.speak()

    far.control._guarded = RotorGuard(reset_at_the_keypad, lambda: far.rpm == 0, lambda: abs(far.rpm))
    with pytest.raises(DeviceError, match="is 0x00000000"):
        far.control.enable()
    assert cia402.ENABLE_OPERATION not in far.controlwords()
    far.control.stop()


def test_a_rotor_that_brakes_is_not_left_without_torque() -> None:
    far = found_braking()
    far.network = cia301.Heartbeat.OPERATIONAL
    far.control.start()
    far.speak()
    repeated = HostClock().every(0.02, far.speak, "reports", lambda error: None)
    with pytest.raises(DeviceError, match="stays in QUICK STOP ACTIVE"):
        far.control.enable()
    repeated.stop()
    assert far.state == cia402.QUICK_STOP_ACTIVE
    far.control.stop()


def test_a_drive_whose_answers_do_not_come_keeps_its_watch() -> None:
    far = FarEnd()
    far.runs(0)
    far.report = lambda identifier, data: None
    far.control._report_ns = 1  # its last report is long ago
    assert far.control.stop() is False
    assert [value & 0xFFFF for value, _ in far.watched] == [CONFIG.heartbeat_timeout_ms]


def test_an_old_report_does_not_count_as_operation() -> None:
    far = FarEnd()
    far.runs(0)
    far.deaf_to_beats = False
    far.control._report_ns = 1
    far.speak = lambda: None
    with pytest.raises(DeviceError, match="expected OPERATION ENABLED"):
        far.control.enable()
    far.speak = FarEnd.speak.__get__(far)
    far.control.stop()


@pytest.mark.parametrize("watch", [0x0001_FFFF, 0x0081_01F4])
def test_a_watch_with_a_far_too_long_timeout_or_without_a_node_does_not_count(watch: int) -> None:
    far = FarEnd()
    far.control.start()
    far.speak()
    far._sdo.objects[WATCH] = (watch, "<I")
    with pytest.raises(DeviceError, match=f"is 0x{watch:08X}"):
        far.control.enable()
    far.control.stop()
