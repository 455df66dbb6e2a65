"""Sensors on CAN whose counter alone does not place a frame: gaps of whole cycles, late reads, restarts in a gap."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any, cast

import numpy as np
import pytest

from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CLOSE_BUS, AdapterMessage, CanFrame, adapter_message, encode, open_bus
from rig_drivers.dbc.driver import DRIVER
from rig_drivers.dbc.settings import CanSensors
from rig_drivers.dbc.stream import CanPipeline

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
OTHER = encode(CanFrame(0x300, b"\x01"))
DBC = (
    'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: N\n\nBO_ 257 LaserX: 4 N\n SG_ Dist : 0|16@1- (0.001,0) [0|0] "mm" N\n'
    ' SG_ Count : 16|4@1+ (1,0) [0|0] "" N\n'
)
X = {"message": "LaserX", "signal": "Dist", "counter": "Count", "rate_Hz": 1000.0, "range_m": 0.1}
Items = list[Batch | DeviceEvent]
Sent = list[tuple[int, int]]  # frames of the sensor: time, ms, and number


def bus(bits: int = 4, **changes: Any) -> CanPipeline:
    """One laser at 1 kHz with a counter of these bits and no timestamp."""
    text = DBC.replace("16|4@", f"16|{bits}@")
    table = {"driver": "dbc", "port": "p", "bitrate": 1_000_000, "dbc_text": text, "x": X, **changes}
    found = DRIVER.pipeline("bus", CanSensors.model_validate(table), {})
    assert isinstance(found, CanPipeline)
    return found


def frame(number: int, millisecond: int, bits: int = 4) -> bytes:
    """The displacement in µm is the millisecond at which the frame was sent."""
    data = (millisecond % 20_000).to_bytes(2, "little") + (number % 2**bits).to_bytes(2, "little")
    return encode(CanFrame(0x101, data))


def heard(line: CanPipeline, sent: Sent, reads_ms: Iterable[int], bits: int = 4) -> Items:
    """Feed the frames that were sent before each of these times."""
    out: Items = []
    at = 0
    for read_ms in reads_ms:
        first = at
        while at < len(sent) and sent[at][0] < read_ms:
            at += 1
        text = b"".join(frame(number, ms, bits) for ms, number in sent[first:at])
        out += line.feed(RX, text, START_NS + read_ms * MS) if text else []
    return out


def errors_ms(items: Items) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return how much later than sent the samples are, ms."""
    found = [item for item in items if isinstance(item, Batch)]
    times = np.concatenate([batch.time_ns for batch in found]) - START_NS
    sent = np.rint(np.concatenate([batch.columns["displacement_m"] for batch in found]) * 1e6)
    return times / MS - sent


def kinds(items: Items) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


def with_gap(lost: int, *, restarts: bool = False) -> Sent:
    before = [(ms, ms) for ms in range(2000)]
    return before + [(ms, ms - (2000 + lost if restarts else 0)) for ms in range(2000 + lost, 4000 + lost)]


@pytest.mark.parametrize("every_ms", [3, 10, 44])
@pytest.mark.parametrize(("bits", "lost"), [(4, 15), (4, 16), (4, 33), (4, 400), (8, 256), (8, 600), (4, 2000)])
def test_a_gap_of_more_than_a_cycle_is_counted_and_the_times_after_it_are_right(
    bits: int, lost: int, every_ms: int
) -> None:
    line = bus(bits, timeout_s=10.0)
    found = heard(line, with_gap(lost), range(every_ms, 4000 + lost, every_ms), bits)
    assert (line.losses["samples"], set(kinds(found))) == (lost, {"gap"})
    wrong = np.abs(errors_ms(found)) > 3.0
    assert np.count_nonzero(wrong) <= every_ms  # where in a read whole cycles are missing is not known
    assert len(wrong) > 3700


