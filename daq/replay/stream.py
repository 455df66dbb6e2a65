"""Decoding of a log's raw bytes with new pipelines, as during the recording, in bounded memory."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, cast

from daq.drivers.calibrated import CalibratedPipeline, Calibration
from daq.drivers.devices import installed_of, make_pipelines
from daq.errors import DeviceError, LogError
from daq.items import Batch, DeviceEvent
from daq.log import Log
from daq.log.samples import RawChunk
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
