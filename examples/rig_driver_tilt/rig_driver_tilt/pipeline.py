"""Bytes to samples. It does no I/O and reads no clock, so that a log's bytes give the same samples again."""

import numpy as np

from daq.channels import Channel
from daq.clock import ClockMap, Unwrap
from daq.items import TX, Batch, DeviceEvent
from rig_driver_tilt import line


class TiltPipeline:
    """See daq.drivers.contract.Pipeline."""

    def __init__(self, device: str, channel: Channel, tolerance_ppm: float) -> None:
        self.losses = {"samples": 0, "damaged_lines": 0}
        self._device, self._channel = device, channel
        self._tolerance_ppm = tolerance_ppm
        self._rest = b""
        self._heard = False
        self._begin()

    def _begin(self) -> None:
        self._last: line.Sample | None = None
        self._ms = Unwrap(line.MS_WRAP)
        self._clock = ClockMap(self._tolerance_ppm)

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        """Take one read or one write."""
        if direction == TX:
            return []
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: line.LONGEST + 2]  # what is longer is damaged already
        out: list[Batch | DeviceEvent] = []
        samples: list[line.Sample] = []
        for each in lines:
            found = line.parse(each[: line.LONGEST + 2].removesuffix(b"\r"))
            if isinstance(found, line.Sample):
                if self._restarted(found):
                    out += [*self._batch(samples, host_ns), DeviceEvent("restart", self._device, "it started again")]
                    samples = []
                    self._begin()
                out += self._gap(found)
                samples.append(found)
                self._last = found
            elif found is not None:
                out.append(DeviceEvent("reply", self._device, found))
            elif self._heard:  # the first line may have begun before the port was open
                self.losses["damaged_lines"] += 1
                out.append(DeviceEvent("damage", self._device, "a damaged line was dropped", {"lines": 1}))
            self._heard = True
        return out + self._batch(samples, host_ns)

    def _restarted(self, found: line.Sample) -> bool:
        return self._last is not None and (found.ms - self._last.ms) % line.MS_WRAP > line.MS_WRAP // 2

    def _gap(self, found: line.Sample) -> list[DeviceEvent]:
        missing = 0 if self._last is None else (found.count - self._last.count - 1) % line.COUNT_WRAP
        self.losses["samples"] += missing
        return [DeviceEvent("gap", self._device, f"{missing} samples lost", {"samples": missing})] if missing else []

    def _batch(self, samples: list[line.Sample], host_ns: int) -> list[Batch | DeviceEvent]:
        if not samples:
            return []
        count = np.array([s.count for s in samples], np.uint32)
        ms = self._ms.feed(np.array([s.ms for s in samples]))
        columns = {
            "tilt_x_rad": np.array([s.x for s in samples]) * line.RAD,
            "tilt_y_rad": np.array([s.y for s in samples]) * line.RAD,
            "count": count,
            "device_ms": ms.astype(np.uint64),
        }
        return [Batch(self._channel, self._clock.map(ms * 1_000_000, host_ns), count, columns)]
