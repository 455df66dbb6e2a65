"""Setting up a sensor whose stream another host left running, and one that will not be silent."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from daq.acquisition.reader import DeviceReader
from daq.drivers.contract import Pipeline
from daq.drivers.devices import make_pipelines
from daq.drivers.optoncdt import dialogue as lasers, sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.commands import SensorCommands, info_lines
from daq.errors import DeviceError
from daq.items import RX, DeviceEvent
from daq.transports import HostClock, open_link
from daq.transports.wires import TcpWire
from rig_configs import load_rig

INFO = sensor_answers.SensorInfo(name="ILD1420", serial="14200001", range_m=0.025, version="001.019")


CLOCK = HostClock()


class LeftStreaming:
    """A sensor during its stream; each OUTPUT RS422 restarts its counter and timestamp, as after a power cut."""

    def __init__(self, deaf: bool = False) -> None:
        self.wire = TcpWire()
        self._commands = SensorCommands(info_lines(INFO), 4000.0)
        self._commands.receive(b"OUTADD_RS422 COUNTER TIMESTAMP\nOUTPUT RS422\n")
        self._number, self._deaf, self._ending = 123_456, deaf, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending.wait(0.005):
            sent = self.wire.receive()
            streamed = self._commands.streaming
            answer = b"" if self._deaf else self._commands.receive(sent)
            if streamed and not self._commands.streaming:
                self.wire.send(self._blocks(200))  # what its own buffer still held
            self.wire.send(answer)
            if b"OUTPUT RS422" in sent:
                self._number = 0
            if self._commands.streaming:
                self.wire.send(self._blocks(20))

    def _blocks(self, count: int) -> bytes:
        number = self._number + np.arange(count)
        self._number += count
        ticks = 25 * number
        counter = number % optoncdt.COUNTER_WRAP
        words = np.column_stack([np.full(count, 32_760), counter, ticks & 0xFFFF, ticks >> 16 & 0xFFFF])
        return optoncdt.encode_block(words.astype(np.uint32))

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self.wire.close()


@dataclass
class Line:
    """A reader and what decodes its bytes."""

    reader: DeviceReader
    pipeline: Pipeline


@contextmanager
def line_to(sensor: LeftStreaming) -> Iterator[tuple[Line, list[DeviceEvent], list[int]]]:
    """A reader on the sensor's line with what it decodes: events, and how many samples came."""
    rig = load_rig("virtual", settings={"devices.laser_x.port": sensor.wire.port})
    device = DeviceReader("laser_x", open_link(sensor.wire.port, 921_600), CLOCK)
    line = Line(device, make_pipelines(rig.devices, {})["laser_x"])
    events: list[DeviceEvent] = []
    samples: list[int] = []

    def take(sent: object, data: bytes, host_ns: int) -> None:
        for item in line.pipeline.feed(RX, data, host_ns):
            if isinstance(item, DeviceEvent):
                events.append(item)
                if item.kind == "reply":
                    device.replies.put(item.text)
            else:
                samples.append(len(item.time_ns))

    device.start(take, lambda error: None)
    try:
        yield line, events, samples
    finally:
        device.stop()
        sensor.close()


def wait_for(condition: object) -> None:
    for _ in range(500):
        if condition():
            return
        threading.Event().wait(0.01)
    raise AssertionError("waited 5 s")


def test_a_stream_left_running_is_run_dry_before_the_new_one_begins() -> None:
    with line_to(LeftStreaming()) as (line, events, samples):
        wait_for(lambda: sum(samples) > 100)  # in mid-stream, as a killed host leaves it
        rig = load_rig("virtual")

        def clear() -> None:
            with line.reader.lock:
                line.pipeline = make_pipelines(rig.devices, {})["laser_x"]
                samples.clear()

        line.reader.restart_decoding = clear
        identity = lasers.configure("laser_x", rig.devices["laser_x"], line.reader)
        assert identity["serial"] == "14200001"
        wait_for(lambda: sum(samples) > 400)
        assert [e.text for e in events if e.kind in ("restart", "damage", "gap")] == []
        assert not any(line.pipeline.losses.values())


def test_the_error_for_a_sensor_that_does_not_stop_contains_what_to_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daq.drivers.questions._TRY_S", 0.3)
    with line_to(LeftStreaming(deaf=True)) as (line, _, samples):
        wait_for(lambda: sum(samples) > 100)
        with pytest.raises(
            DeviceError, match=r"sent OUTPUT NONE several times, it goes on streaming\. Does its line carry"
        ):
            lasers.configure("laser_x", load_rig("virtual").devices["laser_x"], line.reader)
