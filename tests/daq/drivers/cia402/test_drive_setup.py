"""Set-up of a drive at its opening: its process data as the host packs it, for any mapping of its maker."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import cast

import pytest
from hypothesis import given, strategies as st

from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import NMT_PRE_OPERATIONAL, NMT_START, Objects, SdoServer
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.far_end import drive_objects
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.wire import profile_of
from daq.errors import DeviceError, LinkLost
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, FrameDecoder
from rig_configs import load_rig

CONFIG = cast("MotorDrive", load_rig("virtual").devices["drive"])
NODE = CONFIG.node_id
OFF = 1 << 31
STATUS, ACTUAL, TORQUE = (index << 16 | 16 for index in (cia402.STATUSWORD, cia402.ACTUAL_VELOCITY, 0x6077))
WANTED = {
    (cia301.RPDO1, 1): cia301.cob_rpdo(1, NODE),
    (cia301.RPDO1_MAPPING, 1): cia402.CONTROLWORD << 16 | 16,
    (cia301.RPDO1_MAPPING, 2): cia402.TARGET_VELOCITY << 16 | 16,
    (cia301.TPDO1, 1): cia301.cob_tpdo(1, NODE),
    (cia301.TPDO1_MAPPING, 1): STATUS,
    (cia301.TPDO1_MAPPING, 2): ACTUAL,
}
_STATE, _ACCESS, _RANGE = 0x08000022, 0x06010000, 0x06090030  # abort codes of CiA 301


class MappedDrive:
    """A drive that protects its process data as CiA 301 requires.

    Mapping, transmission type and identifier are changed only while the PDO is off, entries only at count 0.
    """

    def __init__(self, changes: dict[tuple[int, int], int], *, settings: MotorDrive = CONFIG) -> None:
        self.profile = profile_of(settings)
        self.objects: Objects = drive_objects(NODE, self.profile)
        forms = {0: "<B", 1: "<I", 2: "<B", 3: "<H", 5: "<H"}
        for (index, sub), value in changes.items():
            self.objects[index, sub] = (value, "<I" if index in _MAPPINGS and sub else forms[sub])
        self.written: list[tuple[int, int, int]] = []
        self.orders: list[int] = []
        self.fixed = False
        self.fixed_in_operation = False
        self.refused_entry: int | None = None
        self.network_orders: list[int] = []
        self.interrupted = self.period_guarded = False
        self.at_write: Callable[[int, int, int], None] = lambda index, sub, value: None
        self.at_read: Callable[[int], None] = lambda index: None
        self.beat_s = 0.0  # time of the host's last heartbeat
        self.state = cia402.SWITCH_ON_DISABLED
        self.started = False
        self.lost_orders = self.lost_starts = 0  # frames that the adapter loses without a message
        self.requests: list[tuple[int, int]] = []  # identifiers and lengths of remote frames
        self.silent_at: tuple[int, int] | None = None  # object about which it does not answer
        self.refused: set[int] = set()  # objects that it does not let write
        measured = {
            (cia402.STATUSWORD, 0): lambda: struct.pack("<H", cia402.STATES[self.state][1]),
            (self.profile.actual, 0): lambda: bytes(self.profile.size - 2),
        }
        self._lines, self._sdo = FrameDecoder(), SdoServer(self.objects, measured, self._take)
        self.host = DriveControl(settings, self.hear, HostClock())

    def value(self, index: int, sub: int) -> int:
        return self.objects[index, sub][0]

    def _take(self, index: int, sub: int, value: int) -> None:
        self.at_write(index, sub, value)
        self.written.append((index, sub, value))

    def hear(self, data: bytes) -> None:
        for frame in self._lines.feed(data).frames:
            if frame.remote:
                self.requests.append((frame.arbitration_id, len(frame.data)))
            elif frame.arbitration_id == cia301.cob_heartbeat(CONFIG.host_node_id):
                self.beat_s = time.monotonic()
            elif frame.arbitration_id == cia301.cob_sdo_request(NODE):
                if frame.data[0] >> 5 == 2:
                    self.at_read(struct.unpack_from("<H", frame.data, 1)[0])
                if self.silent_at != struct.unpack_from("<HB", frame.data, 1):
                    self.answer(cia301.cob_sdo_answer(NODE), self._refusal(frame.data) or self._sdo.answer(frame.data))
            elif frame.arbitration_id == 0 and self.lost_starts:
                self.lost_starts -= 1
            elif frame.arbitration_id == cia301.cob_rpdo(1, NODE) and self.lost_orders:
                self.lost_orders -= 1
            elif frame.arbitration_id == 0:
                self.network_orders.append(frame.data[0])
                self.started = frame.data[0] == NMT_START
            elif frame.arbitration_id == cia301.cob_rpdo(1, NODE):
                word, rpm = self.profile.unpack(frame.data)
                self.objects[self.profile.target, 0] = (round(rpm), self.objects[self.profile.target, 0][1])
                self.orders.append(word)
                if word == CONFIG_STEPS.get(self.state, (None,))[0] or word & 0x0F == 0x0F:
                    self.state = CONFIG_STEPS.get(self.state, (None, self.state))[1]
            if self.started:
                self.reports()

    def shows(self, state: cia301.Heartbeat) -> None:
        """Its heartbeat."""
        self.answer(cia301.cob_heartbeat(NODE), bytes([state]))

    def reports(self) -> None:
        """Its statusword and speed."""
        self.answer(cia301.cob_tpdo(1, NODE), self.profile.pack(cia402.STATES[self.state][1], 0))

    def answer(self, identifier: int, data: bytes) -> None:
        self.host.take_frames([CanFrame(identifier, data)])

    def _refusal(self, request: bytes) -> bytes:
        index, sub, value = struct.unpack_from("<HBI", request, 1)
        if request[0] >> 5 == 1 and index in self.refused:
            return b"\x80" + request[1:4] + struct.pack("<I", _RANGE)
        if request[0] >> 5 != 1 or index not in (cia301.RPDO1, cia301.TPDO1, *_MAPPINGS):
            return b""
        if self.fixed or (self.fixed_in_operation and self.started) or self.refused_entry == value:
            return b"\x80" + request[1:4] + struct.pack("<I", _ACCESS)
        mapping = index in _MAPPINGS
        own = self.value(index - 0x200 if mapping else index, 1)
        changes = mapping or sub in (2, 3) or (self.period_guarded and sub == 5) or (sub == 1 and (own ^ value) & ~OFF)
        if (changes and not own & OFF) or (mapping and sub and self.value(index, 0)):
            return b"\x80" + request[1:4] + struct.pack("<I", _STATE)
        return b""


_MAPPINGS = (cia301.RPDO1_MAPPING, cia301.TPDO1_MAPPING)
CONFIG_STEPS = {
    cia402.SWITCH_ON_DISABLED: (cia402.SHUTDOWN, cia402.READY),
    cia402.READY: (cia402.SWITCH_ON, cia402.SWITCHED_ON),
    cia402.SWITCHED_ON: (cia402.ENABLE_OPERATION, cia402.OPERATION_ENABLED),
}


def opened(changes: dict[tuple[int, int], int], prepare: Callable[[MappedDrive], None] = lambda d: None) -> MappedDrive:
    drive = MappedDrive(changes)
    prepare(drive)
    drive.host.start()
    drive.host.stop()
    return drive


def of_process_data(drive: MappedDrive) -> list[tuple[int, int, int]]:
    return [w for w in drive.written if w[0] in (cia301.RPDO1, cia301.TPDO1, *_MAPPINGS)]


def test_a_mapping_that_is_right_is_left_alone() -> None:
    assert of_process_data(opened({(cia301.TPDO1, 5): 20})) == []


def test_a_drive_that_would_report_changes_only_gets_a_period() -> None:
    assert of_process_data(opened({})) == [(cia301.TPDO1, 5, 10)]


def test_more_behind_the_speed_may_stay_but_not_behind_the_orders() -> None:
    behind = {(cia301.TPDO1_MAPPING, 0): 3, (cia301.TPDO1_MAPPING, 3): TORQUE, (cia301.TPDO1, 5): 20}
    assert of_process_data(opened(behind)) == []
    drive = opened({(cia301.RPDO1_MAPPING, 0): 3, (cia301.RPDO1_MAPPING, 3): TORQUE, (cia301.TPDO1, 5): 20})
    assert drive.value(cia301.RPDO1_MAPPING, 0) == 2
    assert drive.value(cia301.RPDO1, 1) == cia301.cob_rpdo(1, NODE)


words = st.sampled_from([STATUS, ACTUAL, TORQUE, cia402.CONTROLWORD << 16 | 16, cia402.TARGET_VELOCITY << 16 | 16, 0])
kinds = st.sampled_from([0, 1, 240, 252, 253, 254, 255])


@given(
    counts=st.tuples(st.integers(0, 2), st.integers(0, 2)),
    entries=st.tuples(words, words, words, words),
    kinds=st.tuples(kinds, kinds),
    identifiers=st.tuples(
        *[st.sampled_from([OFF, OFF | 0x185, 0x185, 0x205, 0x385, OFF | 0x4000_0185, 0x2000_0185, 0x2000_0205])] * 2
    ),
    timer=st.sampled_from([0, 5, 100]),
)
def test_for_any_mapping_commands_are_taken_and_speeds_reported(
    counts: tuple[int, int],
    entries: tuple[int, int, int, int],
    kinds: tuple[int, int],
    identifiers: tuple[int, int],
    timer: int,
) -> None:
    changes = {(cia301.TPDO1, 5): timer}
    for n, (travels, mapping) in enumerate(
        [(cia301.RPDO1, cia301.RPDO1_MAPPING), (cia301.TPDO1, cia301.TPDO1_MAPPING)]
    ):
        changes |= {(travels, 1): identifiers[n], (travels, 2): kinds[n], (mapping, 0): counts[n]}
        changes |= {(mapping, 1): entries[2 * n], (mapping, 2): entries[2 * n + 1]}
    drive = opened(changes)
    assert {where: drive.value(*where) for where in WANTED} == {
        where: value | (drive.value(*where) & 0x4000_0000) for where, value in WANTED.items()
    }
    assert drive.value(cia301.RPDO1_MAPPING, 0) == 2
    assert drive.value(cia301.TPDO1_MAPPING, 0) == 2
    assert drive.value(cia301.RPDO1, 2) >= 254
    assert drive.value(cia301.TPDO1, 2) >= 254
    assert drive.value(cia301.TPDO1, 5) == (timer or 10)


def test_a_drive_that_cannot_be_mapped_is_refused_with_what_it_needs() -> None:
    drive = MappedDrive({(cia301.TPDO1_MAPPING, 0): 1})
    drive.fixed = True
    with pytest.raises(DeviceError, match=r"1800h sub 1.*1A00h statusword and actual speed \(6041h, 6044h\).*tool"):
        drive.host.start()
    assert not drive.started


def test_a_drive_that_refuses_changes_in_operation_is_taken_out_of_it() -> None:
    def run(drive: MappedDrive) -> None:
        drive.started = drive.fixed_in_operation = True

    drive = opened({(cia301.TPDO1_MAPPING, 0): 1}, run)
    assert drive.value(cia301.TPDO1_MAPPING, 0) == 2
    assert drive.network_orders[:2] == [NMT_PRE_OPERATIONAL, NMT_START]


def test_a_drive_in_operation_that_is_right_is_not_taken_out_of_it() -> None:
    drive = MappedDrive({(cia301.TPDO1, 5): 20})
    drive.started = True
    drive.host.start()
    orders = list(drive.network_orders)
    drive.host.stop()
    assert orders == [NMT_START]


def test_what_a_drive_had_is_put_back_when_it_refuses_ours() -> None:
    had = {
        (cia301.TPDO1_MAPPING, 0): 2,
        (cia301.TPDO1_MAPPING, 1): TORQUE,
        (cia301.TPDO1_MAPPING, 2): STATUS,
        (cia301.TPDO1, 1): 0x4000_0185,
        (cia301.TPDO1, 2): 1,
    }
    drive = MappedDrive(had)
    drive.refused_entry = ACTUAL
    with pytest.raises(DeviceError, match="1A00h sub 2"):
        drive.host.start()
    assert {where: drive.value(*where) for where in had} == had


@pytest.mark.parametrize("period_ms", [0, 101, 2000, 65535])
def test_reports_that_come_too_seldom_get_a_period(period_ms: int) -> None:
    assert opened({(cia301.TPDO1, 5): period_ms}).value(cia301.TPDO1, 5) == 10


def test_an_inhibit_time_of_a_second_is_taken_off_and_a_short_one_is_left() -> None:
    drive = opened({(cia301.TPDO1, 3): 10_000, (cia301.TPDO1, 5): 20})
    assert drive.value(cia301.TPDO1, 3) == 0
    assert drive.value(cia301.TPDO1, 1) == cia301.cob_tpdo(1, NODE)
    assert of_process_data(opened({(cia301.TPDO1, 3): 50, (cia301.TPDO1, 5): 20})) == []


def test_a_drive_that_does_not_show_its_mapping_is_taken_as_set_up_by_hand() -> None:
    def hide(drive: MappedDrive) -> None:
        for where in list(drive.objects):
            if where[0] in (cia301.RPDO1, cia301.TPDO1, *_MAPPINGS):
                del drive.objects[where]

    assert NMT_START in opened({}, hide).network_orders


@pytest.mark.parametrize(("ramp_bits", "word"), [(False, 0x0F), (True, 0x7F)])
def test_drives_that_ask_for_their_ramp_get_bits_4_to_6(ramp_bits: bool, word: int) -> None:
    drive = MappedDrive({}, settings=CONFIG.model_copy(update={"ramp_bits": ramp_bits}))
    drive.host.start()
    drive.host.enable()
    drive.host.set_speed(100)
    assert drive.orders == [cia402.SHUTDOWN, cia402.SWITCH_ON, word, word]
    drive.host.quick_stop()
    assert drive.orders[-1] == cia402.QUICK_STOP
    drive.host.stop()


@pytest.mark.parametrize(("index", "identifier"), [(0x1801, 0x185), (0x1403, 0x205)])
def test_another_pdo_that_bears_our_identifier_is_refused(index: int, identifier: int) -> None:
    drive = MappedDrive({(index, 1): identifier})
    with pytest.raises(DeviceError, match=f"{index:04X}h sub 1 has the identifier {identifier:03X}h too"):
        drive.host.start()
    assert opened({(index, 1): OFF | identifier}).network_orders[0] == NMT_START


def test_the_mapping_of_a_drive_with_torque_is_not_changed() -> None:
    had = {(cia301.TPDO1_MAPPING, 0): 1, (cia301.TPDO1, 5): 20}
    drive = MappedDrive(had)
    drive.state = cia402.QUICK_STOP_ACTIVE
    with pytest.raises(DeviceError, match="it has torque"):
        drive.host.start()
    assert of_process_data(drive) == []
    assert {where: drive.value(*where) for where in had} == had


def test_the_drive_s_mapping_is_restored_for_any_end_of_the_set_up() -> None:
    had = {(cia301.RPDO1_MAPPING, 0): 1, (cia301.RPDO1, 2): 1, (cia301.TPDO1_MAPPING, 0): 1, (cia301.TPDO1, 3): 20_000}
    for ending in (KeyboardInterrupt, LinkLost):
        drive = MappedDrive(had)
        before = dict(drive.objects)

        def interrupt(index: int, sub: int, value: int, drive: MappedDrive = drive, ending: type = ending) -> None:
            if (index, sub, value) == (cia301.TPDO1_MAPPING, 0, 2) and not drive.interrupted:
                drive.interrupted = True
                raise ending("now")

        drive.at_write = interrupt
        with pytest.raises(ending):
            drive.host.start()
        assert {where: drive.value(*where) for where in had} == had
        assert drive.value(cia301.TPDO1, 1) == before[cia301.TPDO1, 1][0]


@pytest.mark.parametrize("count", [1, 2])
def test_a_period_that_is_taken_only_while_the_pdo_is_off_is_set_then(count: int) -> None:
    drive = MappedDrive({(cia301.TPDO1, 5): 0, (cia301.TPDO1_MAPPING, 0): count})
    drive.period_guarded = True
    drive.host.start()
    drive.host.stop()
    assert drive.value(cia301.TPDO1, 5) == 10
    assert drive.value(cia301.TPDO1, 1) == cia301.cob_tpdo(1, NODE)


def test_a_period_that_cannot_be_set_is_no_reason_to_refuse_a_drive() -> None:
    drive = MappedDrive({(cia301.TPDO1, 5): 0})
    drive.refused_entry = 10
    drive.host.start()
    assert drive.value(cia301.TPDO1, 1) == cia301.cob_tpdo(1, NODE)
    drive.host.stop()


def test_a_count_that_stands_for_another_kind_of_pdo_is_no_mapping() -> None:
    assert opened({(cia301.TPDO1_MAPPING, 0): 254}).value(cia301.TPDO1_MAPPING, 0) == 2
