"""A laser that streamed to a host that was killed, with full buffers on the way, on simulated time."""

from __future__ import annotations

import numpy as np
import pytest

from daq.drivers.optoncdt import wire as optoncdt
from daq.errors import DeviceError
from tests.daq.hand_made_laser import HandMadeLaser

READ_BYTES = 4096
"""Largest portion that a read of a port yields."""


class StreamingLaser(HandMadeLaser):
    """A laser that streams at full rate; a busy host reads the line now and then.

    Args:
        backlog: bytes that wait on the way when the host opens the port.
        read_every_s: time between two reads of the host.
        deaf: whether the laser ignores every command.
        streaming: whether it streams.
    """

    def __init__(self, backlog: int, read_every_s: float, deaf: bool = False, streaming: bool = True) -> None:
        super().__init__()
        self._read_every_s, self._deaf = read_every_s, deaf
        self._streaming, self._sample = streaming, 0
        self._line = bytearray()
        while len(self._line) < backlog:
            self._line += self._samples(40)
        self.clock.after(read_every_s, self._read)

    def _samples(self, count: int) -> bytes:
        number = self._sample + np.arange(count)
        self._sample += count
        words = np.column_stack([30_000 + number % 7, number & 0xFFFF, (25 * number) & 0xFFFF, (25 * number) >> 16])
        return optoncdt.encode_block(words.astype(np.uint32))

    def _read(self) -> None:
        if self._streaming:
            self._line += self._samples(max(0, int(4000 * self.clock.now_s()) - self._sample))
        data = bytes(self._line[:READ_BYTES])
        del self._line[: len(data)]
        self.bytes_in += len(data)
        for line in self._decoder.feed(data).text:
            self.replies.put(line)
        self.clock.after(self._read_every_s, self._read)

    def send(self, data: bytes) -> None:
        if self._deaf:
            return
        for command in data.decode("ascii").splitlines():
            self.heard.append(command)
            self._streaming = command == "OUTPUT RS422" or (self._streaming and command != "OUTPUT NONE")
            answer = self._answers.get(command, self._answers.get(command.split()[0], f"{command} ok"))
            self._line += f"{answer}\r\n->".encode()

    def restart_decoding(self) -> None:
        self._decoder = optoncdt.BlockDecoder(("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"))


@pytest.mark.parametrize("read_every_s", [0.001, 0.02, 0.099, 0.12, 0.15, 0.2])
@pytest.mark.parametrize("backlog", [0, 4096, 16_384, 65_536])
def test_a_start_after_a_kill_succeeds_with_any_backlog_on_the_line(backlog: int, read_every_s: float) -> None:
    sensor = StreamingLaser(backlog, read_every_s)
    identity = sensor.set_up()
    assert identity["serial"] == "12345678"
    assert identity["words"] == ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"]
    assert sensor.heard[-1] == "OUTPUT RS422"
    assert "MEASRATE 4" in sensor.heard
    assert sensor.clock.now_s() < 15.0


def test_a_laser_that_hears_nothing_is_named_within_seconds() -> None:
    sensor = StreamingLaser(0, 0.15, deaf=True)
    with pytest.raises(DeviceError, match=r"no answer to 'OUTPUT NONE'|goes on streaming"):
        sensor.set_up()
    assert sensor.clock.now_s() < 15.0


def test_a_silent_laser_is_named_after_one_wait() -> None:
    sensor = StreamingLaser(0, 0.15, deaf=True, streaming=False)
    with pytest.raises(DeviceError, match=r"no answer to 'OUTPUT NONE' within 1 s\. Is the baud rate 921600"):
        sensor.set_up()
    assert sensor.clock.now_s() < 2.0