def test_a_restart_in_a_gap_is_seen_and_the_times_after_it_are_right() -> None:
    line = bus(8)
    found = heard(line, with_gap(499, restarts=True), range(10, 4400, 10), 8)
    assert kinds(found) == ["gap", "restart"]
    assert abs(line.losses["samples"] - 499) <= 2
    assert np.abs(errors_ms(found)).max() < 3.0
    (gap,) = (item for item in found if isinstance(item, DeviceEvent) and item.kind == "gap")
    assert gap.facts["uncertain_samples"] == gap.facts["samples"]
    assert gap.text.startswith("about ")


class OpenAdapter:
    """An adapter that an earlier session left open: it sends its old frames for 0.3 s after the bus was closed."""

    def __init__(self) -> None:
        self.clock = self
        self.heard: list[bytes] = []
        self.bytes_in = 0
        self.joined_after: int | None = None
        self._now_s = 0.0

    def now_s(self) -> float:
        return self._now_s

    def wait(self, seconds: float) -> None:
        self._now_s += seconds
        self.bytes_in += 100 if self._now_s < 0.3 else 0

    def send(self, data: bytes) -> None:
        self.heard.append(data)

    def restart_decoding(self) -> None:
        self.joined_after = self.bytes_in


@pytest.mark.parametrize(("port", "old"), [("p", True), ("can:socketcan:can0", False)])
def test_frames_that_an_adapter_holds_from_an_earlier_session_are_not_recorded(port: str, old: bool) -> None:
    adapter = OpenAdapter()
    table = {"driver": "dbc", "port": port, "bitrate": 1_000_000, "dbc_text": DBC, "x": X}
    DRIVER.open("bus", CanSensors.model_validate(table), cast(Any, adapter))
    assert adapter.heard == [CLOSE_BUS] * old + [open_bus(1_000_000)]
    assert adapter.joined_after == (adapter.bytes_in if old else None)
    assert (adapter.now_s() > 0.3) == old


def test_answers_of_an_adapter_do_not_show_that_the_bus_carries_frames() -> None:
    line = bus(timeout_s=0.5)
    line.feed(RX, frame(1, 0), START_NS)
    assert line.feed(RX, adapter_message(AdapterMessage.OPENED), START_NS + 900 * MS) == []


def test_a_bus_that_was_silent_as_a_whole_gives_the_sensor_time_to_come_back() -> None:
    line = bus(timeout_s=0.5)
    line.feed(RX, frame(1, 0), START_NS)
    assert line.feed(RX, OTHER, START_NS + 900 * MS) == []
    assert line.feed(RX, OTHER, START_NS + 1_300 * MS) == []
    assert kinds(line.feed(RX, OTHER, START_NS + 1_500 * MS)) == ["doubt"]


def test_slow_frames_of_others_do_not_hide_a_silent_sensor() -> None:
    line = bus(timeout_s=0.5)
    line.feed(RX, frame(1, 0), START_NS)
    found = [line.feed(RX, OTHER, START_NS + ms * MS) for ms in range(600, 3000, 600)]
    assert kinds(list(itertools.chain(*found))) == ["doubt"]


def ended(line: CanPipeline, found: Items) -> Items:
    """What was found, with what the pipeline gives at the end of the log."""
    assert line.feed(TX, b"", START_NS + 9000 * MS) == []
    return found + line.feed(RX, b"", START_NS + 9000 * MS)


def samples(items: Items) -> int:
    return sum(len(item.time_ns) for item in items if isinstance(item, Batch))


def test_frames_that_wait_at_the_end_of_a_log_are_decoded() -> None:
    """The last 20 frames are late by 60 ms: no later read shows why. Without a counter cycle in it, nothing is lost."""
    line = bus()
    sent = [(ms, ms) for ms in range(2000)]
    found = heard(line, sent[:1980], range(10, 1981, 10))
    text = b"".join(frame(number, ms) for ms, number in sent[1980:])
    found += line.feed(RX, text, START_NS + 2060 * MS)
    found = ended(line, found)
    assert (samples(found), line.losses["samples"], kinds(found)) == (2000, 0, [])
    assert np.abs(errors_ms(found)).max() < 3.0
    assert line.feed(RX, b"", START_NS + 9000 * MS) == []


