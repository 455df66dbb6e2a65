"""A log's raw bytes decoded with new pipelines as during the recording, and its stored samples; in bounded memory."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from daq.drivers.calibrated import CalibratedPipeline, Calibration
from daq.drivers.devices import installed_of, make_pipelines
from daq.errors import DeviceError, LogError
from daq.items import Batch, DeviceEvent
from daq.log import Log
from daq.log.samples import RawChunk, Samples
from daq.log.snapshot import identities_of, rig_of, seeds_of
from rig_configs.schema import Rig

Decoded = tuple[str, RawChunk, list[Batch | DeviceEvent]]
"""A device, the bytes of one read or write, and the items decoded by its pipeline."""
_DECODER = re.compile("[1-9][0-9]{0,8}")


def pipelines_of(log: Log) -> dict[str, CalibratedPipeline]:
    """Return new pipelines in the state at the start of the log.

    Raises:
        LogError: the log contains no raw bytes, or not the facts needed to decode them.
    """
    if not log.devices:
        raise LogError(f"{log.path}: contains no raw bytes (it was not recorded from devices): nothing to decode again")
    identities = identities_of(log)
    for device, identity in identities.items():
        if not isinstance(cast("object", identity), dict):
            raise LogError(f"{log.path}: identities.json: expected a table under {device!r:.80}, got {identity!r:.80}")
    return pipelines_with(rig_of(log), identities, str(log.path), log)


def decoder_of(log: Log) -> int | None:
    """Return the `daq.version.DECODER` with which a log was recorded; None if its facts do not state it."""
    number = log.metadata.get("run", {}).get("decoder", "")
    return int(number) if _DECODER.fullmatch(number) else None


def pipelines_with(
    rig: Rig, identities: Mapping[str, Mapping[str, Any]], source: str, log: Log | None = None
) -> dict[str, CalibratedPipeline]:
    """Return new pipelines for devices with these identities.

    Args:
        rig: the rig file.
        identities: identity that each device reported, by device.
        source: source of the identities, for messages.
        log: log whose bytes are to be decoded; its clock maps start as in the recording.

    Returns:
        Pipelines by device, without devices whose driver is not installed.

    Raises:
        LogError: an identity is not valid for its device.
    """
    try:
        made = make_pipelines(installed_of(rig.devices), identities, None if log is None else seeds_of(log))
    except DeviceError as fault:
        raise LogError(f"{source}: identities.json: {fault}: its bytes cannot be decoded") from fault
    return {name: CalibratedPipeline(pipeline, Calibration.of(rig.devices[name])) for name, pipeline in made.items()}


def decoded(log: Log, pipelines: Mapping[str, CalibratedPipeline]) -> Iterator[Decoded]:
    """Yield every raw read and write in file order, with the items that the device's pipeline decodes.

    Bytes of devices without a pipeline have no items.

    Raises:
        LogError: raw bytes in the log do not match their schema.
    """
    for device, chunk in log.raw_in_order():
        pipeline = pipelines.get(device)
        yield device, chunk, [] if pipeline is None else pipeline.feed(chunk.direction, chunk.data, chunk.host_ns)


_ROWS = 60_000  # approximate number of samples in memory


class StoredRows:
    """One channel of a log from its beginning on.

    Attributes:
        names: its fields; empty if the log does not have the channel.
    """

    def __init__(self, log: Log, topic: str) -> None:
        exists = topic in log and log.count(topic) > 0
        self.names: tuple[str, ...] = log.channel(topic).names if exists else ()
        self._parts = log.parts(topic, _ROWS) if exists else iter(())
        heads = {"time_ns": np.int64, "log_time_ns": np.int64, "sequence": np.uint32}
        self._rows = {name: np.empty(0, kind) for name, kind in heads.items()}

    def read_next(self, count: int, until_ns: int | None = None) -> dict[str, NDArray[Any]]:
        """Return the next samples: time_ns, log_time_ns, sequence and every field, each of shape (n ≤ count,).

        The number is smaller only at the channel's end, or if the next log time is not before `until_ns`.
        """
        while len(self._rows["log_time_ns"]) < count and (part := next(self._parts, None)) is not None:
            new = _rows_of(part)
            self._rows = {name: np.concatenate([self._rows.get(name, new[name][:0]), new[name]]) for name in new}
        before = self._rows["log_time_ns"][:count]
        end = len(before) if until_ns is None else int(np.searchsorted(before, until_ns))
        found = {name: values[:end] for name, values in self._rows.items()}
        self._rows = {name: values[end:] for name, values in self._rows.items()}
        return found


def _rows_of(samples: Samples) -> dict[str, NDArray[Any]]:
    heads = {"time_ns": samples.time_ns, "log_time_ns": samples.log_time_ns, "sequence": samples.sequence}
    return heads | samples.columns
