"""Further signals of one message: recorded with the host's times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.items import Batch, DeviceEvent
from rig_drivers.dbc.layouts import MessageLayout
from rig_drivers.dbc.settings import CanSensors, quantity_channel
from rig_drivers.dbc.silence import SilenceWatch


class QuantityStream:
    """Decoder of a quantity's frames. A signal that is not in a frame, or has no reading, is NaN.

    Attributes:
        message: its message.
        watch: watch of its silence.
    """

    def __init__(self, device: str, settings: CanSensors, name: str) -> None:
        table = settings.quantities[name]
        self.message: MessageLayout = settings.message(table.message)
        self._channel, self._number = quantity_channel(name, table), 0
        self._signals = {field: self.message.signals[signal] for field, signal in table.fields.items()}
        self._invalid = {field: settings.invalid_raw(table.invalid, signal) for field, signal in self._signals.items()}
        self.watch: SilenceWatch = SilenceWatch(device, f"{self.message.name} (can/{name})", table.timeout_s)

    def feed(self, data: NDArray[np.uint8], host_ns: int) -> list[Batch | DeviceEvent]:
        """Decode frames of the message, shape (n, 8)."""
        columns: dict[str, NDArray[np.float64]] = {}
        seen = np.zeros(len(data), np.bool_)
        for field, signal in self._signals.items():
            there = signal.present(data)
            seen |= there
            there &= ~np.isin(signal.raw(data), self._invalid[field])
            columns[field] = np.where(there, signal.values(data), np.nan)
        count = int(np.count_nonzero(seen))
        if not count:
            return []
        sequence = (np.arange(self._number, self._number + count) % 2**32).astype(np.uint32)
        self._number += count
        rows = {field: values[seen] for field, values in columns.items()}
        batch = Batch(self._channel, np.full(count, host_ns, np.int64), sequence, rows)
        return [*self.watch.heard(host_ns), batch]
