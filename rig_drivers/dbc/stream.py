"""Pipeline of sensors on CAN: frames to displacements of the disk centre and other quantities.

A sample's time is the sensor's timestamp, or else the number of its frame times the sampling period, on the sensor's
clock, mapped to the common clock. Samples without both get the host's time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.clock import ClockSeed
from daq.drivers.can_lines import CanLines
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.items import TX, Batch, DeviceEvent
from daq.transports.can_frames import EXTENDED
from rig_basics.texts import number_of
from rig_drivers.dbc.layouts import MessageLayout
from rig_drivers.dbc.samples import LaserStream, QuantityStream
from rig_drivers.dbc.settings import CanSensors

Items = list[Batch | DeviceEvent]


class CanPipeline(Pipeline):
    """Decoder of one bus.

    Attributes:
        losses: see Pipeline. "samples": missing by counter or timestamp; "damaged_lines", "refused_lines": see
            CanLines; "short_frames": frames shorter than their message; "doubtful_frames": frames with a number that
            cannot be right; "invalid": samples without a reading; "foreign_frames": frames of other messages.
    """

    def __init__(self, device: str, settings: CanSensors, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "short_frames", "doubtful_frames", "invalid", "foreign_frames")
        self._lines = CanLines(device, self.losses)
        groups = settings.groups()
        seed = ClockSeed.of(identity) if len(groups) == 1 else None
        self._bus_ns: int | None = None  # time of the newest frame
        self._lasers = [LaserStream(device, settings, group, seed, self.losses) for group in groups]
        others = [QuantityStream(device, settings, name) for name in settings.quantities]
        self._streams: dict[tuple[int, bool], list[LaserStream | QuantityStream]] = {}
        for stream in (*self._lasers, *others):
            self._streams.setdefault((stream.message.frame_id, stream.message.extended), []).append(stream)

    @property
    @override
    def status(self) -> PipelineStatus:
        return PipelineStatus(clock_seed=self._lasers[0].clock_seed if len(self._lasers) == 1 else None)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            return []
        if not data:
            return [item for laser in self._lasers for item in laser.end()]
        rows, events = self._lines.received_rows(data)
        out: Items = [*events]
        if not len(rows):  # answers of the adapter do not show that the bus carries frames
            return out
        watches = [stream.watch for streams in self._streams.values() for stream in streams]
        for watch in watches if self._bus_ns is not None else ():
            watch.bus_back(host_ns, self._bus_ns or 0)
        self._bus_ns = host_ns
        self._taken(rows, host_ns, out)
        for watch in watches:
            out += watch.tick(host_ns)
        return out

    def _taken(self, rows: NDArray[Any], host_ns: int, out: Items) -> None:
        foreign = len(rows)
        for (frame_id, extended), streams in self._streams.items():
            own = rows["identifier"] == (frame_id | EXTENDED if extended else frame_id)
            count = int(np.count_nonzero(own))
            foreign -= count
            if count:
                data = self._whole(streams[0].message, rows["data"][own], rows["length"][own], out)
                for stream in streams if len(data) else ():
                    out += stream.feed(data, host_ns)
        self.losses["foreign_frames"] += foreign

    def _whole(
        self, message: MessageLayout, data: NDArray[np.uint8], length: NDArray[np.uint8], out: Items
    ) -> NDArray[np.uint8]:
        """Return the frames that have the length of their message."""
        whole = length >= message.size
        if bool(whole.all()):
            return data
        short = int(np.count_nonzero(~whole))
        self.losses["short_frames"] += short
        text = (
            f"{number_of(short, f'frame of {message.name} is', f'frames of {message.name} are')} shorter than the "
            f"{number_of(message.size, 'byte')} of the DBC file"
        )
        out.append(DeviceEvent("damage", self._device, text, {"frames": short}))
        return data[whole]