STAMPED = DBC.replace("LaserX: 4", "LaserX: 8").replace("16|4@", "16|8@") + ' SG_ Time : 32|32@1+ (1,0) [0|0] "us" N\n'


def stamped(millisecond: int, stamp_ms: float) -> bytes:
    body = (millisecond % 20_000).to_bytes(2, "little") + (millisecond % 256).to_bytes(2, "little")
    return encode(CanFrame(0x101, body + int(stamp_ms * 1000).to_bytes(4, "little")))


@pytest.mark.parametrize(
    ("late_ms", "lost", "stamp"),
    [
        (300, 20, 1.0),  # the host's delay is no cycle of the counter
        (300, 300, 1.0),
        (300, 20, 1.01),  # a sensor slower than stated by 1 %
        (2000, 20, 1.0),
        (0, 276, 1.0),
    ],
)
def test_a_late_host_does_not_contradict_timestamps_that_agree_with_the_numbers(
    late_ms: int, lost: int, stamp: float
) -> None:
    line = bus(dbc_text=STAMPED, x={**X, "timestamp": "Time"}, timeout_s=10.0)
    sent = [ms for ms in range(5000) if not 2000 <= ms < 2000 + lost]
    found: Items = []
    for before_ms in range(10, 5001, 10):  # each read returns what was sent in 10 ms, some of them late
        late = 2000 <= before_ms < 2000 + lost + late_ms
        text = b"".join(stamped(ms, ms * stamp) for ms in sent if before_ms - 10 <= ms < before_ms)
        host_ms = 2000 + lost + late_ms if late else before_ms
        found += line.feed(RX, text, START_NS + host_ms * MS) if text else []
    assert (line.losses["samples"], kinds(ended(line, found))) == (lost, ["gap"])
    assert np.abs(errors_ms(found)).max() < 3.0 or stamp != 1.0


def test_a_gap_in_which_the_timestamps_begin_again_is_counted_by_the_hosts_time() -> None:
    """Timestamps of 2.048 s and a counter of 0.256 s agree on a gap of 20 frames; 2068 are missing."""
    text = DBC.replace("LaserX: 4", "LaserX: 8").replace("16|4@", "16|8@") + ' SG_ Time : 32|11@1+ (1,0) [0|0] "ms" N\n'
    line = bus(dbc_text=text, x={**X, "timestamp": "Time"}, timeout_s=10.0)
    found: Items = []
    for ms in range(6000):
        if not 2000 <= ms < 4068:
            body = (ms % 20_000).to_bytes(2, "little") + (ms % 256).to_bytes(2, "little")
            data = encode(CanFrame(0x101, body + (ms % 2048).to_bytes(4, "little")))
            found += line.feed(RX, data, START_NS + (ms + 1) * MS)
    assert (line.losses["samples"], kinds(found)) == (2068, ["gap"])


def test_a_frame_whose_time_waits_is_not_lost_when_the_sensor_starts_again() -> None:
    """The last frame before the restart has a time 5 ms ahead, which the next frame would have explained."""
    line = bus(dbc_text=STAMPED, x={**X, "timestamp": "Time"}, timeout_s=10.0)
    found: Items = []
    for ms in range(2000):
        found += line.feed(RX, stamped(ms, ms + (5 if ms == 1999 else 0)), START_NS + (ms + 1) * MS)
    for ms in range(2200, 2600):
        body = (ms % 20_000).to_bytes(2, "little") + ((ms + 60) % 256).to_bytes(2, "little")
        data = encode(CanFrame(0x101, body + (1000 * (ms - 2200)).to_bytes(4, "little")))
        found += line.feed(RX, data, START_NS + (ms + 1) * MS)
    found = ended(line, found)
    assert "restart" in kinds(found)
    assert samples(found) + line.losses["doubtful_frames"] == 2400
