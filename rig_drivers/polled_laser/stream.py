"""Pipeline of a polled displacement sensor: requests and answers to displacement of the disk centre.

The sensor has no clock. The time of a sample is the middle between its request and the read with its answer, less
`delay_s`: the error is at most half of the time between the two. A request without an answer is a lost sample. An
answer without a request, or later than `LATEST_S` after it, belongs to no known time and is dropped. So is one between
a probe (see `rig_drivers.polled_laser.poller`) and its answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from daq import channels
from daq.drivers.contract import Pipeline
from daq.drivers.displacement import displacement_batch
from daq.drivers.polling import LATEST_S
from daq.items import TX, Batch, DeviceEvent
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.settings import PolledLaser

_REFUSALS = 3
"""Least number of refusals in a row that are a fault. Fewer are lost samples."""
_REFUSING_S = 2.0
"""Least duration of refusals that are a fault, s: a sensor refuses for a moment while it is being operated."""
_AGREED = 3  # right block checks in a row after which a wrong one is damage: its definition is not verified
CODES = {"": 0, "over": 1, "under": 2, "nothing": 3, "error": 4}
"""Code of a sample by the state of its answer."""
BEYOND_CODE = 5
"""Code of a sample with a value beyond the range of the rig file."""

Items = list[Batch | DeviceEvent]


class PolledPipeline(Pipeline):
    """Decoder of one sensor's line. Displacement is 0 at the sensor's zero and grows with the distance from the sensor.

    Attributes:
        losses: see Pipeline. "samples": requests without an answer; "damaged_lines": lines that are no answer;
            "unasked": answers without a request or too late; "refused": requests that the sensor refused; "invalid":
            answers without a reading.
    """

    def __init__(self, device: str, settings: PolledLaser, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "damaged_lines", "unasked", "refused", "invalid")
        self._output = settings.output
        self._channel = channels.displacement_channel(settings.topic)
        self._dialect = wire.DIALECTS[settings.dialect]
        self._sensor_m, self._lever, self._range_m = settings.metres_per_unit, settings.lever_ratio, settings.range_m
        self._delay_ns = round(settings.delay_s * 1e9)
        self._request, self._probe = self._dialect.request(settings.output), self._dialect.probe(settings.output)
        self._probes = 0  # probes sent and not answered
        self._has_probed = self._is_probed = False  # whether a probe was sent, and one answered
        self._asked_ns: int | None = None  # time of the request that is not answered yet
        self._lost = 0  # samples lost since the last one
        self._counter = 0
        self._last_ns = 0
        self._line = bytearray()
        self._joined = False  # whether the beginning of the line's present text was received
        self._refusals = 0  # since the last reading
        self._refusing_ns: int | None = None  # time of the first of them
        self._is_fault = self._is_beyond = self._has_answered = False
        self._agreed = 0  # right block checks in a row
        self._begun = False  # whether there was a request, or an answer to one from before the log's begin

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            return self._asked(data, host_ns)
        out: Items = []
        *lines, tail = data.replace(b"\n", b"").split(b"\r")
        for part in lines:
            self._extend(part)
            line, joined = bytes(self._line), self._joined
            self._line.clear()
            self._joined = True
            if line:
                out += self._answered(line, joined, host_ns)
        self._extend(tail)
        return out

    def _extend(self, part: bytes) -> None:
        self._line += part[: wire.LONGEST_LINE_BYTES + 1 - len(self._line)]

    def _asked(self, data: bytes, host_ns: int) -> Items:
        if data not in (self._request, self._probe):
            return []
        out = self._gap() if self._asked_ns is not None or (self._probes and self._is_probed) else []
        self._joined = True
        if data == self._probe:
            self._has_probed = True
            self._probes += 1
            self._asked_ns = None
        else:
            self._begun = True
            self._probes = 0
            self._asked_ns = host_ns
        return out

    def _gap(self) -> Items:
        """Count a request that is given up."""
        self._lost += 1
        self.losses["samples"] += 1
        self._counter += 1
        if self._lost > 1:
            return []
        text = "no answer to a request; the time of the next sample is that of its own request"
        return [DeviceEvent("gap", self._device, text, {"samples": 1})]

    def _answered(self, line: bytes, joined: bool, host_ns: int) -> Items:
        found = self._dialect.parse(line, self._output) if len(line) <= wire.LONGEST_LINE_BYTES else None
        if self._is_of_probe(line, found):
            self._probes, self._is_probed = 0, True
            return []
        if found is None or self._is_altered(found):
            return self._damaged(line, joined, "not an answer" if found is None else "wrong block check")
        self._has_answered = True
        if not self._begun:
            self._begun = True
            return []
        if self._asked_ns is None or host_ns - self._asked_ns > LATEST_S * 1e9:
            self._counter += self._asked_ns is not None
            self._asked_ns = None
            text = f"an answer too late, or without a request: {line[:40]!r}"
            return [self.damage("unasked", text, lines=1)]
        asked_ns, self._asked_ns = self._asked_ns, None
        reply = DeviceEvent("reply", self._device, line.decode("latin-1"))
        if isinstance(found, wire.Refusal):
            return [reply, *self._refused(found, host_ns)]
        self._refusals, self._refusing_ns, self._is_fault = 0, None, False
        return [reply, *self._report_beyond(found, line), self._sample(found, asked_ns, host_ns)]

    def _is_of_probe(self, line: bytes, found: wire.Reading | wire.Refusal | None) -> bool:
        """Whether a line answers a probe; one may be refused like a request for a value."""
        is_refused = self._probes > 0 and isinstance(found, wire.Refusal)
        return self._has_probed and (is_refused or self._dialect.answers_probe(line, self._output))

    def _is_altered(self, found: wire.Reading | wire.Refusal) -> bool:
        """Compare the block check, once some have shown that the sensor calculates it as is assumed here."""
        if isinstance(found, wire.Refusal) or found.check is None:
            return False
        is_altered = not found.check and self._agreed >= _AGREED
        self._agreed = self._agreed + 1 if found.check else self._agreed if is_altered else 0
        return is_altered

    def _damaged(self, line: bytes, joined: bool, what: str) -> Items:
        is_echo = line + b"\r" == self._request or (self._has_probed and line + b"\r" == self._probe)
        if not joined or is_echo:  # cut at its beginning, or the line's echo
            return []
        if self._dialect.is_foreign(line, self._output):
            what = "of another sensor, or sent without a request"
        out: Items = [self.damage("damaged_lines", f"{what}: {line[:40]!r}", lines=1)]
        if not self._has_answered:  # the dialogue shows it to the operator
            out.append(DeviceEvent("reply", self._device, line[:40].decode("latin-1")))
        return out

    def _refused(self, found: wire.Refusal, host_ns: int) -> Items:
        self.losses["refused"] += 1
        self._counter += 1
        self._refusals += 1
        if self._refusing_ns is None:
            self._refusing_ns = host_ns
        lasts = host_ns - self._refusing_ns >= _REFUSING_S * 1e9
        if self._is_fault or self._refusals < _REFUSALS or not lasts:
            return []
        self._is_fault = True
        text = f"the sensor refuses its request: {found.why}. Is it being set up? Return it to its measuring state"
        return [DeviceEvent("fault", self._device, text)]

    def _report_beyond(self, found: wire.Reading, line: bytes) -> Items:
        """Report the first one of values beyond the range: the sensor may have been set to another unit."""
        was_beyond = self._is_beyond
        self._is_beyond = self._code(found) == BEYOND_CODE
        if was_beyond or not self._is_beyond:
            return []
        metres = abs(found.value * self._sensor_m)
        text = (
            f"{line[:40].decode('latin-1')} is {metres:.6g} m, more than range_m = {self._range_m:g} m. Compare the "
            "sensor's display and its unit with unit_m"
        )
        return [DeviceEvent("status", self._device, text, {"displacement_m": metres})]

    def _code(self, found: wire.Reading) -> int:
        if found.state:
            return CODES[found.state]
        return 0 if abs(found.value * self._sensor_m) <= self._range_m else BEYOND_CODE

    def _sample(self, found: wire.Reading, asked_ns: int, host_ns: int) -> Batch:
        time_ns = max(self._last_ns + 1, (asked_ns + host_ns) // 2 - self._delay_ns)
        away = found.value * self._sensor_m / self._lever
        code = self._code(found)
        if code:
            away = float("nan")
            self.losses["invalid"] += 1
        self._lost, self._last_ns = 0, time_ns
        number, self._counter = self._counter % 2**32, self._counter + 1
        at_ns = np.array([time_ns], np.int64)
        return displacement_batch(self._channel, at_ns, np.array([number]), at_ns, np.array([away]), np.array([code]))
