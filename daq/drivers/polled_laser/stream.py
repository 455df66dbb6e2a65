"""Pipeline of a polled displacement sensor: requests and answers to displacement of the disk centre.

The sensor has no clock. The time of a sample is the middle between its request and the read with its answer, less
`delay_s`: the error is at most half of the time between the two. A request without an answer is a lost sample. An
answer without a request, or later than `LATEST_S` after it, belongs to no known time and is dropped.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.drivers.polled_laser import wire
from daq.drivers.polled_laser.settings import PolledLaser
from daq.items import TX, Batch, DeviceEvent

COUNTER_WRAP = 2**32
LATEST_S = 0.5
"""Latest answer after its request, s. The host waits twice as long for it, so that it is not taken for the next one."""
_REFUSALS = 3
"""Refusals in a row that are a fault. A single one is a lost sample, for example while the sensor is being operated."""
_TICK_NS = round(channels.DEVICE_TICK_S * 1e9)

Items = list[Batch | DeviceEvent]


class PolledPipeline:
    """Decoder of one sensor's line. Displacement is 0 at the sensor's zero and grows with the distance from the sensor.

    Attributes:
        losses: see Pipeline. "samples": requests without an answer; "damaged_lines": lines that are no answer;
            "unasked": answers without a request or too late; "refused": requests that the sensor refused; "invalid":
            answers without a reading.
    """

    def __init__(self, device: str, settings: PolledLaser, channel: channels.Channel) -> None:
        kinds = ("samples", "damaged_lines", "unasked", "refused", "invalid")
        self.losses: dict[str, int] = dict.fromkeys(kinds, 0)
        self._device, self._channel, self._output = device, channel, settings.output
        self._dialect = wire.DIALECTS[settings.dialect]
        self._sensor_m, self._lever, self._range_m = settings.metres_per_unit, settings.lever_ratio, settings.range_m
        self._delay_ns = round(settings.delay_s * 1e9)
        self._request = self._dialect.request(settings.output)
        self._asked_ns: int | None = None  # time of the request that is not answered yet
        self._lost = 0  # samples lost since the last one
        self._counter = 0
        self._last_ns = 0
        self._line = bytearray()
        self._joined = False  # whether the beginning of the line's present text was received
        self._refusals = 0  # since the last reading
        self._begun = False  # whether there was a request, or an answer to one from before the log's begin

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            return self._asked(data, host_ns)
        out: Items = []
        *lines, rest = data.replace(b"\n", b"").split(b"\r")
        for part in lines:
            self._extend(part)
            line, joined = bytes(self._line), self._joined
            self._line.clear()
            self._joined = True
            if line:
                out += self._answered(line, joined, host_ns)
        self._extend(rest)
        return out

    def _extend(self, part: bytes) -> None:
        self._line += part[: wire.LONGEST_LINE_BYTES + 1 - len(self._line)]

    def _asked(self, data: bytes, host_ns: int) -> Items:
        if data != self._request:
            return []
        self._joined = self._begun = True
        out: Items = []
        if self._asked_ns is not None:
            self._lost += 1
            self.losses["samples"] += 1
            if self._lost == 1:
                text = "no answer to a request; the time of the next sample is that of its own request"
                out.append(DeviceEvent("gap", self._device, text, {"samples": 1}))
            self._counter += 1
        self._asked_ns = host_ns
        return out

    def _answered(self, line: bytes, joined: bool, host_ns: int) -> Items:
        found = self._dialect.parse(line, self._output) if len(line) <= wire.LONGEST_LINE_BYTES else None
        if found is None:
            if not joined or line + b"\r" == self._request:  # cut at its beginning, or the line's echo
                return []
            self.losses["damaged_lines"] += 1
            return [DeviceEvent("damage", self._device, f"not an answer: {line[:40]!r}", {"lines": 1})]
        if not self._begun:
            self._begun = True
            return []
        if self._asked_ns is None or host_ns - self._asked_ns > LATEST_S * 1e9:
            self._counter += self._asked_ns is not None
            self._asked_ns = None
            self.losses["unasked"] += 1
            return [
                DeviceEvent(
                    "damage", self._device, f"an answer too late, or without a request: {line[:40]!r}", {"lines": 1}
                )
            ]
        asked_ns, self._asked_ns = self._asked_ns, None
        reply = DeviceEvent("reply", self._device, line.decode("latin-1"))
        if isinstance(found, wire.Refusal):
            return [reply, *self._refused(found)]
        self._refusals = 0
        return [reply, self._sample(found, asked_ns, host_ns)]

    def _refused(self, found: wire.Refusal) -> Items:
        self.losses["refused"] += 1
        self._counter += 1
        self._refusals += 1
        if self._refusals != _REFUSALS:
            return []
        return [DeviceEvent("fault", self._device, f"the sensor refuses its request: {found.why}")]

    def _sample(self, found: wire.Reading, asked_ns: int, host_ns: int) -> Batch:
        time_ns = max(self._last_ns + 1, (asked_ns + host_ns) // 2 - self._delay_ns)
        away = found.value * self._sensor_m / self._lever
        if not abs(found.value * self._sensor_m) <= self._range_m:
            away = float("nan")
            self.losses["invalid"] += 1
        self._lost, self._last_ns = 0, time_ns
        number, self._counter = self._counter % COUNTER_WRAP, self._counter + 1
        counter = np.array([number], np.uint32)
        columns: dict[str, NDArray[Any]] = {
            "displacement_m": np.array([away]),
            "code": np.zeros(1, np.uint32),
            "counter": counter,
            "device_ticks": np.array([time_ns // _TICK_NS], np.uint64),
            "flags": np.zeros(1, np.uint32),
        }
        return Batch(self._channel, np.array([time_ns], np.int64), counter, columns)
